"""Each mistake that ruins normals without failing is found, its remedy named, and none is invented."""

import itertools
import re
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.faults.simulated_captures import random_response
from vntoolkit.diagnosis.evidence import FEW_PIXELS, PIXELS_BETWEEN_SEAMS, evidence_from_frames
from vntoolkit.diagnosis.finding import FatalFinding, Finding, Level, judge
from vntoolkit.diagnosis.flicker import check_flicker
from vntoolkit.diagnosis.inspection import findings_from_evidence, findings_from_frames
from vntoolkit.diagnosis.rig_checks import check_residual, check_stated_focal, check_zoom, findings_from_rig
from vntoolkit.diagnosis.transfer_match import check_transfer, check_transfer_of_samples
from vntoolkit.diagnosis.white_balance import check_changing_gains
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse, ResponseVariation, rgb_from_normals
from vntoolkit.photometry.rig import FitQuality, Rig
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear, linear_from_encoded
from vntoolkit.pipeline.track import findings_from_tracks

H, W = 150, 200
SRGB = Transfer.from_text("srgb")


def _blob(rng):
    """Normals (h, w, 3) and mask of a dented ellipsoid, seen whole."""
    v, u = np.mgrid[:H, :W].astype(float)
    x, y = (u - W / 2) / (0.36 * W), (v - H / 2) / (0.42 * H)
    inside = x**2 + y**2 < 0.995
    depth = -40.0 * np.sqrt(np.maximum(1 - x**2 - y**2, 1e-3))
    for _ in range(6):
        angle, length = rng.uniform(0, np.pi), rng.uniform(14, 40)
        k = 2 * np.pi / length
        wave = np.cos(k * (u * np.cos(angle) + v * np.sin(angle)) + rng.uniform(0, 6))
        depth += 0.12 / k * wave
    slope_v, slope_u = np.gradient(depth)
    normals = np.stack([slope_u, slope_v, -np.ones_like(depth)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True), inside


def _shot(seed):
    """Return (light (h, w, 3), mask, response) of a blob before a black backdrop."""
    rng = np.random.default_rng([seed, 18])
    response = random_response(rng)
    normals, inside = _blob(rng)
    light = np.clip(rgb_from_normals(normals, response), 0, None) * inside[..., None]
    return np.clip(light + rng.normal(0, 0.003, light.shape), 0, 1), inside, response


def _findings(light, matrix, read=None, mask=None, calibrated=None):
    rig = Rig(
        camera=Camera.orthographic(width=W, height=H),
        response=LightResponse(matrix=matrix),
        transfer=calibrated or read or Transfer(),
    )
    frame = LinearFrame(rgb=light.astype(np.float32), clipped=(light >= 1).any(axis=-1))
    evidence = evidence_from_frames([frame], rig, read or Transfer(), mask)
    return [*findings_from_rig(rig), *findings_from_evidence(evidence)]


@pytest.mark.parametrize("seed", [0, 2, 3, 5])
def test_stripes_of_paint_are_no_slopes_and_hide_no_mirrored_axis(seed):
    light, inside, response = _shot(seed)
    v, u = np.mgrid[:H, :W]
    striped = np.where(((u + v) // 14 % 2 == 0)[..., None], light * [0.3, 0.4, 0.8], light)
    assert _findings(striped, response.matrix, mask=inside) == []
    mirrored = _findings(striped, response.matrix @ np.diag([-1, 1, 1]), mask=inside)
    assert any("axis mirrored" in finding.text for finding in mirrored)


@pytest.mark.parametrize("seed", [0, 2, 3, 5])
def test_where_paint_leaves_no_surface_a_warning_says_that_m_was_not_checked(seed):
    """A weave of many colours, finer than what slopes are compared over."""
    light, inside, response = _shot(seed)
    rng = np.random.default_rng(seed)
    woven = light * np.kron(rng.uniform(0.2, 1.0, (30, 40, 3)), np.ones((5, 5, 1)))
    for change in (np.eye(3), np.diag([-1, 1, 1])):
        found = _findings(woven, response.matrix @ change, mask=inside)
        noted = [finding for finding in found if finding.check == "matrix"]
        assert [finding.level for finding in noted] == [Level.WARNING], found
        assert "could not be checked" in noted[0].problem
        assert "--single-light" in noted[0].remedy


def _tartan(seed):
    """Return (light (h, w, 3), response) of a blob woven of three yarns, which mix where they cross."""
    light, _, response = _shot(seed)
    factor = 3
    rng = np.random.default_rng(seed)
    large = cv2.resize(light.astype(np.float32), (factor * W, factor * H), interpolation=cv2.INTER_CUBIC)
    yarns = np.array([[0.9, 0.3, 0.3], [0.3, 0.65, 0.4], [0.3, 0.4, 0.7]])
    ends = np.cumsum([24, 19, 14])
    warp, weft = (yarns[np.searchsorted(ends, np.arange(n) % 57, "right")] for n in (factor * W, factor * H))
    paint = cv2.GaussianBlur((warp + weft[:, None]) / 2, (0, 0), 0.7)
    return np.clip(large * paint + rng.normal(0, 0.003, large.shape), 0, 1), response


def _findings_in_weave(light, matrix, light_colours):
    height, width = light.shape[:2]
    response = LightResponse(matrix=matrix, light_colours=light_colours)
    rig = Rig(camera=Camera.orthographic(width=width, height=height), response=response)
    frame = LinearFrame(rgb=light.astype(np.float32), clipped=(light >= 1).any(axis=-1))
    found = findings_from_frames([frame], rig, Transfer())
    return [finding for finding in found if finding.level is not Level.NOTE]


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2, 3])
def test_a_tartan_tells_which_mistake_was_made(seed):
    """As of one material its squares leave no surface; their steps tell the paint, whatever M is."""
    light, response = _tartan(seed)
    m = response.matrix
    assert _findings_in_weave(light, m, np.eye(3)) == []
    (found,) = _findings_in_weave(light, m, None)  # paints cannot be told apart then
    assert found.level is Level.WARNING
    assert "--single-light" in found.remedy
    for named, footage, matrix in (
        ("axis mirrored", light, m @ np.diag([-1, 1, 1])),
        ("axis mirrored", light, m @ np.diag([1, -1, 1])),
        ("transposed", light, m.T),
        ("red and green exchanged", light, m[[1, 0, 2]]),
        ("turned about", light, m @ _turned(60)),
        ("give --transfer srgb", encoded_from_linear(light, SRGB), m),
    ):
        found = _findings_in_weave(footage, matrix, np.eye(3))
        assert any(named in finding.text for finding in found), (named, found)


@pytest.mark.parametrize("seed", [0, 2])
def test_two_spots_name_no_mistake(seed):
    """Between seams that are left out, a few pixels in two places say nothing, however well they agree."""
    light, inside, response = _shot(seed)
    v, u = np.mgrid[:H, :W]
    seen = u % 10 < 5
    for middle in (60, 140):
        seen |= np.hypot(u - middle, v - 75) < 11
    spots = np.where(seen[..., None], light, 1.0)
    found = _findings(spots, response.matrix @ _turned(40), mask=inside)
    assert all(finding.level is Level.NOTE for finding in found), found


@pytest.mark.parametrize("seed", [0, pytest.param(2, marks=pytest.mark.slow)])
def test_patches_between_seams_tell_a_mirrored_axis_at_a_closer_look(seed):
    light, inside, response = _shot(seed)
    factor = 4
    large = cv2.resize(light.astype(np.float32), (factor * W, factor * H))
    v, u = np.mgrid[: factor * H, : factor * W]
    seam = (u % 40 < 11) | (v % 40 < 11)
    frame = LinearFrame(rgb=large, clipped=seam)
    mask = cv2.resize(inside.astype(np.uint8), large.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0

    def named(most_pixels, change):
        rig = Rig(
            camera=Camera.orthographic(width=factor * W, height=factor * H),
            response=LightResponse(matrix=response.matrix @ change),
        )
        found = findings_from_frames([frame], rig, Transfer(), mask, most_pixels)
        return any("axis mirrored" in finding.text for finding in found if finding.level is not Level.NOTE)

    mirrored = np.diag([-1, 1, 1])
    for most_pixels in (FEW_PIXELS, PIXELS_BETWEEN_SEAMS):
        assert named(most_pixels, mirrored)
        assert not named(most_pixels, np.eye(3))


def _turned(degrees):
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


WRONG_M = {
    "its x axis mirrored": lambda m: m @ np.diag([-1, 1, 1]),
    "its y axis mirrored": lambda m: m @ np.diag([1, -1, 1]),
    "x and y of M both look reversed": lambda m: m @ np.diag([-1, -1, 1]),
    "with M transposed": lambda m: m.T,
    "red and green exchanged": lambda m: m[[1, 0, 2]],
    "turned about the camera's axis by +60": lambda m: m @ _turned(60),
    "from behind a surface": lambda m: m @ np.diag([1, 1, -1]),
}


@pytest.mark.parametrize("seed", [1, 2])
def test_sound_captures_raise_nothing(seed):
    light, inside, response = _shot(seed)
    for mask in (None, inside):
        assert _findings(light, response.matrix, mask=mask) == []
    decoded = linear_from_encoded(np.rint(encoded_from_linear(light, SRGB) * 255) / 255, SRGB)
    assert _findings(decoded, response.matrix, SRGB) == []


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("named", list(WRONG_M))
def test_wrong_matrices_are_named(named, seed):
    light, _, response = _shot(seed)
    findings = _findings(light, WRONG_M[named](response.matrix))
    assert any(named in finding.text for finding in findings), findings
    assert any(finding.level is Level.FATAL for finding in findings)


@pytest.mark.parametrize("seed", [1, 2])
def test_the_wrong_curve_is_named_either_way(seed):
    light, _, response = _shot(seed)
    (found,) = _findings(encoded_from_linear(light, SRGB), response.matrix)
    assert "give --transfer srgb" in found.text
    (found,) = _findings(linear_from_encoded(light, SRGB), response.matrix, SRGB)
    assert "give --transfer linear" in found.text
    findings = _findings(linear_from_encoded(light, SRGB), response.matrix, SRGB, calibrated=Transfer())
    assert "leave --transfer out" in findings[0].text
    assert "give --transfer linear" in findings[1].text


def test_footage_of_no_surface_and_a_mask_off_it_are_named(rng):
    light, inside, response = _shot(3)
    (found,) = _findings(rng.uniform(0, 1, light.shape), response.matrix)
    assert (found.check, found.level) == ("noise", Level.FATAL)
    wall = response.matrix @ [0.1, 0.05, -0.99] + rng.normal(0, 0.003, light.shape)
    (found,) = _findings(wall, response.matrix)
    assert found.check == "flat"
    (found,) = _findings(light, response.matrix, mask=~inside)
    assert (found.check, found.level) == ("mask", Level.FATAL)
    assert "invert it" in found.text


@pytest.mark.parametrize("gains", [(1.2, 1.0, 0.85), (0.85, 1.0, 1.1)])
def test_other_gains_are_measured(gains):
    light, _, response = _shot(4)
    (found,) = _findings(0.8 * light * gains, response.matrix)
    red, blue = (f"{100 * (gain - 1):+.0f} %" for gain in (gains[0], gains[2]))
    assert f"red by {red} and blue by {blue}" in found.text


def test_another_hue_is_not_taken_for_another_curve():
    light, _, response = _shot(4)
    encoded = np.rint(encoded_from_linear(light * (1.3, 1.0, 0.75) / 1.3, SRGB) * 255) / 255
    (found,) = _findings(linear_from_encoded(encoded, SRGB), response.matrix, SRGB)
    assert (found.check, found.level) == ("white-balance", Level.WARNING)
    assert "another colour" in found.text


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("constant", [(0.03, 0.03, 0.03), (0.025, 0.0, 0.0)])
def test_light_that_is_none_of_the_lamps_is_measured(constant, seed):
    light, _, response = _shot(seed)
    (found,) = _findings(np.clip(0.9 * light + constant, 0, 1), response.matrix)
    assert (found.check, found.level) == ("black-level", Level.WARNING)
    said = [float(part) for part in re.findall(r"([\d.]+)%", found.measured)]
    np.testing.assert_allclose(said, 100 * np.array(constant), atol=0.4)
    assert "--background" in found.text


def test_a_backdrop_that_the_lamps_light_is_no_black_level():
    light, inside, response = _shot(1)
    cloth = 0.1 * response.matrix @ [0, 0, -1]
    lit = np.where(inside[..., None], light, cloth)
    assert np.percentile(lit, 1, axis=(0, 1)).min() > 0
    assert not any(found.check == "black-level" for found in _findings(lit, response.matrix, mask=inside))


def test_limited_range_read_as_full_is_named():
    light, _, response = _shot(2)
    codes = np.rint(16 + 219 * encoded_from_linear(light, SRGB)) / 255
    (found,) = _findings(linear_from_encoded(codes, SRGB), response.matrix, SRGB)
    assert found.check == "black-level"
    assert "limited range, read as full" in found.text


def test_full_range_read_as_limited_is_named():
    light, _, response = _shot(2)
    codes = np.clip((255 * encoded_from_linear(light, SRGB) - 16) / 219, 0, 1)
    (found,) = _findings(linear_from_encoded(np.rint(255 * codes) / 255, SRGB), response.matrix, SRGB)
    assert found.check == "black-level"
    assert "full range, read as limited" in found.text


@pytest.mark.parametrize("seed", [1, 4])
@pytest.mark.parametrize(("strength", "exponent"), [(0.1, 30), (0.25, 80)])
def test_gloss_is_measured_and_a_matte_surface_has_none(seed, strength, exponent):
    light, inside, response = _shot(seed)
    normals = (light @ np.linalg.inv(response.matrix).T) * inside[..., None]
    normals = cv2.GaussianBlur(normals, (0, 0), 1.0)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-9)
    strengths = np.linalg.norm(response.matrix, axis=1)
    glossy = light.copy()
    for lamp, colour in zip(response.matrix / strengths[:, None], np.diag(strengths), strict=True):
        between = lamp + np.array([0, 0, -1])
        lobe = np.clip(normals @ between / np.linalg.norm(between), 0, 1) ** exponent
        glossy += strength * lobe[..., None] * colour * inside[..., None]
    top = max(1.0, glossy.max())
    assert not any(found.check == "gloss" for found in _findings(light, response.matrix))
    found = [each for each in _findings(glossy / top, response.matrix / top) if each.check == "gloss"]
    assert len(found) == 1
    said = float(re.findall(r"highlights of ([\d.]+)%", found[0].measured)[0]) / 100
    assert 0.25 * strength < said < 1.5 * strength  # of a lobe of one width
    assert "powder" in found[0].remedy


def test_calibration_samples_tell_the_curve_and_a_bad_fit(rng):
    normals, _ = _blob(rng)
    normals = normals[20:-20:2, 40:-40:2].reshape(-1, 3)
    response = random_response(rng)
    rgb = np.clip(rgb_from_normals(normals, response), 0, 1) + rng.normal(0, 0.002, normals.shape)
    assert check_transfer_of_samples(normals, rgb, Transfer()) == []
    (found,) = check_transfer_of_samples(normals, encoded_from_linear(rgb, SRGB), Transfer())
    assert "give --transfer srgb" in found.text
    assert found.level is Level.FATAL
    board = slice(None, None, len(normals) // 48)
    assert check_transfer_of_samples(normals[board], rgb[board], Transfer()) == []
    assert check_transfer_of_samples(normals[board], encoded_from_linear(rgb[board], SRGB), Transfer())
    quality = FitQuality(method="sphere", residual_deg=30.0, condition_number=3.0, samples=99, cone_deg=60.0)
    rig = Rig(camera=Camera.orthographic(width=9, height=9), response=response, quality=quality)
    (found,) = check_residual(rig)
    assert "30 degrees" in found.measured


def _in_a_row(shift_px=2.0, gains=(1, 1, 1, 1, 1)):
    """Five frames of a blob that moves to the right, under light of these gains, and its rig."""
    light, _, response = _shot(1)
    rng = np.random.default_rng(5)
    frames = []
    for k, gain in enumerate(gains):
        moved = np.roll(light, round(k * shift_px), axis=1) * gain + rng.normal(0, 0.003, light.shape)
        frames.append(LinearFrame(rgb=np.clip(moved, 0, 1).astype(np.float32), number=k))
    return frames, Rig(camera=Camera.orthographic(width=W, height=H), response=response)


def test_light_that_flickers_is_found_and_a_steady_one_or_a_slow_change_is_not():
    for gains, expected in (
        ((1, 1, 1, 1, 1), 0),
        ((1, 1.01, 1.02, 1.03, 1.04), 0),
        ((1, 0.94, 1, 0.94, 1), 1),
    ):
        frames, rig = _in_a_row(gains=gains)
        found = check_flicker(evidence_from_frames(frames, rig, Transfer()))
        assert len(found) == expected, gains
    assert "shutter time" in found[0].text


@pytest.mark.parametrize(
    ("gains", "named"), [((1, 1, 1), False), ((1.1, 1.1, 1.1), False), ((1.05, 1, 1), True)]
)
def test_a_lamp_that_drifts_is_found_on_the_subject_alone_and_exposure_disturbs_no_check(gains, named):
    frames, rig = _in_a_row(shift_px=4.0)
    later = LinearFrame(rgb=np.clip(0.9 * frames[4].rgb * gains, 0, 1).astype(np.float32), number=4)
    evidence = evidence_from_frames([frames[0], later], rig, Transfer())
    found = check_changing_gains(evidence)
    assert findings_from_evidence(evidence) == found
    assert len(found) == named
    if named:
        assert "from frame 0 to 4" in found[0].text
        assert abs(float(found[0].measured.split()[0]) - 5) < 0.5


@pytest.mark.parametrize("phases", [(0.0, 0.0, 0.0), (0.0, 2.1, 4.2)])
def test_bands_of_a_rolling_shutter_are_found_and_a_subject_that_moves_has_none(phases):
    frames, rig = _in_a_row(shift_px=1.0)
    fast = _in_a_row(shift_px=4.0)[0]
    down = [LinearFrame(rgb=np.roll(f.rgb, 5 * k, axis=0), number=k) for k, f in enumerate(frames)]
    for moving in (frames, fast, down):
        assert check_flicker(evidence_from_frames(moving, rig, Transfer())) == []
    rows = np.arange(H)[:, None] / H
    banded = [
        LinearFrame(
            rgb=(f.rgb * (1 + 0.03 * np.sin(2 * np.pi * (1.7 * rows + 0.37 * k) + phases))[:, None]).astype(
                np.float32
            ),
            number=k,
        )
        for k, f in enumerate(frames)
    ]
    (found,) = check_flicker(evidence_from_frames(banded, rig, Transfer()))
    assert found.check == "flicker"
    assert "bands" in found.text


@pytest.mark.parametrize("zoom", [1.0, 1.6, 0.6])
def test_another_zoom_is_found_where_the_light_falls_off(zoom):
    response = _shot(2)[2]
    powers = np.array([[1, 0], [0, 1], [2, 0], [0, 2]])
    steps = np.stack([f * response.matrix for f in (0.35, -0.2, -0.3, -0.25)])
    variation = ResponseVariation(
        powers=powers,
        matrices=steps,
        ambients=np.zeros((4, 3)),
        centre_px=np.array([W / 2, H / 2]),
        scale_px=W / 2,
    )
    response = LightResponse(matrix=response.matrix, variation=variation)
    u, v = np.meshgrid(np.arange(W), np.arange(H))
    place = (np.stack([u, v], axis=-1) - variation.centre_px) / zoom + variation.centre_px
    matrices, _ = response.at(place)
    normals, inside = _blob(np.random.default_rng([2, 18]))
    seen = np.einsum("vuij,vuj->vui", matrices, normals) * inside[..., None]
    seen = np.clip(seen + np.random.default_rng(0).normal(0, 0.003, seen.shape), 0, None).astype(np.float32)
    seen /= 1.05 * seen.max()
    camera = Camera.pinhole(width=W, height=H, focal_px=3.0 * W)
    rig = Rig(camera=camera, response=response)
    found = check_zoom(evidence_from_frames([LinearFrame(rgb=seen)], rig, Transfer()))
    assert len(found) == (zoom != 1.0)
    if found:
        assert float(found[0].measured.split()[0]) == pytest.approx(zoom, rel=0.12)
    assert check_stated_focal(rig, 3.1 * W) == []
    assert "1.50 times" in check_stated_focal(rig, 4.5 * W)[0].text


def test_the_judge_stops_at_what_is_fatal_and_not_allowed(caplog):
    finding = Finding(check="noise", level=Level.FATAL, problem="p", measured="m", expected="e", remedy="r")
    assert finding.text == "p: measured m, expected e; r [noise], see docs/wrong.md#noise"
    with pytest.raises(FatalFinding, match="--allow noise"):
        judge([finding])
    judge([finding], allowed=("noise",))
    assert finding.text in caplog.text


def test_tracks_that_end_or_jump_are_said_and_others_are_not() -> None:
    numbers, errors = range(10, 16), [0.0, 0.3, 0.3, 1.0, 2.0, 6.0]
    assert findings_from_tracks([], [], []) == []
    assert findings_from_tracks([1, 0.9, 0.8, 0.7, 0.6, 0.55], errors, numbers) == []
    (faded,) = findings_from_tracks([1, 0.9, 0.7, 0.6, 0.45, 0.3], errors, numbers)
    assert faded.check == "lost"
    assert "in 2 of 6 frames, most in 15" in faded.text
    assert "measured 30% of the vertices" in faded.text
    (cut,) = findings_from_tracks([1, 0.98, 0.97, 0.01, 0.02, 0.1], [0, 0.3, 0.3, 14, 12, 8], numbers)
    assert cut.check == "jump"
    assert "at once between frames 12 and 13" in cut.text


def test_light_between_parts_of_a_statue_is_no_transfer_curve(real_data: Path) -> None:
    """Photographs of plaster under every three lamps that stand apart: linear is not sRGB, and sRGB is."""
    folder = real_data / "photometric_stereo"
    lamps = np.loadtxt(folder / "lights.txt", skiprows=1) * [1, -1, -1]
    found = []
    for name in ("buddha", "cat"):
        single = [cv2.imread(str(folder / name / f"{name}.{k}.png")).mean(axis=2) / 255 for k in range(12)]
        mask = cv2.imread(str(folder / name / f"{name}.mask.png"), cv2.IMREAD_GRAYSCALE) > 127
        for three in itertools.combinations(
            range(2, 12), 3
        ):  # two lamps of the list are off by 6 and 8 degrees
            matrix = 0.6 * lamps[list(three)]
            if np.linalg.cond(matrix) > 8:
                continue
            light = np.stack([single[k] for k in three], axis=-1)
            light = np.minimum(0.95 * light / np.percentile(light[mask], 99.8), 1)
            in_srgb = np.rint(255 * encoded_from_linear(light, SRGB)) / 255
            rig = Rig(
                camera=Camera.orthographic(width=mask.shape[1], height=mask.shape[0]),
                response=LightResponse(matrix=matrix),
            )
            linear, encoded = (
                check_transfer(
                    evidence_from_frames([LinearFrame(rgb=rgb.astype(np.float32))], rig, Transfer(), mask)
                )
                for rgb in (light, in_srgb)
            )
            assert not linear, (name, three)
            found.append(bool(encoded))
    assert np.mean(found) > 0.6

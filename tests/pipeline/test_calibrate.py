"""Calibration from files: the command line's whole way, on drawn footage and on real photographs."""

from pathlib import Path

import numpy as np
import pytest

from tests.attached_shadow import shaded_rgb_from_normals
from tests.drawn_gel import press_on_ball
from vntoolkit.__main__ import main
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.maps_and_meshes.masks import read_mask, write_mask
from vntoolkit.io.rigs import read_rig
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.normals.photometric_stereo import normals_from_lights
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear, linear_from_integers
from vntoolkit.pipeline.calibrate_presses import PressJob, calibrate_presses, read_press_label
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.tactile.presses import CONTACT_SHARE

DIRECTIONS = np.array([[0.6, 0.0, -0.8], [-0.36, 0.48, -0.8], [-0.36, -0.48, -0.8]])
COLOURS = np.array([[0.5, 0.05, 0.02], [0.06, 0.6, 0.1], [0.0, 0.1, 0.4]])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)
SRGB = Transfer.from_text("srgb")


def write_ball(path: Path, response: LightResponse = RESPONSE, transfer: Transfer = SRGB) -> np.ndarray:
    v, u = np.indices((120, 160))
    x, y = (u - 82.0) / 45, (v - 57.0) / 45
    inside = x**2 + y**2 < 1
    normals = np.stack([x, y, -np.sqrt(np.maximum(1 - x**2 - y**2, 0))], axis=-1)
    rgb = np.where(inside[..., None], shaded_rgb_from_normals(normals, response), 0.0)
    write_png(path, np.round(encoded_from_linear(rgb, transfer) * 65535).astype(np.uint16))
    return inside


def single_light(k: int) -> LightResponse:
    faint = np.eye(3) * 1e-3  # the other two lights as good as off
    faint[k, k] = 1
    return LightResponse(matrix=COLOURS.T @ faint @ DIRECTIONS, light_colours=faint @ COLOURS)


def test_sphere_command_writes_a_rig_that_names_its_sources(tmp_path, capsys) -> None:
    inside = write_ball(tmp_path / "ball.png")
    write_mask(tmp_path / "mask.png", inside)
    lights = [tmp_path / f"{name}.png" for name in "rgb"]
    for k, path in enumerate(lights):
        write_ball(path, single_light(k))
    command = f"calibrate sphere {tmp_path}/ball.png --out {tmp_path}/rig.json --transfer srgb"
    command += f" --single-light {' '.join(map(str, lights))} --mask {tmp_path}"
    assert main(f"{command}/mask.png".split()) == 0
    rig = read_rig(tmp_path / "rig.json")
    np.testing.assert_allclose(rig.response.matrix, RESPONSE.matrix, atol=0.005)
    np.testing.assert_allclose(rig.response.light_colours, COLOURS, atol=0.01)
    np.testing.assert_allclose(rig.response.light_directions, DIRECTIONS, atol=0.02)
    assert rig.transfer == SRGB
    assert [source.file for source in rig.sources] == ["ball.png", "mask.png", "r.png", "g.png", "b.png"]
    assert "residual" in capsys.readouterr().out
    (tmp_path / "mattes").mkdir()
    (tmp_path / "mask.png").rename(tmp_path / "mattes" / "matte.png")
    assert main(f"{command}/mattes".split()) == 0
    sources = read_rig(tmp_path / "rig.json").sources
    assert [source.file for source in sources][:2] == ["ball.png", "matte.png"]


def test_a_ball_under_one_lamp_at_a_time_gives_m_and_the_lamps(tmp_path, capsys) -> None:
    out = tmp_path / "rig.json"
    for k, name in enumerate("cab"):  # in no order
        write_ball(tmp_path / f"{name}.png", single_light(k))
    command = ["calibrate", "sphere", str(tmp_path / "[abc].png"), "--transfer", "srgb", "--out", str(out)]
    assert main(command) == 0
    rig = read_rig(out)
    np.testing.assert_allclose(rig.response.matrix, RESPONSE.matrix, atol=0.01)
    np.testing.assert_allclose(rig.response.light_colours, COLOURS, atol=0.01)
    assert rig.material == "the ball"
    assert "material          the ball\n" in capsys.readouterr().out
    (tmp_path / "ball").mkdir()
    write_ball(tmp_path / "ball" / "ball.png")
    command[2] = str(tmp_path / "ball" / "ball.png")
    assert main(command) == 0
    assert "others need the lamps' colours" in capsys.readouterr().out
    assert main([*command, "--single-light", str(tmp_path / "[abc].png")]) == 0
    np.testing.assert_allclose(read_rig(out).response.light_colours, COLOURS, atol=0.01)
    assert main([*command, "--single-light", *[str(tmp_path / "a.png")] * 2]) == 1
    assert "--single-light: expected three photographs" in capsys.readouterr().err


def test_lights_command_makes_a_rig(tmp_path) -> None:
    write_ball(tmp_path / "ball.png")
    rows = np.column_stack([DIRECTIONS * [1, -1, -1], COLOURS])
    np.savetxt(tmp_path / "lights.txt", rows)
    out = tmp_path / "rig.json"
    command = f"calibrate lights {tmp_path}/lights.txt --like {tmp_path}/ball.png --light-colours given"
    assert main(f"{command} --out {out}".split()) == 0
    np.testing.assert_allclose(read_rig(out).response.matrix, RESPONSE.matrix)
    assert (read_rig(out).camera.width, read_rig(out).camera.height) == (160, 120)


@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((60, 80, 3), np.uint8), "the image is black"),
        (np.full((60, 80, 3), 255, np.uint8), "100.0% of the pixels are clipped"),
        (np.full((60, 80, 3), 90, np.uint8), "no ball found"),
    ],
)
def test_bad_footage_gets_one_line_and_no_rig(tmp_path, capsys, image, message) -> None:
    write_png(tmp_path / "bad.png", image)
    out = tmp_path / "rig.json"
    assert main(["calibrate", "sphere", str(tmp_path / "bad.png"), "--out", str(out)]) == 1
    error = capsys.readouterr().err.strip()
    assert message in error
    assert "\n" not in error
    assert not out.exists()


def test_other_bad_input_gets_one_line(tmp_path, capsys) -> None:
    write_ball(tmp_path / "ball.png")
    write_mask(tmp_path / "small.png", np.ones((60, 80), bool))
    (tmp_path / "flat.txt").write_text("1 0 1\n0 1 1\n1 1 2\n")
    ball, out = tmp_path / "ball.png", tmp_path / "rig.json"
    for command, line in (
        (f"sphere {ball} --mask {tmp_path}/small.png", "the mask is 80×60, the capture 160×120"),
        (f"sphere {ball} --camera {out} --focal-px 300", "expected --camera or --focal-px, got both"),
        (f"board {ball}", "the board is not seen"),
        (f"lights {tmp_path}/flat.txt --like {ball}", "singular"),
    ):
        assert main(f"calibrate {command} --out {out}".split()) == 1
        assert line in capsys.readouterr().err
    assert not (tmp_path / "rig.json").exists()


def photographs_of(real_data: Path, name: str) -> np.ndarray:
    folder = real_data / "photometric_stereo" / name
    return np.stack([read_image(folder / f"{name}.{k}.png").mean(axis=2) / 255 for k in range(12)])


@pytest.mark.parametrize("with_mask", [True, False])
def test_real_sphere_then_buddha_and_cat(real_data, tmp_path, with_mask) -> None:
    coloured = real_data / "coloured_light"
    command = ["calibrate", "sphere", str(coloured / "gray_sphere.png"), "--out", str(tmp_path / "rig.json")]
    assert main(command + (["--mask", str(coloured / "gray_sphere.mask.png")] if with_mask else [])) == 0
    rig = read_rig(tmp_path / "rig.json")
    assert 2.0 < rig.quality.residual_deg < 3.0  # 2.6 was measured by hand
    lights = read_lights(real_data / "photometric_stereo" / "lights.txt").directions
    for name in ("buddha", "cat"):
        image, mask = read_image(coloured / f"{name}.png"), read_mask(coloured / f"{name}.mask.png")
        frame = LinearFrame(linear_from_integers(image, rig.transfer))
        normals = normals_from_frame(frame, rig.response, mask)
        reference = normals_from_lights(photographs_of(real_data, name), lights, mask)
        lit = (image > 0.05 * np.percentile(image[mask], 99, axis=0)).all(axis=2)
        both = normals.mask & reference.mask & lit
        assert both.sum() > 0.8 * mask.sum()
        error = angles_deg(normals.normals_in_camera[both], reference.normals_in_camera[both])
        assert np.median(error) < 6.5


@pytest.mark.slow
def test_real_ball_presses_make_a_flat_gel_with_one_travelling_dent(real_data, tmp_path) -> None:
    gel = real_data / "gelsight"
    presses = f"{gel}/ball_presses/cal-1*.jpg --background {gel}/ball_presses/bg-0.jpg --ball-radius-mm 2.42"
    labels = f"--labels {gel}/ball_presses/ball_position --label-size 240 320 --out {tmp_path}/rig.json"
    plane = "--corners 33 58 208 61 56 250 185 244 --size-mm 24 34.88 --pixel-mm 0.1"
    assert main(f"calibrate presses {presses} {labels} {plane}".split()) == 0
    rig = read_rig(tmp_path / "rig.json")
    assert rig.quality.method == "presses"
    assert rig.quality.residual_deg < 7.5
    assert rig.gel.rectification.corners_px[:2] == (33, 58)
    background = gel / "sequence_background.jpg"
    run = f"--rig {tmp_path}/rig.json --background {background} --to depth"
    for name in ("000000", "000100", "000140"):
        assert main(f"reconstruct {gel}/sequence/{name}.jpg {run} --out {tmp_path}/{name}".split()) == 0
    assert main(f"reconstruct {background} {run} --out {tmp_path}/untouched".split()) == 0
    untouched = read_normal_map(tmp_path / "untouched" / "normals" / "000000.exr")
    assert (untouched.normals_in_camera[untouched.mask] == [0, 0, -1]).all()
    assert np.ptp(read_depth_map(tmp_path / "untouched" / "depth" / "000000.exr").depth) == 0
    centres = []
    for name in ("000000", "000100", "000140"):
        normals = read_normal_map(tmp_path / name / "normals" / "000000.exr").normals_in_camera
        depth_mm = 1000 * read_depth_map(tmp_path / name / "depth" / "000000.exr").depth[20:-20, 20:-20]
        tilt = np.rad2deg(np.arccos(np.clip(-normals[..., 2], -1, 1)))[20:-20, 20:-20]
        v, u = np.nonzero(tilt > 12)
        centre = np.array([np.median(u), np.median(v)])
        far = np.hypot(*(np.indices(tilt.shape)[::-1] - centre[:, None, None])) > 80
        assert np.median(tilt[far]) < 1.5  # flat where nobody touches it
        assert depth_mm[far].std() < 0.1
        near = normals[20:-20, 20:-20][v, u]
        outward = np.column_stack([u, v]) - centre
        assert np.mean(np.sum(near[:, :2] * outward, axis=1) > 0) > 0.85  # one bump towards the camera
        centres.append(centre)
    assert np.linalg.norm(centres[0] - centres[1]) > 50
    assert np.linalg.norm(centres[1] - centres[2]) > 50


@pytest.mark.slow
def test_the_response_of_the_gel_predicts_presses_not_seen(real_data, tmp_path) -> None:
    gel = real_data / "gelsight" / "ball_presses"
    (tmp_path / "train").mkdir()
    order = np.random.default_rng(5).permutation(200)
    for number in order[:150]:
        (tmp_path / "train" / f"cal-{number}.jpg").symlink_to(gel / f"cal-{number}.jpg")
    corners = (33.0, 58.0, 208.0, 61.0, 56.0, 250.0, 185.0, 244.0)
    job = PressJob(
        tmp_path / "train",
        background=gel / "bg-0.jpg",
        labels=gel / "ball_position",
        corners=corners,
        size_mm=(24.0, 34.88),
        pixel_mm=0.1,
        ball_radius_mm=2.42,
        label_size=(240, 320),
    )
    options, result = job.options, calibrate_presses(job)
    rig, fit = result.rig, result.fit
    background = open_capture(job.background).frame(0).rgb
    processor = FrameProcessor(rig, ReconstructOptions(to=Product.NORMALS), background=background)
    errors = []
    for number in order[150:]:
        found = processor.process(open_capture(gel / f"cal-{number}.jpg").encoded(0)).normal_map
        u, v, radius = read_press_label(gel / "ball_position" / f"cal-{number}.txt")
        centre = np.array([u, v * found.shape[0] / 320]) + fit.label_offset_px
        ball_px = options.ball_radius_mm / options.side_mm
        truth, distance = press_on_ball(found.shape, *centre, ball_px)
        touched = distance < CONTACT_SHARE * radius
        errors.append(angles_deg(found.normals_in_camera[touched], truth[touched]))
    assert np.median(np.concatenate(errors)) < 6.8  # M alone: 9; normals without any error: 6.15

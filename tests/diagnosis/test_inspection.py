"""The doctor finds what ruins normals, and nothing where nothing is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.__main__ import main
from vntoolkit.cli import doctor
from vntoolkit.cli.output import print_table
from vntoolkit.diagnosis.finding import Level
from vntoolkit.diagnosis.inspection import findings_from_clipping, inspect_capture
from vntoolkit.diagnosis.rig_checks import check_camera
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear

# Three lights from 30 degrees round the axis, coloured red, green and blue with a tenth of cross-talk.
_AZIMUTHS = np.deg2rad([90.0, 210.0, 330.0])
_LIGHTS = np.stack([0.5 * np.cos(_AZIMUTHS), 0.5 * np.sin(_AZIMUTHS), -np.full(3, np.sqrt(0.75))], axis=1)
_MATRIX = 0.7 * (np.eye(3) * 0.9 + 0.05) @ _LIGHTS


@pytest.fixture
def rig() -> Rig:
    return Rig(camera=Camera.orthographic(width=120, height=100), response=LightResponse(matrix=_MATRIX))


@pytest.fixture
def picture(rig, rng) -> np.ndarray:
    """Linear colours (100, 120, 3) of waves whose normals stay in the light of all three lamps."""
    v, u = np.mgrid[:100, :120]
    first, second = 0.35 * np.cos((u + v) / 9.0), 0.2 * np.sin((u - 2 * v) / 17.0)
    slope_u, slope_v = first + second, first - 2 * second  # the gradient of a surface that exists
    normals = np.stack([slope_u, slope_v, -np.ones_like(slope_u)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return rgb_from_normals(normals, rig.response) + rng.normal(0, 0.002, (100, 120, 3))


def _store(path, linear, transfer="linear"):
    encoded = encoded_from_linear(np.clip(linear, 0, 1), Transfer.from_text(transfer))
    write_png(path, np.rint(encoded * 65535).astype(np.uint16))
    return path


def _texts(report, *severities):
    return [finding.text for finding in report.findings if finding.level in severities]


def test_good_footage_has_no_finding(tmp_path, picture, rig):
    report = inspect_capture(_store(tmp_path / "a.png", picture), rig=rig)
    assert report.findings == ()
    assert report.clipped_share == 0


def test_names_are_shown_as_they_are(tmp_path, picture, capsys):
    """Brackets and colons mean something to the library that draws the tables."""
    for name in ("take[red].png", "take[/].png", "take:b:1.png"):
        _store(tmp_path / name, picture)
        assert main(["doctor", str(tmp_path / name)]) == 0
        assert name in "".join(capsys.readouterr().out.split("\n"))
    print_table("[b]", ["[red]name", "n"], [["take[/].png", "[/]"]])
    assert capsys.readouterr().out.split() == ["[b]", "[red]name", "n", "take[/].png", "[/]"]


@pytest.mark.parametrize("curve", ["srgb", "bt709", "gamma:2.2"])
def test_a_curve_read_as_linear_is_found(tmp_path, picture, rig, curve):
    report = inspect_capture(_store(tmp_path / "a.png", picture, curve), rig=rig)
    (text,) = _texts(report, Level.WARNING, Level.FATAL)
    assert "the transfer curve looks like srgb, not linear" in text


def test_another_size_than_the_rigs_is_found(tmp_path, picture, rig):
    report = inspect_capture(_store(tmp_path / "a.png", picture[:50]), rig=rig)
    assert "the frames are 120×50, the rig's camera is 120×100" in _texts(report, Level.FATAL)[0]


def test_clipping_black_and_white_frames_are_found(tmp_path, picture):
    bright = np.clip(picture * 1.8, 0, 1)
    report = inspect_capture(_store(tmp_path / "a.png", bright))
    assert report.clipped_share == pytest.approx((bright == 1).any(axis=2).mean(), abs=1e-3)
    assert any("of the pixels are clipped" in text for text in _texts(report, Level.FATAL))
    for value, line in ((0.0, "frame 0 shows no subject"), (1.0, "100.0% of the pixels are clipped")):
        report = inspect_capture(_store(tmp_path / "a.png", np.full_like(picture, value)))
        assert any(line in text for text in _texts(report, Level.FATAL))


def test_lossless_rgb_video_is_praised_and_a_cut_one_named(tmp_path, picture):
    frames = [np.rint(np.clip(picture, 0, 1) * 65535).astype(np.uint16)] * 5
    write_video(tmp_path / "a.mkv", frames, 30)
    assert inspect_capture(tmp_path / "a.mkv").findings == ()
    content = (tmp_path / "a.mkv").read_bytes()
    (tmp_path / "a.mkv").write_bytes(content[: len(content) * 3 // 4])
    assert "it declares 5 frames, 3 came" in _texts(inspect_capture(tmp_path / "a.mkv"), Level.FATAL)[0]


def test_the_verb_prints_findings_and_sets_its_status(tmp_path, picture, rig, capsys, monkeypatch):
    write_rig(tmp_path / "rig.json", rig)
    _store(tmp_path / "a.png", picture[..., ::-1])
    assert main(["doctor", str(tmp_path / "a.png"), "--rig", str(tmp_path / "rig.json")]) == 1
    assert "red and blue exchanged" in capsys.readouterr().out
    _store(tmp_path / "a.png", np.zeros_like(picture))
    assert main(["doctor", str(tmp_path / "a.png")]) == 1
    monkeypatch.setattr(doctor, "_LIBRARIES", doctor._LIBRARIES[:2])
    assert main(["doctor"]) == 0
    assert main(["doctor", str(tmp_path / "none.mkv")]) == 1
    error = capsys.readouterr().err
    assert error.startswith("vntoolkit: ")
    assert error.count("\n") == 1


@pytest.mark.slow
def test_the_real_statues_are_right_as_they_are_and_found_when_swapped(tmp_path, real_data):
    """A response fitted on the grey ball serves the Buddha and the cat, which were lit alike."""
    folder = real_data / "coloured_light"
    ball, mask = read_image(folder / "gray_sphere.png") / 255.0, read_mask(folder / "gray_sphere.mask.png")
    v, u = np.nonzero(mask)
    radius = np.sqrt(mask.sum() / np.pi)
    x, y = (u - u.mean()) / radius, (v - v.mean()) / radius
    inside = x * x + y * y < 0.9
    normals = np.stack([x, y, -np.sqrt(np.clip(1 - x * x - y * y, 0, 1))], axis=1)[inside]
    colours = ball[mask][inside]
    lit = colours.min(axis=1) > 0.03
    matrix = np.linalg.lstsq(normals[lit], colours[lit], rcond=None)[0].T
    camera = Camera.orthographic(width=ball.shape[1], height=ball.shape[0])
    rig = Rig(camera=camera, response=LightResponse(matrix=matrix))
    for name in ("gray_sphere", "buddha", "cat"):
        surface = read_mask(folder / f"{name}.mask.png")
        right = inspect_capture(folder / f"{name}.png", rig=rig, mask=surface)
        assert _texts(right, Level.WARNING, Level.FATAL) == []
        write_png(tmp_path / "swapped.png", read_image(folder / f"{name}.png")[..., ::-1])
        swapped = inspect_capture(tmp_path / "swapped.png", rig=rig, mask=surface)
        assert "red and blue exchanged" in _texts(swapped, Level.FATAL)[0]


def test_the_real_gel_is_warned_about(real_data):
    report = inspect_capture(real_data / "gelsight" / "sequence")
    assert report.info.frame_count == 150
    assert (
        "chroma subsampling 4:2:0 costs nothing on smooth surfaces, and up to 7 degrees"
        in _texts(report, Level.WARNING)[0]
    )


def test_clipping_below_full_scale_is_found(rng):
    light = np.round(255 * rng.gamma(4.0, 0.1, (60, 80, 3)).clip(0, 0.95)).astype(np.float32) / 255
    light[light > 0.9] = 0.9 - light[light > 0.9] / 4
    nothing = np.zeros(light.shape[:2], bool)

    def found(rgb):
        return findings_from_clipping([LinearFrame(rgb=rgb, clipped=nothing)], None)

    assert not found(light)
    assert not found((np.round(178 + rng.normal(0, 1.5, light.shape)) / 255).astype(np.float32))  # a wall
    cut = light.copy()
    cut[..., 1] = np.minimum(light[..., 1], 0.6)
    (finding,) = found(cut)
    assert "the green channel ends at 60%" in finding.problem


def test_cameras_that_no_lens_can_be_are_named(rig):
    def found(matrix, model=CameraModel.PINHOLE, distortion=(0, 0, 0, 0)):
        camera = Camera(
            model=model, width=96, height=72, matrix=np.array(matrix), distortion=np.array(distortion, float)
        )
        return [finding.problem for finding in check_camera(replace(rig, camera=camera))]

    sound = [[338.0, 0, 47.5], [0, 338.0, 35.5], [0, 0, 1]]
    assert not found(sound)
    assert not found(sound, CameraModel.OPENCV, (-0.3, 0.1, 0.001, 0.001))
    for wrong, line in (
        ([[1014.0, 0, 47.5], [0, 338.0, 35.5], [0, 0, 1]], "focal lengths"),
        ([[338.0, 0, 0.5], [0, 338.0, 0.5], [0, 0, 1]], "principal point"),
        ([[338.0, 200.0, 47.5], [0, 338.0, 35.5], [0, 0, 1]], "skewed"),
    ):
        (problem,) = found(wrong)
        assert line in problem
    (problem,) = found([[50.0, 0, 47.5], [0, 50.0, 35.5], [0, 0, 1]], CameraModel.OPENCV, (-0.5, 0, 0, 0))
    assert "folds" in problem

"""Mattes frame by frame: from images, videos and patterns, and keyed from a clean plate."""

import json
from pathlib import Path

import av
import numpy as np
import pytest

from tests.pipeline.conftest import RESPONSE, SIZE, dome_normals, to_normals, write_dome_capture
from vntoolkit.__main__ import main
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.mattes import open_mattes
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.io.rigs import read_rig
from vntoolkit.live.frames import LiveProcessor
from vntoolkit.options.footage import Gaps, MatteOptions
from vntoolkit.photometry.response import rgb_from_normals

COUNT = 4


def _band(number: int) -> np.ndarray:
    """A matte that moves: another column of the picture for each frame."""
    band = np.zeros(SIZE, np.uint8)
    band[:, 12 + 8 * number : 20 + 8 * number] = 255
    return band


def _footage(folder: Path, first: int = 0) -> Path:
    folder.mkdir()
    write_dome_capture(folder, COUNT)
    for number in reversed(range(COUNT if first else 0)):
        (folder / f"f{number}.png").rename(folder / f"f{number + first}.png")
    return folder


def _masks(footage: Path, mattes: Path, **options) -> dict[int, np.ndarray]:
    capture = open_capture(footage, CaptureOptions(gaps=Gaps.SKIP))
    found = open_mattes(capture, mattes, MatteOptions(**options))
    there = set(range(len(capture))) - set(found.missing(range(len(capture))))
    return {frame.number: found.of(frame) for frame in capture.encoded_frames() if frame.number in there}


@pytest.mark.parametrize("kind", ["folder", "pattern", "colour video", "grey video"])
def test_each_frame_has_its_own_matte(tmp_path, kind):
    footage, mattes = _footage(tmp_path / "take"), tmp_path / "mattes"
    mattes.mkdir()
    if "video" not in kind:
        for number in range(COUNT):
            write_png(mattes / f"m_{number:03d}.png", _band(number))
        mattes = mattes / "m_%03d.png" if kind == "pattern" else mattes
    elif kind == "colour video":
        mattes = mattes / "m.mkv"
        write_video(mattes, [np.repeat(_band(number)[..., None], 3, 2) for number in range(COUNT)], 25)
    else:
        mattes = mattes / "m.mkv"
        with av.open(str(mattes), "w") as container:
            stream = container.add_stream("ffv1", rate=25)
            stream.height, stream.width, stream.pix_fmt = *SIZE, "gray"
            for number in range(COUNT):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(_band(number), format="gray")))
            container.mux(stream.encode(None))
    masks = _masks(footage, mattes)
    assert list(masks) == list(range(COUNT))
    for number, mask in masks.items():
        np.testing.assert_array_equal(mask, _band(number) > 0)


@pytest.mark.parametrize(("frames", "mattes", "first"), [(5, 5, 0), (0, 2, 2), (3, 0, 0)])
def test_numbered_files_belong_together_by_their_numbers(tmp_path, frames, mattes, first):
    """Frames from `frames` on, mattes from `mattes` on, four of each: the first pair is frame `first`."""
    footage = _footage(tmp_path / "take", frames)
    (tmp_path / "mattes").mkdir()
    for number in range(COUNT):
        write_png(tmp_path / f"mattes/m{number + mattes}.png", _band(number))
    masks = _masks(footage, tmp_path / "mattes")
    assert min(masks) == first
    for number, mask in masks.items():
        np.testing.assert_array_equal(mask, _band(number + frames - mattes) > 0)


@pytest.mark.parametrize(("first", "count"), [(0, 4), (1, 4), (100, 4), (0, 3), (1, 2)])
def test_mattes_of_a_video_are_numbered_from_nought_or_one(tmp_path, first, count):
    write_video(tmp_path / "a.mkv", [np.zeros((*SIZE, 3), np.uint8)] * COUNT, 25)
    (tmp_path / "mattes").mkdir()
    for number in range(count):
        write_png(tmp_path / f"mattes/m{number + first:03d}.png", _band(number))
    masks = _masks(tmp_path / "a.mkv", tmp_path / "mattes")
    assert list(masks) == list(range(count))
    for number, mask in masks.items():
        np.testing.assert_array_equal(mask, _band(number) > 0)


@pytest.mark.parametrize("level", [0.2, 0.5, 0.8])
def test_soft_edges_are_cut_at_the_level(tmp_path, level):
    footage = _footage(tmp_path / "take")
    ramp = np.tile(np.arange(SIZE[1], dtype=np.uint8) * 4, (SIZE[0], 1))
    (tmp_path / "mattes").mkdir()
    for number in range(COUNT):
        write_png(tmp_path / f"mattes/{number}.png", ramp)
    write_png(tmp_path / "still.png", ramp)
    for mattes in (tmp_path / "mattes", tmp_path / "still.png"):
        for mask in _masks(footage, mattes, mask_level=level).values():
            np.testing.assert_array_equal(mask, ramp > level * 255)


def test_mattes_that_do_not_fit_are_refused(tmp_path):
    capture = open_capture(_footage(tmp_path / "take"))
    (tmp_path / "small").mkdir()
    (tmp_path / "far").mkdir()
    for number in (7, 8):
        write_png(tmp_path / f"small/{number}.png", np.full((4, 4), 255, np.uint8))
        write_png(tmp_path / f"far/{number}.png", _band(0))
    with pytest.raises(BadCapture, match="the mattes are 4×4, the capture 64×48"):
        open_mattes(capture, tmp_path / "small")
    with pytest.raises(BadCapture, match="the frames are 0 to 3, the mattes 7 to 8; name them alike"):
        open_mattes(capture, tmp_path / "far")
    with pytest.raises(BadCapture, match="--key needs --background"):
        open_mattes(capture, None, MatteOptions(key=0.1))
    with pytest.raises(BadCapture, match="expected no matte a frame beside it"):
        open_mattes(capture, tmp_path / "take", MatteOptions(key=0.1), tmp_path / "take/f0.png")


def test_frames_without_a_matte_are_named(tmp_path, capsys):
    footage, mattes = _footage(tmp_path / "take"), tmp_path / "mattes"
    mattes.mkdir()
    for number in (0, 1, 3):
        write_png(mattes / f"m{number}.png", np.full(SIZE, 255, np.uint8))
    command = to_normals(tmp_path, footage, "--mask", str(mattes))
    assert main(command) == 1
    assert "1 frames have no matte: 2" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "out").exists()
    assert main([*command, "--gaps", "skip"]) == 0
    said = capsys.readouterr().out
    assert "skipped frame 2: no matte" in said
    assert "3 of 4 frames done" in said
    assert len(list((tmp_path / "out/normals").iterdir())) == 3
    write_png(mattes / "m1.png", _band(1))  # the manifest knows the mattes
    assert main([*command, "--gaps", "skip"]) == 1
    assert "the file of --mask" in " ".join(capsys.readouterr().err.split())


def test_a_clean_plate_keys_the_subject(tmp_path):
    """A lit backdrop behind the dome: the key leaves the dome's pixels and few of the backdrop's."""
    backdrop = rgb_from_normals(np.array([0.1, -0.2, -0.97]), RESPONSE).clip(0, 1)
    plate = np.broadcast_to(0.4 * backdrop, (*SIZE, 3))
    (tmp_path / "take").mkdir()
    domes = []
    for number in range(2):
        normals, dome = dome_normals(31.5 + number)
        light = np.where(dome[..., None], rgb_from_normals(normals, RESPONSE), plate).clip(0, 1)
        write_png(tmp_path / f"take/f{number}.png", np.rint(65535 * light).astype(np.uint16))
        domes.append((normals, dome))
    write_png(tmp_path / "plate.png", np.rint(65535 * plate).astype(np.uint16))
    more = ["--background", str(tmp_path / "plate.png"), "--key", "0.05", "--allow", "noise"]
    assert main(to_normals(tmp_path, tmp_path / "take", *more)) == 0
    for number, (normals, dome) in enumerate(domes):
        found = read_normal_map(tmp_path / f"out/normals/{number:06d}.exr")
        assert found.mask[dome].mean() > 0.97
        assert found.mask[~dome].mean() < 0.08  # the window widens the outline by a pixel
        both = found.mask & dome
        cosine = (found.normals_in_camera[both] * normals[both]).sum(1).clip(-1, 1)
        assert np.rad2deg(np.arccos(cosine)).mean() < 0.5  # the plate is not subtracted
    options = json.loads((tmp_path / "out/reconstruction.json").read_text())["options"]
    assert options["matte.key"] == 0.05
    rig, *key = str(tmp_path / "rig.json"), *more[:4]
    capture = open_capture(tmp_path / "take")
    live = LiveProcessor(read_rig(Path(rig)), background=open_capture(key[1]).encoded(0), key=0.05)
    np.testing.assert_array_equal(live.process(capture.encoded(0)).normal_map.mask[domes[0][1]], True)
    with pytest.raises(BadInput, match="--key needs a --background"):
        LiveProcessor(read_rig(Path(rig)), key=0.05)


def test_doctor_judges_inside_the_mattes(tmp_path, capsys):
    footage = _footage(tmp_path / "take")
    rig = to_normals(tmp_path, footage)[3]
    (tmp_path / "mattes").mkdir()
    for number in range(COUNT):
        outside = np.where(dome_normals(31.5)[1], 0, 255).astype(np.uint8)
        write_png(tmp_path / f"mattes/{number}.png", outside)
    assert main(["doctor", str(footage), "--rig", rig, "--mask", str(tmp_path / "mattes")]) == 1
    assert "[mask]" in capsys.readouterr().out
    assert main(["doctor", str(footage), "--rig", rig, "--key", "0.1"]) == 1
    assert "--key needs --background" in capsys.readouterr().err


def test_a_session_finds_the_mattes_of_each_capture_by_its_name(tmp_path, capsys):
    takes = [str(_footage(tmp_path / name)) for name in ("one", "two")]
    (tmp_path / "masks/two").mkdir(parents=True)
    for number in range(COUNT):
        write_png(tmp_path / f"masks/two/m{number}.png", _band(number))
    command = ["session", *takes, *to_normals(tmp_path, tmp_path)[2:], "--mask", str(tmp_path / "masks")]
    assert main(command) == 1
    assert "expected one mask, video or folder of mattes named one, got none" in capsys.readouterr().err
    write_png(tmp_path / "masks/one.png", _band(1))
    assert main(command) == 0
    for name, column in (("one", 20), ("two", 36)):
        found = read_normal_map(tmp_path / f"out/{name}/normals/000003.exr").mask
        assert found[:, column : column + 8].any()
        assert not np.delete(found, np.s_[column : column + 8], axis=1).any()

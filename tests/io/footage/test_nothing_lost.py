"""Frames that are missing, cut off or of another name are said, and what is there is kept."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.io.footage.test_stated_facts import film
from tests.pipeline.conftest import SIZE, to_normals, write_dome_capture
from vntoolkit.__main__ import main
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.footage.sequence import find_capture_files
from vntoolkit.options.footage import Gaps


def _stills(folder: Path, *names: str) -> Path:
    folder.mkdir(exist_ok=True)
    for name in names:
        write_png(folder / name, np.full((3, 4, 3), 90, np.uint8))
    return folder


@pytest.mark.parametrize("source", ["", "f_%02d.png", "f_*.png"])
def test_a_gap_is_refused_or_keeps_the_numbers(tmp_path, source):
    """3 and 6 of 1 to 8 are missing: the others are frames 0, 1, 3, 4, 6 and 7."""
    _stills(tmp_path, *(f"f_{k:02d}.png" for k in (1, 2, 4, 5, 7, 8)))
    with pytest.raises(BadCapture, match=r"2 of 8 files of the sequence are missing: f_03\.png, f_06\.png"):
        open_capture(tmp_path / source)
    capture = open_capture(tmp_path / source, CaptureOptions(gaps=Gaps.SKIP))
    assert [frame.number for frame in capture.frames()] == [0, 1, 3, 4, 6, 7]
    assert [Path(frame.name).name for frame in capture.encoded_frames(3, 7)] == [
        "f_04.png", "f_05.png", "f_07.png",
    ]  # fmt: skip
    assert (len(capture), capture.frame(7).number) == (8, 7)
    with pytest.raises(BadCapture, match=r"frame 2 is missing: no file f_03\.png"):
        capture.frame(2)


@pytest.mark.parametrize(
    "names",
    [
        ("a_10.png", "a_20.png", "a_30.png"),  # every tenth frame
        ("c1_1000.png", "c1_1033.png", "c1_1067.png"),  # milliseconds
        ("front.png", "left.png", "side2.png"),
        ("t_59_998.png", "t_59_999.png", "t_60_001.png", "t_60_004.png"),  # a clock
        ("9.png", "10.png", "11.png"),
    ],
)
def test_names_that_count_no_frames_have_no_gaps(tmp_path, names):
    capture = open_capture(_stills(tmp_path, *names))
    assert [Path(frame.name).name for frame in capture.encoded_frames()] == list(names)
    assert [frame.number for frame in capture.frames()] == list(range(len(names)))


def test_images_of_other_names_are_left_out_and_named(tmp_path):
    found = find_capture_files(_stills(tmp_path, "f1.png", "f2.png", "mask.png", "thumb_f1.png", "f1.bmp"))
    assert [path.name for path in found.files] == ["f1.png", "f2.png"]
    assert [path.name for path in found.left_out] == ["f1.bmp", "mask.png", "thumb_f1.png"]
    with pytest.raises(BadCapture, match="holds 2 series of images"):
        find_capture_files(_stills(tmp_path / "two", "l1.png", "l2.png", "r1.png", "r2.png"))


def test_stills_have_no_rate(tmp_path):
    assert open_capture(_stills(tmp_path, "f1.png", "f2.png")).info.frame_rate_hz is None


def _run(tmp_path: Path, verb: str, source: Path, *more: str) -> int:
    """Noise is what these videos show."""
    return main([verb, *to_normals(tmp_path, source, *more, "--allow", "noise")[1:]])


def test_gaps_and_names_reach_manifest_report_and_doctor(tmp_path, capsys, caplog):
    folder = tmp_path / "take"
    folder.mkdir()
    write_dome_capture(folder, 4)
    (folder / "f2.png").unlink()
    _stills(folder, "mask.png")
    assert _run(tmp_path, "reconstruct", folder) == 1
    assert not (tmp_path / "out").exists()
    assert _run(tmp_path, "reconstruct", folder, "--gaps", "skip", "--smoothing", "0.01") == 0
    said = capsys.readouterr().out
    assert "skipped frame 2: no file f2.png" in said
    assert "3 of 4 frames done" in said
    assert "left out, since the frames are named otherwise: mask.png" in caplog.text
    assert sorted(path.name for path in (tmp_path / "out/normals").iterdir()) == [
        "000000.exr", "000001.exr", "000003.exr",
    ]  # fmt: skip
    entry = json.loads((tmp_path / "out/reconstruction.json").read_text())["input"]
    assert [file["file"] for file in entry["files"]] == ["f0.png", "f1.png", "f3.png"]
    assert (entry["numbers"], entry.get("frame_rate_hz")) == ([0, 1, 3], None)
    assert main(["doctor", str(folder)]) == 1
    said = capsys.readouterr().out
    assert "1 of 4 files of the sequence are missing: f2.png" in said
    assert "mask.png" in said


@pytest.mark.parametrize(
    ("name", "codec", "pixels"),
    [("a.mkv", "ffv1", "bgr0"), ("a.mkv", "libx264", "yuv444p"), ("a.avi", "mjpeg", "yuvj444p")],
)
def test_a_cut_off_video_keeps_what_came_and_says_what_is_lost(tmp_path, rng, capsys, name, codec, pixels):
    film(tmp_path / name, rng.integers(60, 200, (8, *SIZE, 3), dtype=np.uint8), codec, pixels)
    content = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(content[: int(0.6 * len(content))])
    capture = open_capture(tmp_path / name)
    came = len(capture)
    assert capture.info.promised_frame_count == 8
    assert 2 <= came <= 5
    assert _run(tmp_path, "reconstruct", tmp_path / name) == 1
    said = capsys.readouterr()
    assert f"{came} of 8 frames done" in said.out
    assert f"the video is cut off: it declares 8 frames, {came} came" in said.err
    assert len(list((tmp_path / "out/normals").iterdir())) == came
    entry = json.loads((tmp_path / "out/reconstruction.json").read_text())["input"]
    assert (entry["frame_count"], entry["declared_frame_count"]) == (came, 8)
    assert _run(tmp_path, "reconstruct", tmp_path / name, "--frames", f"0:{came}") == 0
    capsys.readouterr()
    assert main(["doctor", str(tmp_path / name)]) == 1
    assert f"declares 8 frames, {came} came" in " ".join(capsys.readouterr().out.split())
    assert _run(tmp_path, "session", tmp_path / name, "--overwrite") == 1
    assert f"{came} of 8 frames done; the video is cut off" in capsys.readouterr().out

"""Camera video read in parts, in any order, gives the frames of one pass; going on costs no seek."""

import subprocess
import sys

import numpy as np
import pytest

from tests.io.footage.test_stated_facts import film
from vntoolkit.io.footage import video
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.video import VideoReader, write_video
from vntoolkit.io.footage.video_index import index_of_stream

_COUNT = 40


@pytest.fixture(scope="module")
def camera_video(tmp_path_factory):
    """H.264 with frames that depend on later ones and two key frames, as cameras write it."""
    path = tmp_path_factory.mktemp("camera") / "a.mp4"
    rng = np.random.default_rng(0)
    still = rng.integers(0, 200, (64, 96, 3), dtype=np.uint8)
    options = {"g": "25", "keyint_min": "25", "sc_threshold": "0", "bf": "2", "crf": "10"}
    frames = [np.roll(still, k, axis=1) + np.uint8(k) for k in range(_COUNT)]
    film(path, frames, "libx264", "yuv444p", **options)
    return path


@pytest.fixture(scope="module")
def whole(camera_video):
    return [frame.values for frame in open_capture(camera_video).encoded_frames()]


@pytest.mark.parametrize(
    "parts",
    [
        [(0, 16), (16, 32), (32, 40)],  # blocks in order
        [(0, 8), (12, 20), (24, 30)],  # gaps, one over a key frame
        [(30, 34), (2, 6), (6, 7), (39, 40), (0, 1)],  # back and forth
        [(5, 9), (5, 9), (9, 10), (8, 9)],  # the same again
    ],
)
def test_parts_equal_one_pass(camera_video, whole, parts):
    capture = open_capture(camera_video)
    for start, stop in parts:
        read = list(capture.encoded_frames(start, stop))
        assert [frame.number for frame in read] == list(range(start, stop))
        for frame in read:
            np.testing.assert_array_equal(frame.values, whole[frame.number])


def test_a_part_left_early_does_not_spoil_the_next(camera_video, whole):
    capture = open_capture(camera_video)
    abandoned = capture.encoded_frames(0, 20)
    next(abandoned)
    np.testing.assert_array_equal(next(capture.encoded_frames(10, 12)).values, whole[10])
    np.testing.assert_array_equal(next(abandoned).values, whole[1])


def test_going_on_opens_the_file_no_more(camera_video, monkeypatch):
    reader = VideoReader(camera_video)
    assert reader.index.key_frames == (0, 25)
    list(reader.frames(0, 4))
    opened = []
    decoded = reader._decoded
    monkeypatch.setattr(reader, "_decoded", lambda time, **how: opened.append(time) or decoded(time, **how))
    list(reader.frames(4, 8))
    list(reader.frames(12, 16))  # between key frames it is shorter to decode what is skipped
    assert opened == []
    list(reader.frames(30, 31))  # over a key frame it is not
    list(reader.frames(3, 5))
    assert len(opened) == 2


def test_a_decoder_that_waits_does_not_complain_when_the_program_ends(camera_video):
    script = (
        "import sys; from vntoolkit.io.footage.captures import open_capture\nc = open_capture(sys.argv[1]); "
    )
    command = [sys.executable, "-c", script + "list(c.frames(0, 3))", str(camera_video)]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    assert ended.stderr == ""


def test_an_index_is_kept_until_the_file_changes(tmp_path, rng, monkeypatch):
    frames = list(rng.integers(0, 255, (6, 16, 24, 3), dtype=np.uint8))
    write_video(tmp_path / "a.mkv", frames, 25)
    read = []
    monkeypatch.setattr(video, "index_of_stream", lambda *a, **k: read.append(a) or index_of_stream(*a, **k))
    assert len(VideoReader(tmp_path / "a.mkv").index.times) == 6
    assert len(VideoReader(tmp_path / "a.mkv").index.times) == 6
    assert len(read) == 1
    write_video(tmp_path / "a.mkv", frames[:4], 25)
    assert len(VideoReader(tmp_path / "a.mkv").index.times) == 4
    assert len(read) == 2

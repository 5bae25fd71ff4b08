"""Plausibility looks at few frames, quick to reach, and at few pixels of a large one, and still sees."""

import av
import numpy as np
import pytest
from simulated_captures import simulate_capture

from vntoolkit.io import rig_match
from vntoolkit.io.captures import CaptureOptions, open_capture
from vntoolkit.io.plausibility import findings_from_capture, frames_to_compare
from vntoolkit.io.video import write_video


@pytest.fixture(scope="module")
def camera_video(tmp_path_factory):
    """40 frames of H.264, key frames 0 and 25."""
    path = tmp_path_factory.mktemp("camera") / "a.mp4"
    options = {"g": "25", "keyint_min": "25", "sc_threshold": "0"}
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=30, options=options)
        stream.width, stream.height, stream.pix_fmt = 48, 32, "yuv444p"
        for k in range(40):
            picture = np.full((32, 48, 3), 3 * k, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode())
    return open_capture(path)


@pytest.mark.parametrize(
    ("numbers", "expected"),
    [
        (range(40), [0, 8, 16, 25, 31, 39]),  # 23 moved to the key frame beside it
        (range(26, 36), [26, 28, 30, 31, 33, 35]),  # a key frame before the first is none of those asked for
        (range(7), [0, 1, 2, 4, 5, 6]),
        (range(3), [0, 1, 2]),
    ],
)
def test_frames_are_spread_and_moved_to_key_frames_nearby(camera_video, numbers, expected):
    assert frames_to_compare(camera_video, numbers) == expected


@pytest.mark.parametrize("seed", range(4))
def test_a_ninth_of_the_pixels_tells_the_same(tmp_path, monkeypatch, seed):
    capture = simulate_capture(seed)
    full = (np.clip(capture.frames, 0, 1) * 65535).astype(np.uint16)
    write_video(tmp_path / "right.mkv", full, 25)
    write_video(tmp_path / "swapped.mkv", full[..., ::-1], 25)
    monkeypatch.setattr(rig_match, "_ENOUGH_PIXELS", full[0, ..., 0].size // 9)

    def findings(name):
        opened = open_capture(tmp_path / name, CaptureOptions(transfer=capture.rig.transfer))
        return findings_from_capture(opened, capture.rig, capture.subject)

    assert findings("right.mkv") == []
    (found,) = findings("swapped.mkv")
    assert "red and blue look exchanged" in found

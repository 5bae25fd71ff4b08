"""Plausibility looks at few frames, quick to reach, and at few pixels of a large one, and still sees."""

import numpy as np
import pytest

from tests.faults.simulated_captures import simulate_capture
from tests.io.footage.test_stated_facts import film
from vntoolkit.diagnosis import evidence
from vntoolkit.diagnosis.evidence import averaged_down
from vntoolkit.diagnosis.inspection import examine_capture, frames_to_compare
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.video import write_video
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse, ResponseVariation, rgb_from_normals
from vntoolkit.photometry.rig import Rig


@pytest.fixture(scope="module")
def camera_video(tmp_path_factory):
    """40 frames of H.264, key frames 0 and 25."""
    path = tmp_path_factory.mktemp("camera") / "a.mp4"
    options = {"g": "25", "keyint_min": "25", "sc_threshold": "0"}
    film(path, [np.full((32, 48, 3), 3 * k, np.uint8) for k in range(40)], "libx264", "yuv444p", **options)
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
def test_frames_averaged_down_tell_the_same(tmp_path, monkeypatch, seed):
    capture = simulate_capture(seed)
    full = (np.clip(capture.frames, 0, 1) * 65535).astype(np.uint16)
    write_video(tmp_path / "right.mkv", full, 25)
    write_video(tmp_path / "swapped.mkv", full[..., ::-1], 25)
    few = full[0, ..., 0].size // 4

    def quarter(frame, most_pixels=few):
        return averaged_down(frame, min(most_pixels, few))

    monkeypatch.setattr(evidence, "averaged_down", quarter)

    def findings(name):
        opened = open_capture(tmp_path / name, CaptureOptions(transfer=capture.rig.transfer))
        return examine_capture(opened, capture.rig, capture.subject).findings

    assert findings("right.mkv") == []
    (found,) = findings("swapped.mkv")
    assert "red and blue exchanged" in found.text


def test_a_response_that_varies_is_asked_where_the_pixels_kept_are():
    """A ball under lights whose strength changes over the picture, seen by averaged pixels."""
    width, height = 1000, 900
    v, u = np.mgrid[:height, :width]
    x, y = (u - 500) / 420, (v - 450) / 420
    inside = x**2 + y**2 < 0.6
    normals = np.stack([x, y, -np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))], axis=-1) * inside[..., None]
    matrix = np.array([[0.3, 0.0, -0.5], [-0.15, 0.25, -0.5], [-0.15, -0.25, -0.5]])
    variation = ResponseVariation(
        powers=np.array([[1, 0], [0, 1]]),
        matrices=np.stack([0.3 * matrix * [1, 0.5, 1], -0.2 * matrix]),
        ambients=np.zeros((2, 3)),
        centre_px=np.array([500.0, 450.0]),
        scale_px=500.0,
    )
    response = LightResponse(matrix=matrix, variation=variation)
    rgb = np.where(inside[..., None], rgb_from_normals(normals, response), 0).astype(np.float32)
    rig = Rig(camera=Camera.orthographic(width=width, height=height), response=response)
    frame = LinearFrame(rgb=rgb, clipped=np.zeros((height, width), np.bool_))
    seen = evidence.evidence_from_frames([frame], rig, rig.transfer, inside)
    assert seen.scale < 0.5
    lengths = np.linalg.norm(evidence.scaled_normals(seen, seen.light[0]), axis=2)[seen.surface[0]]
    np.testing.assert_allclose(lengths, 1.0, atol=2e-3)

"""Flow between two normal maps: both find a shift, and only what was found counts."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tests.tracking.wrinkled_video import WrinkledVideo
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.tracking.flow import flow_between, flow_from_tracks

SHIFT = np.array([1.5, -1.0])


def pair(mask: np.ndarray | None = None, shift: np.ndarray = SHIFT) -> tuple[NormalMap, NormalMap]:
    video = WrinkledVideo(width=96, height=72, sway_px=0.0, bend=0.0, drift_px=shift)
    return video.maps(0, mask)[0], video.maps(1, mask)[0]


def test_a_shift_is_found() -> None:
    error = np.linalg.norm(flow_between(*pair()) - SHIFT, axis=2)[12:-12, 12:-12]
    assert np.percentile(error, 95) < 0.1


def test_nothing_moves_without_a_surface() -> None:
    nothing = np.zeros((72, 96), dtype=bool)
    assert not flow_between(pair()[0], pair(nothing)[1]).any()


def test_the_residual_of_a_point_that_was_not_found_is_not_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenCV leaves it undefined: it is whatever lay in that memory."""
    found_by_opencv = cv2.calcOpticalFlowPyrLK
    half_flat = tuple(
        NormalMap(
            normals_in_camera=np.where(np.arange(96)[:, None] < 40, frame.normals_in_camera, [0, 0, -1.0]),
            mask=frame.mask,
        )
        for frame in pair(shift=6 * SHIFT)  # too far for Lucas–Kanade alone
    )
    flows = []
    for leftover in (0.0, 1e9, np.nan):

        def follow(*arguments, leftover=leftover, **named):  # type: ignore[no-untyped-def]
            ended, status, residual = found_by_opencv(*arguments, **named)
            assert np.count_nonzero(status == 0) > 0
            return ended, status, np.where(status > 0, residual, np.float32(leftover))

        monkeypatch.setattr(cv2, "calcOpticalFlowPyrLK", follow)
        flows.append(flow_between(*half_flat))
    np.testing.assert_array_equal(flows[1], flows[0])
    np.testing.assert_array_equal(flows[2], flows[0])


def test_tracks_go_on_as_they_went() -> None:
    before = np.stack(np.meshgrid(np.arange(96.0), np.arange(72.0)), axis=-1).reshape(-1, 2)
    flow = flow_from_tracks(before, before + SHIFT, (72, 96))
    assert flow.shape == (72, 96, 2)
    np.testing.assert_allclose(flow, np.broadcast_to(SHIFT, flow.shape), atol=1e-5)

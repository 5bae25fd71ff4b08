"""Track error on a plane whose motion is known."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.track_error import (
    TrackedPixels,
    anchors_on_mesh,
    track_errors,
    visible,
)
from vntoolkit.geometry.camera import Camera

CAMERA = Camera.pinhole(width=64, height=48, focal_px=60.0)
CORNERS = np.array([[-1.0, -0.8, 2.0], [1.0, -0.8, 3.0], [-1.0, 0.8, 2.0], [1.0, 0.8, 3.0]])
FACES = np.array([[0, 2, 1], [1, 2, 3]], dtype=np.int32)
PIXELS = np.stack(np.meshgrid(np.arange(15, 45.0, 3), np.arange(12, 36.0, 3)), -1).reshape(-1, 2)


def test_anchors_give_back_their_pixels_and_move_with_the_mesh() -> None:
    anchors = anchors_on_mesh(PIXELS, CORNERS, FACES, CAMERA)
    assert anchors.found.all()
    np.testing.assert_allclose(CAMERA.project(anchors.points(CORNERS)), PIXELS, atol=1e-9)
    shift = np.array([0.1, -0.2, 0.3])
    np.testing.assert_allclose(anchors.points(CORNERS + shift), anchors.points(CORNERS) + shift, atol=1e-12)


def tracked(frame: int, points: np.ndarray, uncertainty_px: np.ndarray | None = None) -> TrackedPixels:
    return TrackedPixels(frame=frame, positions_px=CAMERA.project(points), uncertainty_px=uncertainty_px)


def test_the_error_is_the_one_put_in() -> None:
    anchors = anchors_on_mesh(PIXELS, CORNERS, FACES, CAMERA)
    moved = CORNERS + np.array([0.05, 0.0, 0.0])
    true = anchors.points(moved)
    off = CAMERA.unproject(CAMERA.project(true) + np.array([0.6, 0.8]), true[:, 2])
    truth = [(0, moved), (1, moved)]
    errors = list(track_errors([tracked(0, true), tracked(1, off)], truth, anchors, FACES, CAMERA))
    assert errors[0].median_px == pytest.approx(0.0, abs=1e-9)
    assert errors[1].median_px == pytest.approx(1.0)
    assert errors[1].p95_px == pytest.approx(1.0)
    assert errors[1].outliers == 0.0
    far = CAMERA.unproject(CAMERA.project(true) + np.array([5.0, 0.0]), true[:, 2])
    far_off = next(iter(track_errors([tracked(0, far)], truth[:1], anchors, FACES, CAMERA)))
    assert (far_off.outliers, far_off.lost) == (1.0, 0.0)


def test_lost_vertices_are_judged_all_the_same_and_told_apart() -> None:
    anchors = anchors_on_mesh(PIXELS, CORNERS, FACES, CAMERA)
    true = anchors.points(CORNERS)
    left = PIXELS[:, 0] < 25
    pixels = CAMERA.project(true) + np.where(left[:, None], [8.0, 0.0], [0.0, 1.0])
    unsure = TrackedPixels(frame=0, positions_px=pixels, uncertainty_px=np.where(left, 9.0, 0.5))
    error = next(iter(track_errors([unsure], [(0, CORNERS)], anchors, FACES, CAMERA)))
    assert error.vertices == len(PIXELS)
    assert error.outliers == pytest.approx(left.mean())
    assert error.lost == pytest.approx(left.mean())
    assert error.p95_px == pytest.approx(8.0)
    assert error.found_median_px == pytest.approx(1.0)
    assert error.found_p95_px == pytest.approx(1.0)


def test_a_tracker_that_declares_all_lost_gains_nothing() -> None:
    anchors = anchors_on_mesh(PIXELS, CORNERS, FACES, CAMERA)
    pixels = CAMERA.project(anchors.points(CORNERS)) + np.array([8.0, 0.0])
    nothing = TrackedPixels(frame=0, positions_px=pixels, uncertainty_px=np.full(len(pixels), np.inf))
    error = next(iter(track_errors([nothing], [(0, CORNERS)], anchors, FACES, CAMERA)))
    assert (error.lost, error.outliers, error.vertices) == (1.0, 1.0, len(PIXELS))
    assert error.median_px == pytest.approx(8.0)
    assert np.isnan(error.found_p95_px)


def test_hidden_points_are_not_judged() -> None:
    anchors = anchors_on_mesh(PIXELS, CORNERS, FACES, CAMERA)
    front = np.array([[-3.0, -3.0, 1.0], [0.0, -3.0, 1.0], [-3.0, 3.0, 1.0], [0.0, 3.0, 1.0]])
    vertices, faces = np.vstack([CORNERS, front]), np.vstack([FACES, FACES + 4]).astype(np.int32)
    seen = visible(anchors.points(CORNERS), vertices, faces, CAMERA)
    left = PIXELS[:, 0] < 31.5
    assert not seen[left].any()
    assert seen[~left].all()


def test_other_frames_are_refused() -> None:
    anchors = anchors_on_mesh(PIXELS, CORNERS, FACES, CAMERA)
    points = anchors.points(CORNERS)
    with pytest.raises(BadInput, match="expected the true frame 1, got frame 2"):
        list(track_errors([tracked(1, points)], [(2, CORNERS)], anchors, FACES, CAMERA))
    with pytest.raises(BadInput, match="lost_px: expected a positive number, got -1"):
        list(track_errors([], [], anchors, FACES, CAMERA, -1.0))

"""Camera from corners of known boards: as many terms of distortion as are asked for, in their order."""

import numpy as np
import pytest

from vntoolkit.calibration import board
from vntoolkit.calibration.board import fit_camera
from vntoolkit.calibration.board_detection import BoardSighting
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rigid import RigidTransform

LAYOUT = BoardLayout()
LONG = BoardLayout(columns=31, rows=5, hole_squares=1)
MATRIX = np.array([[800.0, 0, 322], [0, 805, 236], [0, 0, 1]])
DISTORTION = np.array([-0.09, 0.05, 0.0, 0.0])  # k1, k2, p1, p2


def sightings(rng: np.random.Generator, noise_px: float = 0.02) -> list[BoardSighting]:
    camera = Camera(model=CameraModel.OPENCV, width=640, height=480, matrix=MATRIX, distortion=DISTORTION)
    ids = LAYOUT.sound_corner_ids
    corners = np.column_stack([LAYOUT.corners_mm[ids], np.zeros(len(ids))])
    middle = np.array([LAYOUT.width_mm, LAYOUT.height_mm, 0.0]) / 2
    seen = []
    for number in range(20):
        rotation = RigidTransform.from_rotation_vector(rng.uniform(-0.6, 0.6, 3))
        centre = np.array([*rng.uniform(-60, 60, 2), rng.uniform(320, 420)])
        pose = RigidTransform(rotation=rotation.rotation, translation=centre - rotation.apply(middle))
        corners_px = camera.project(pose.apply(corners)) + rng.normal(0, noise_px, (len(ids), 2))
        seen.append(BoardSighting(number=number, corner_ids=ids, corners_px=corners_px, rgb=None))
    return seen


def test_terms_of_distortion_come_back_in_their_order(rng: np.random.Generator) -> None:
    camera = fit_camera(sightings(rng), LAYOUT, (640, 480), 2)
    np.testing.assert_allclose(camera.matrix, MATRIX, atol=0.5)
    np.testing.assert_allclose(camera.distortion, DISTORTION, rtol=0.1)


def test_terms_that_are_not_asked_for_stay_zero(rng, monkeypatch):
    seen = sightings(rng)
    one = fit_camera(seen, LAYOUT, (640, 480), 1)
    assert one.distortion[0] != 0
    assert not one.distortion[1:].any()
    monkeypatch.setattr(board, "_LARGEST_FIT_ERROR_PX", 5.0)
    none = fit_camera(seen, LAYOUT, (640, 480), 0)
    assert none.model is CameraModel.PINHOLE
    monkeypatch.setattr(board, "_LARGEST_FIT_ERROR_PX", 0.1)
    with pytest.raises(BadCalibration, match="misses the corners by"):
        fit_camera(seen, LAYOUT, (640, 480), 0)


def test_a_single_row_of_corners_tells_no_camera() -> None:
    ids = np.intersect1d(LONG.sound_corner_ids, np.arange(LONG.columns - 1))
    row = BoardSighting(number=0, corner_ids=ids, corners_px=3.0 * LONG.corners_mm[ids], rgb=None)
    with pytest.raises(BadCalibration, match="0 frames show the board well enough"):
        fit_camera([row] * 6, LONG, (640, 480))

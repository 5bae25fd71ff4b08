"""A board carried through the field under near lights: M that varies fits it, one M does not."""

import numpy as np
import pytest

from vntoolkit.calibration.board import fit_response_to_board
from vntoolkit.calibration.board_detection import BoardSighting
from vntoolkit.calibration.varying import fit_varying_response
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.board_layout import NORMAL_IN_BOARD, BoardLayout
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.calibration import BoardOptions, ResponseFitOptions

LAYOUT = BoardLayout(columns=7, rows=7, hole_squares=3, square_mm=40.0)
CAMERA = Camera.pinhole(width=640, height=480, focal_px=3000)
LIGHTS_MM = np.array([[-1400.0, 700, 200], [1300, 900, 300], [0, -1500, 100]])
COLOURS = np.array([[0.5, 0.08, 0.02], [0.08, 0.5, 0.05], [0.1, 0.15, 0.5]])
DISTANCE_MM = 5000.0


def colour_at(point: np.ndarray, normal: np.ndarray) -> np.ndarray:
    towards = LIGHTS_MM - point
    distance = np.linalg.norm(towards, axis=1)
    return ((towards @ normal) / distance * (DISTANCE_MM / distance) ** 2) @ COLOURS


def sightings(rng: np.random.Generator, reach: float, count: int = 120) -> list[BoardSighting]:
    ids = LAYOUT.sound_corner_ids
    corners = np.column_stack([LAYOUT.corners_mm[ids], np.zeros(len(ids))])
    middle = np.append(LAYOUT.hole_mm.mean(axis=0), 0.0)
    seen = []
    for number in range(count):
        rotation = RigidTransform.from_rotation_vector(np.deg2rad(rng.uniform(-32, 32, 3) * [1, 1, 0.4]))
        centre = np.array([*(reach * rng.uniform(-1, 1, 2) * [350, 230]), DISTANCE_MM])
        pose = RigidTransform(rotation=rotation.rotation, translation=centre - rotation.apply(middle))
        corners_px = CAMERA.project(pose.apply(corners)) + rng.normal(0, 0.05, (len(ids), 2))
        rgb = colour_at(centre, pose.rotate(np.array(NORMAL_IN_BOARD))) + rng.normal(0, 0.001, 3)
        seen.append(BoardSighting(number=number, corner_ids=ids, corners_px=corners_px, rgb=rgb))
    return seen


def test_a_varying_response_explains_near_lights(rng: np.random.Generator) -> None:
    seen = sightings(rng, reach=1.0)
    size = (CAMERA.width, CAMERA.height)
    one, varying = (
        fit_response_to_board(seen, LAYOUT, size, CAMERA, BoardOptions(degree=degree), rng).fit
        for degree in (0, 2)
    )
    assert one.quality.residual_deg > 2.0
    assert varying.quality.residual_deg < 0.5
    assert varying.response.variation is not None
    assert varying.quality.condition_number == varying.response.condition_number
    for pixel in ([140.0, 120.0], [500.0, 360.0], [319.5, 239.5]):
        point = CAMERA.unproject(np.array(pixel), np.array(DISTANCE_MM))
        true = np.stack([colour_at(point, axis) for axis in np.eye(3)], axis=1)
        found, _ = varying.response.at(np.array(pixel))
        tilted = np.linalg.solve(found, true @ np.array([0.3, -0.2, -0.93]))
        expected = np.array([0.3, -0.2, -0.93]) / np.linalg.norm([0.3, -0.2, -0.93])
        cosine = tilted @ expected / np.linalg.norm(tilted)
        assert np.rad2deg(np.arccos(cosine)) < 1.0


def test_a_board_held_in_one_place_tells_no_variation(rng: np.random.Generator) -> None:
    seen = sightings(rng, reach=0.01)
    with pytest.raises(BadCalibration, match="too few places"):
        fit_response_to_board(seen, LAYOUT, (640, 480), CAMERA, BoardOptions(degree=2), rng)


def test_colours_that_fit_no_response_do_not_move_one_that_varies(rng: np.random.Generator) -> None:
    normals = np.column_stack([rng.normal(0, 0.3, (400, 2)), -np.ones(400)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    places = rng.uniform(0, 1, (400, 2)) * [CAMERA.width - 1, CAMERA.height - 1]
    x = places[:, :1] / CAMERA.width - 0.5
    matrix = COLOURS.T @ LIGHTS_MM / 1500.0
    rgb = (1.0 + 0.2 * x) * (normals @ matrix.T)
    rgb[::20] = 0.0
    size, options = (CAMERA.width, CAMERA.height), ResponseFitOptions()
    fitted = fit_varying_response(normals, rgb, places, size, 1, options)
    at_left, _ = fitted.at(np.array([0.0, 100.0]))
    np.testing.assert_allclose(at_left, 0.9 * matrix, atol=1e-6)
    rgb[7] = np.nan
    with pytest.raises(BadInput, match="colours: 3 of 1200 values are NaN"):
        fit_varying_response(normals, rgb, places, size, 1, options)

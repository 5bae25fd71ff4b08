"""The board: layout against OpenCV, detection and calibration on drawn views, the printed page."""

import logging
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.attached_shadow import shaded_rgb_from_normals
from vntoolkit.calibration.board import fit_camera, fit_response_to_board
from vntoolkit.calibration.board_detection import BoardDetector
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.board_layout import MARKER_DICTIONARY, NORMAL_IN_BOARD, BoardLayout
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.calibration import BoardOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

LAYOUT = BoardLayout()
PIXELS_PER_SQUARE = 60
CAMERA = Camera(
    model=CameraModel.OPENCV,
    width=640,
    height=480,
    matrix=np.array([[800.0, 0, 322], [0, 800, 236], [0, 0, 1]]),
    distortion=np.array([-0.08, 0, 0, 0]),
)
DIRECTIONS = np.array([[0.6, 0.0, -0.8], [-0.36, 0.48, -0.8], [-0.36, -0.48, -0.8]])
COLOURS = np.array([[0.5, 0.05, 0.02], [0.06, 0.6, 0.1], [0.0, 0.1, 0.4]])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)


def opencv_board():
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, MARKER_DICTIONARY))
    size = (LAYOUT.columns, LAYOUT.rows)
    return cv2.aruco.CharucoBoard(size, LAYOUT.square_mm, LAYOUT.marker_mm, dictionary)


def albedo_texture():
    """The board as printed, 0.8 and 0.05, with a sample of albedo 1 in the hole; and the hole's mask."""
    size = (LAYOUT.columns * PIXELS_PER_SQUARE, LAYOUT.rows * PIXELS_PER_SQUARE)
    texture = 0.05 + 0.75 * (opencv_board().generateImage(size) > 127)
    scale = PIXELS_PER_SQUARE / LAYOUT.square_mm
    (left, top), (right, bottom) = (LAYOUT.hole_mm[[0, 2]] * scale).astype(int)
    texture[top:bottom, left:right] = 1.0
    return texture.astype(np.float32)


TEXTURE = cv2.GaussianBlur(albedo_texture(), (0, 0), 1.2)
RAYS = CAMERA.unproject(CAMERA.pixel_grid(), np.ones((CAMERA.height, CAMERA.width)))


def view_of_board(pose: RigidTransform, rng: np.random.Generator, noise: float = 0.004) -> LinearFrame:
    """Look a ray of every pixel up on the board's plane: lens distortion included."""
    board_from_camera = pose.inverse()
    directions, origin = board_from_camera.rotate(RAYS), board_from_camera.translation
    hit = origin[:2] - directions[..., :2] * (origin[2] / directions[..., 2:])
    at = (hit * (PIXELS_PER_SQUARE / LAYOUT.square_mm) - 0.5).astype(np.float32)
    albedo = cv2.remap(TEXTURE, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=0.3)
    colour = shaded_rgb_from_normals(pose.rotate(np.array(NORMAL_IN_BOARD)), RESPONSE)
    rgb = albedo[..., None] * colour + rng.normal(0, noise, (*albedo.shape, 3))
    return LinearFrame(rgb=rgb.astype(np.float32), clipped=(rgb >= 1).any(axis=2))


def random_pose(rng: np.random.Generator) -> RigidTransform:
    tilt = np.deg2rad(rng.uniform(5, 38))
    azimuth = rng.uniform(0, 2 * np.pi)
    rotation = RigidTransform.from_rotation_vector(tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0]))
    middle = np.array([LAYOUT.width_mm / 2, LAYOUT.height_mm / 2, 0])
    centre = np.array([rng.uniform(-25, 25), rng.uniform(-15, 15), rng.uniform(370, 460)])
    return RigidTransform(rotation=rotation.rotation, translation=centre - rotation.apply(middle))


@pytest.fixture(scope="module")
def views():
    rng = np.random.default_rng(7)
    poses = [random_pose(rng) for _ in range(30)]
    detector = BoardDetector(LAYOUT)
    sightings = [detector.sight(view_of_board(pose, rng)) for pose in poses]
    seen = [(s, p) for s, p in zip(sightings, poses, strict=True) if s is not None]
    assert len(seen) >= 28
    return [s for s, _ in seen], [p for _, p in seen]


def test_layout_is_opencvs() -> None:
    board = opencv_board()
    np.testing.assert_allclose(board.getChessboardCorners()[:, :2], LAYOUT.corners_mm, atol=1e-4)
    markers = np.array([points[0, :2] for points in board.getObjPoints()])
    inset = (LAYOUT.square_mm - LAYOUT.marker_mm) / 2
    np.testing.assert_allclose(markers, LAYOUT.marker_squares * LAYOUT.square_mm + inset, atol=1e-4)
    hole_side = np.ptp(LAYOUT.hole_mm, axis=0)
    np.testing.assert_allclose(hole_side / LAYOUT.width_mm, 5 / 11)  # 45 % of the width


def test_corners_in_and_beside_the_hole_do_not_exist() -> None:
    sound = LAYOUT.corners_mm[LAYOUT.sound_corner_ids]
    hole = LAYOUT.hole_mm
    beside = ((sound >= hole[0] - 0.01) & (sound <= hole[2] + 0.01)).all(axis=1)
    assert not beside.any()
    assert len(sound) == 10 * 10 - 6 * 6


def test_detection_finds_sharp_corners_and_the_colour_in_the_hole(views) -> None:
    sightings, poses = views
    for sighting, pose in zip(sightings, poses, strict=True):
        points = np.zeros((len(sighting.corner_ids), 3))
        points[:, :2] = LAYOUT.corners_mm[sighting.corner_ids]
        error = np.linalg.norm(CAMERA.project(pose.apply(points)) - sighting.corners_px, axis=1)
        assert len(sighting.corner_ids) >= 40
        assert error.max() < 0.3
        truth = shaded_rgb_from_normals(pose.rotate(np.array(NORMAL_IN_BOARD)), RESPONSE)
        np.testing.assert_allclose(sighting.rgb, truth, atol=0.002)


def test_a_mistaken_corner_at_the_edge_of_the_image_is_left_out(rng) -> None:
    """Its true place lies outside, where OpenCV refines nothing."""
    pose = RigidTransform(translation=np.array([-220.0, -88.0, 420.0]))  # the left columns are out of sight
    frame, corner_ids = view_of_board(pose, rng), LAYOUT.sound_corner_ids
    corners = np.column_stack([LAYOUT.corners_mm[corner_ids], np.zeros(len(corner_ids))])
    true_px = CAMERA.project(pose.apply(corners))
    outside = (true_px[:, 0] < -3) & (true_px[:, 0] > -40)
    assert outside.any()
    claimed = np.clip(true_px, 2, [637, 477])[true_px[:, 0] > -40]
    ids = corner_ids[true_px[:, 0] > -40]
    detector = BoardDetector(LAYOUT)
    detector._detector = SimpleNamespace(detectBoard=lambda _: (claimed[:, None], ids[:, None], None, None))
    sighting = detector.sight(frame)
    assert sighting is not None
    assert not np.isin(sighting.corner_ids, corner_ids[outside]).any()


def test_poses_under_one_lamp_are_told_from_those_under_all(views) -> None:
    sightings, poses = views
    rng = np.random.default_rng(3)
    lamp = rng.permuted(np.repeat([-1, 0, 1, 2], [len(poses) - 15, 5, 5, 5]))
    switched = []
    for k, sighting, pose in zip(lamp, sightings, poses, strict=True):
        normal = pose.rotate(np.array(NORMAL_IN_BOARD))
        rgb = sighting.rgb if k < 0 else COLOURS[k] * (DIRECTIONS[k] @ normal) + rng.normal(0, 1e-3, 3)
        switched.append(replace(sighting, rgb=rgb))
    result = fit_response_to_board(switched, LAYOUT, (640, 480), CAMERA)
    assert len(result.poses) == len(poses) - 15
    unit = COLOURS / np.linalg.norm(COLOURS, axis=1, keepdims=True)
    np.testing.assert_allclose(result.light_colours, unit, atol=0.005)
    np.testing.assert_allclose(result.fit.response.matrix, RESPONSE.matrix, atol=0.02)


def test_board_gives_camera_poses_and_response(views) -> None:
    sightings, poses = views
    result = fit_response_to_board(sightings, LAYOUT, (640, 480))
    assert result.camera.matrix[0, 0] == pytest.approx(800, rel=0.005)
    assert result.camera.matrix[:2, 2] == pytest.approx([322, 236], abs=3)
    assert result.camera.distortion[0] == pytest.approx(-0.08, abs=0.02)
    truth = {id(s): p for s, p in zip(sightings, poses, strict=True)}
    assert len(truth) == len(result.poses)
    for pose, known in zip(result.poses, poses, strict=True):
        normal = pose.camera_from_board.rotate(np.array(NORMAL_IN_BOARD))
        assert normal @ known.rotate(np.array(NORMAL_IN_BOARD)) > np.cos(np.deg2rad(0.5))
    # noise of 0.004 in a median over thousands of pixels, normals to a quarter of a degree
    np.testing.assert_allclose(result.fit.response.matrix, RESPONSE.matrix, atol=0.01)
    assert result.fit.quality.residual_deg < 0.3
    assert result.fit.quality.method == "board"
    assert result.light_colours is None
    assert 20 < result.fit.quality.cone_deg < 45


def test_given_camera_is_kept_and_outliers_are_left_out(views) -> None:
    from dataclasses import replace

    sightings, _ = views
    spoiled = [replace(s, rgb=s.rgb * [0.2, 1.0, 1.0]) if i < 4 else s for i, s in enumerate(sightings)]
    result = fit_response_to_board(spoiled, LAYOUT, (640, 480), CAMERA, BoardOptions())
    assert result.camera is CAMERA
    np.testing.assert_allclose(result.fit.response.matrix, RESPONSE.matrix, atol=0.01)
    assert not result.fit.inliers[:4].any()


def test_narrow_cone_is_warned_of(views, caplog) -> None:
    sightings, poses = views
    tilt = [np.rad2deg(np.arccos(p.rotation[2, 2])) for p in poses]
    chosen = [sightings[i] for i in np.argsort(tilt)[:12]]
    with caplog.at_level(logging.WARNING):
        result = fit_response_to_board(chosen, LAYOUT, (640, 480), CAMERA)
    assert result.fit.quality.cone_deg < 20
    assert "tilt the target further" in caplog.text


def test_refusals(views, rng) -> None:
    from dataclasses import replace

    sightings, poses = views
    black = LinearFrame(rgb=np.zeros((480, 640, 3), np.float32), clipped=np.zeros((480, 640), bool))
    assert BoardDetector(LAYOUT).sight(black) is None
    with pytest.raises(BadCalibration, match="not seen in any frame"):
        fit_response_to_board([], LAYOUT, (640, 480))
    with pytest.raises(BadCalibration, match="clipped or outside"):
        fit_response_to_board([replace(s, rgb=None) for s in sightings], LAYOUT, (640, 480), CAMERA)
    with pytest.raises(BadCalibration, match="3 frames show the board well enough"):
        fit_response_to_board(sightings[:3], LAYOUT, (640, 480))
    tilt = [p.rotation[2, 2] for p in poses]
    frontal = sightings[int(np.argmax(tilt))]
    with pytest.raises(BadCalibration, match="tilt the board"):
        fit_camera([frontal] * 6, LAYOUT, (640, 480))
    with pytest.raises(BadCalibration, match="perspective camera"):
        fit_response_to_board(sightings, LAYOUT, (640, 480), Camera.orthographic(width=640, height=480))
    wrong = Camera.pinhole(width=640, height=480, focal_px=100)
    with pytest.raises(BadCalibration, match="does the camera belong"):
        fit_response_to_board(sightings, LAYOUT, (640, 480), wrong)


def test_clipped_sample_has_no_colour(rng) -> None:
    frame = view_of_board(random_pose(np.random.default_rng(7)), rng)
    bright = LinearFrame(rgb=np.minimum(frame.rgb * 3, 1), clipped=(frame.rgb * 3 >= 1).any(axis=2))
    sighting = BoardDetector(LAYOUT).sight(bright)
    assert sighting is not None
    assert sighting.rgb is None

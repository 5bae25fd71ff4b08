import numpy as np
import pytest

from vntoolkit.geometry.camera import Camera, CameraModel

PINHOLE = Camera.pinhole(width=64, height=48, focal_px=80.0)
DISTORTED = Camera(
    model=CameraModel.OPENCV, width=64, height=48, matrix=PINHOLE.matrix, distortion=[-0.2, 0.05, 1e-3, -2e-3]
)
LENSES = [
    [-0.2, 0.05, 1e-3, -2e-3],
    [-0.2, 0.05, 1e-3, -2e-3, 0.01],
    [0.3, 0.05, 1e-3, -2e-3, 0.01, 0.5, 0.1, 0.02],  # as OpenCV's rational model fits a wide lens
]
ORTHOGRAPHIC = Camera.orthographic(width=64, height=48, pixels_per_unit=100.0)


@pytest.mark.parametrize("camera", [PINHOLE, DISTORTED, ORTHOGRAPHIC], ids=lambda c: c.model.value)
def test_projecting_undoes_unprojecting(camera: Camera, rng: np.random.Generator) -> None:
    depth = rng.uniform(2, 5, size=(48, 64))
    points = camera.points_from_depth(depth)
    np.testing.assert_allclose(points[..., 2], depth)
    np.testing.assert_allclose(camera.project(points), camera.pixel_grid(), atol=1e-8)


def test_axes_are_right_down_forward() -> None:
    centre = PINHOLE.project(np.array([0.0, 0, 1]))
    right, down = PINHOLE.project(np.array([[0.1, 0, 1], [0, 0.1, 1]]))
    np.testing.assert_allclose(centre, [31.5, 23.5])  # integer pixel centres: the middle of 0 … 63 is 31.5
    assert right[0] > centre[0]
    assert down[1] > centre[1]


@pytest.mark.parametrize("lens", LENSES, ids=len)
def test_distortion_agrees_with_opencv(lens: list[float], rng: np.random.Generator) -> None:
    cv2 = pytest.importorskip("cv2")
    camera = Camera.from_matrix(PINHOLE.matrix, width=64, height=48, distortion=[lens])  # (1, n) as cv2 gives
    points = rng.uniform([-0.3, -0.2, 1.0], [0.3, 0.2, 1.5], size=(50, 3))
    matrix, still = np.array(camera.matrix), np.zeros(3)
    theirs = cv2.projectPoints(points, still, still, matrix, np.array(lens))[0][:, 0]
    np.testing.assert_allclose(camera.project(points), theirs, atol=1e-9)
    until = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-12)
    straight = cv2.undistortPoints(theirs, matrix, np.array(lens), criteria=until)[:, 0]
    ours = camera.unproject(theirs, np.ones(50))
    np.testing.assert_allclose(ours[:, :2], straight, atol=1e-8)
    np.testing.assert_allclose(ours * points[:, 2:], points, atol=1e-8)


def test_k_without_distortion_is_a_pinhole_camera() -> None:
    """As of footage that was undistorted before."""
    camera = Camera.from_matrix(PINHOLE.matrix, width=64, height=48)
    assert camera.model is CameraModel.PINHOLE
    np.testing.assert_array_equal(camera.matrix, PINHOLE.matrix)


def test_scaling_keeps_the_corners_of_the_image() -> None:
    half = PINHOLE.scaled(0.5)
    point = PINHOLE.unproject(np.array([-0.5, -0.5]), np.array(2.0))  # outer corner of the first pixel
    np.testing.assert_allclose(half.project(point), [-0.5, -0.5], atol=1e-12)
    assert (half.width, half.height) == (32, 24)

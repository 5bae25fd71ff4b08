import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera, CameraModel

PINHOLE = Camera.pinhole(width=64, height=48, focal_px=80.0)
DISTORTED = Camera(
    model=CameraModel.OPENCV, width=64, height=48, matrix=PINHOLE.matrix, distortion=[-0.2, 0.05, 1e-3, -2e-3]
)
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


def test_distortion_agrees_with_opencv(rng: np.random.Generator) -> None:
    cv2 = pytest.importorskip("cv2")
    points = rng.uniform([-0.3, -0.2, 1.0], [0.3, 0.2, 1.5], size=(50, 3))
    theirs, _ = cv2.projectPoints(
        points, np.zeros(3), np.zeros(3), np.array(DISTORTED.matrix), np.array(DISTORTED.distortion)
    )
    np.testing.assert_allclose(DISTORTED.project(points), theirs[:, 0], atol=1e-9)


def test_scaling_keeps_the_corners_of_the_image() -> None:
    half = PINHOLE.scaled(0.5)
    point = PINHOLE.unproject(np.array([-0.5, -0.5]), np.array(2.0))  # outer corner of the first pixel
    np.testing.assert_allclose(half.project(point), [-0.5, -0.5], atol=1e-12)
    assert (half.width, half.height) == (32, 24)


def test_refusals() -> None:
    with pytest.raises(BadInput, match="positive focal"):
        Camera(model=CameraModel.PINHOLE, width=4, height=4, matrix=np.zeros((3, 3)))
    with pytest.raises(BadInput, match=r"0, 0, 1 in its last row, got \[0\.0, 0\.0, 2\.0\]"):
        Camera(model=CameraModel.PINHOLE, width=4, height=4, matrix=np.diag([9.0, 9, 2]))
    with pytest.raises(BadInput, match="no distortion"):
        Camera(model=CameraModel.PINHOLE, width=4, height=4, matrix=np.eye(3), distortion=[0.1, 0, 0, 0])
    with pytest.raises(BadInput, match="expected shape 48 × 64"):
        PINHOLE.points_from_depth(np.ones((64, 48)))

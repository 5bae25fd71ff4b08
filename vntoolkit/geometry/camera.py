"""Cameras: pinhole with distortion, or orthographic; projection and its inverse.

Model names are COLMAP's (PINHOLE, OPENCV); ORTHOGRAPHIC is ours. Distortion is OpenCV's, with 4, 5 or 8
coefficients (zhang2000). Pixel centres are integers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import numpy as np

from vntoolkit.arrays import Depth, FloatArray, Matrix3, Vector3, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadInput

_UNDISTORT_ITERATIONS = 20
_RADII, _TURNS = 200, 16  # at which a distortion is looked at
_COEFFICIENTS = "k1, k2, p1, p2, k3, k4, k5, k6"  # the first 4, the first 5, or all of them
_OTHER_LENSES = {12: "a thin prism", 14: "a tilted sensor"}  # that OpenCV adds by further coefficients
_MOST_PX = 1e9  # no lens has more; squares and inverses of K stay far from overflow


class CameraModel(Enum):
    """How points in the camera frame become pixels."""

    PINHOLE = "PINHOLE"
    OPENCV = "OPENCV"
    ORTHOGRAPHIC = "ORTHOGRAPHIC"


@dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """One calibrated camera.

    width, height: image size in pixels. matrix: K, (3, 3), pixels; for an orthographic camera K[0, 0]
    is the scale in pixels per length unit. distortion: OPENCV only; (4,), (5,) or (8,), in OpenCV's order k1,
    k2, p1, p2, k3, k4, k5, k6.
    """

    model: CameraModel
    width: int
    height: int
    matrix: Matrix3
    distortion: FloatArray = field(default_factory=lambda: np.zeros(4))

    def __post_init__(self) -> None:
        matrix = np.array(self.matrix, dtype=np.float64)
        distortion = np.array(self.distortion, dtype=np.float64)
        require_shape(matrix, (3, 3), "camera matrix K")
        require_finite(matrix, "camera matrix K")
        if np.abs(matrix).max() > _MOST_PX:
            raise BadInput(
                f"camera matrix K: expected numbers up to {_MOST_PX:g}, got {np.abs(matrix).max():g}"
            )
        _require_known_distortion(distortion)
        require_finite(distortion, "camera distortion")
        if self.width < 1 or self.height < 1:
            raise BadInput(f"camera: expected a positive image size, got {self.width}×{self.height}")
        if not (matrix[0, 0] > 0 and matrix[1, 1] > 0):
            raise BadInput("camera matrix K: expected positive focal lengths K[0][0], K[1][1]")
        if matrix[2].tolist() != [0, 0, 1]:
            raise BadInput(f"camera matrix K: expected 0, 0, 1 in its last row, got {matrix[2].tolist()}")
        if np.any(distortion != 0) and self.model is not CameraModel.OPENCV:
            raise BadInput(f"camera: a {self.model.value} camera has no distortion; use model OPENCV")
        object.__setattr__(self, "matrix", read_only(matrix))
        object.__setattr__(self, "distortion", read_only(distortion))

    @classmethod
    def pinhole(cls, *, width: int, height: int, focal_px: float | tuple[float, float]) -> Camera:
        """Build a pinhole camera with the principal point in the image centre.

        focal_px: one focal length, or (f_x, f_y) where pixels are not square.
        """
        focal = np.ravel(np.asarray(focal_px, dtype=np.float64))
        if len(focal) not in (1, 2):
            raise BadInput(f"camera: expected one focal length, or f_x and f_y, got {len(focal)}")
        matrix = np.array([[focal[0], 0, (width - 1) / 2], [0, focal[-1], (height - 1) / 2], [0, 0, 1.0]])
        return cls(model=CameraModel.PINHOLE, width=width, height=height, matrix=matrix)

    @classmethod
    def from_matrix(
        cls, matrix: Matrix3, *, width: int, height: int, distortion: FloatArray | Sequence[float] = ()
    ) -> Camera:
        """Build the camera of K (3, 3), as `cv2.calibrateCamera` returns it, with its distortion.

        distortion: 4, 5 or 8 numbers in OpenCV's order; none for footage that was undistorted before.
        """
        coefficients = np.ravel(np.asarray(distortion, dtype=np.float64))
        lens = {"model": CameraModel.OPENCV, "distortion": coefficients} if len(coefficients) else {}
        known: dict[str, Any] = {"model": CameraModel.PINHOLE, **lens}
        return cls(width=width, height=height, matrix=matrix, **known)

    @classmethod
    def orthographic(cls, *, width: int, height: int, pixels_per_unit: float = 1.0) -> Camera:
        """Build an orthographic camera; with the default scale, lengths are pixels."""
        s = float(pixels_per_unit)
        matrix = np.array([[s, 0, (width - 1) / 2], [0, s, (height - 1) / 2], [0, 0, 1.0]])
        return cls(model=CameraModel.ORTHOGRAPHIC, width=width, height=height, matrix=matrix)

    @property
    def is_perspective(self) -> bool:
        """True for PINHOLE and OPENCV."""
        return self.model is not CameraModel.ORTHOGRAPHIC

    def project(self, points_in_camera: FloatArray) -> FloatArray:
        """Project points (..., 3) to pixels (..., 2)."""
        points = np.asarray(points_in_camera, dtype=np.float64)
        xy: FloatArray = points[..., :2] / points[..., 2:3] if self.is_perspective else points[..., :2]
        if self.model is CameraModel.OPENCV:
            xy = _distort(xy, self.distortion)
        return xy @ self.matrix[:2, :2].T + self.matrix[:2, 2]

    def unproject(self, pixels: FloatArray, depth: FloatArray) -> FloatArray:
        """Return the points (..., 3) in the camera frame at pixels (..., 2) and depth (...)."""
        pixels, inverse = np.asarray(pixels, dtype=np.float64), np.linalg.inv(self.matrix[:2, :2])
        u, v = pixels[..., 0] - self.matrix[0, 2], pixels[..., 1] - self.matrix[1, 2]
        x, y = inverse[0, 0] * u + inverse[0, 1] * v, inverse[1, 0] * u + inverse[1, 1] * v
        if self.model is CameraModel.OPENCV:
            x, y = np.moveaxis(_undistort(np.stack([x, y], axis=-1), self.distortion), -1, 0)
        depth = np.asarray(depth)
        return np.stack([x * depth, y * depth, depth] if self.is_perspective else [x, y, depth], axis=-1)

    def pixel_grid(self) -> FloatArray:
        """Return the (h, w, 2) positions (u, v) of all pixel centres."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return np.stack([u, v], axis=-1).astype(np.float64)

    def points_from_depth(self, depth: Depth) -> FloatArray:
        """Return the (h, w, 3) points in the camera frame of a depth image (h, w)."""
        require_shape(depth, (self.height, self.width), "depth")
        return self.unproject(self.pixel_grid(), depth)

    @property
    def folds(self) -> bool:
        """True where the distortion puts two directions into one pixel of the picture."""
        if self.model is not CameraModel.OPENCV:
            return False
        edge = np.array(
            [[0, 0], [self.width - 1, 0], [0, self.height - 1], [self.width - 1, self.height - 1]]
        )
        inverse = np.linalg.inv(self.matrix[:2, :2])
        furthest = np.linalg.norm((edge - self.matrix[:2, 2]) @ inverse.T, axis=1).max()
        # outwards along any ray, the distorted radius must grow until it reaches the picture's corner
        radius = np.linspace(0.0, 2.0 * furthest, _RADII)
        turn = np.linspace(0.0, 2.0 * np.pi, _TURNS, endpoint=False)
        rays = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        reached = (_distort(radius[:, None, None] * rays, self.distortion) * rays).sum(axis=-1)
        inside = np.maximum.accumulate(reached, axis=0)[:-1] < furthest
        return bool((inside & (np.diff(reached, axis=0) <= 0)).any())

    def scaled(self, factor: float) -> Camera:
        """Return the camera of an image resized by `factor` (pixel centres stay integers)."""
        matrix: FloatArray = np.array(self.matrix, dtype=np.float64)
        matrix[:2] *= factor
        matrix[:2, 2] += 0.5 * (factor - 1.0)
        return Camera(
            model=self.model,
            width=round(self.width * factor),
            height=round(self.height * factor),
            matrix=matrix,
            distortion=self.distortion,
        )

    def cropped(self, rows: slice, columns: slice) -> Camera:
        """Return the camera of the pixels [rows, columns] of its image; slices with a start and a stop."""
        matrix: FloatArray = np.array(self.matrix, dtype=np.float64)
        matrix[:2, 2] -= (columns.start, rows.start)
        width, height = columns.stop - columns.start, rows.stop - rows.start
        return replace(self, width=width, height=height, matrix=matrix)

    def without_distortion(self) -> Camera:
        """Return the pinhole camera of the undistorted image (itself where there is none)."""
        if self.model is not CameraModel.OPENCV:
            return self
        return Camera(model=CameraModel.PINHOLE, width=self.width, height=self.height, matrix=self.matrix)


def _require_known_distortion(distortion: FloatArray) -> None:
    if distortion.shape in ((4,), (5,), (8,)):
        return
    lens = _OTHER_LENSES.get(distortion.size)
    raise BadInput(
        f"camera distortion: expected the first 4, the first 5 or all 8 of {_COEFFICIENTS}, got "
        f"{' × '.join(map(str, distortion.shape))} numbers{'' if lens is None else f', those of {lens}'}; "
        "calibrate with fewer, or undistort the footage and give K alone"
    )


def _distort(xy: FloatArray, distortion: FloatArray) -> FloatArray:
    """OpenCV's radial and tangential model on normalised coordinates (..., 2)."""
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(distortion, (0, 8 - len(distortion)))
    x, y = xy[..., 0], xy[..., 1]
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + k3 * r2))) / (1.0 + r2 * (k4 + r2 * (k5 + k6 * r2)))
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def _undistort(xy_distorted: FloatArray, distortion: FloatArray) -> FloatArray:
    """Invert `_distort` by fixed-point iteration, which contracts for photographic lenses."""
    xy = xy_distorted
    for _ in range(_UNDISTORT_ITERATIONS):
        xy = xy + (xy_distorted - _distort(xy, distortion))
    return xy


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewedFrom:
    """Where the scene was filmed from, in camera axes.

    camera: with perspective. position: (3,). rotation: (3, 3) scene_from_camera. offset: (3,) by which the
    whole scene was moved on its way into the file.
    """

    camera: Camera
    position: Vector3
    rotation: FloatArray
    offset: Vector3 = field(default_factory=lambda: np.zeros(3))

    @property
    def vertical_angle_rad(self) -> float:
        """Angle of view from the lower to the upper edge."""
        return float(2 * np.arctan(self.camera.height / 2 / self.camera.matrix[1, 1]))

    @property
    def aspect_ratio(self) -> float:
        """Width of the view over its height."""
        wide, matrix = self.camera.width, self.camera.matrix
        return float(wide / matrix[0, 0] * matrix[1, 1] / self.camera.height)

    def file_axes(self) -> FloatArray:
        """Return (3, 3): the camera's axes in a file with y up, where a camera looks along −z with y up."""
        turn = np.diag([1.0, -1.0, -1.0])
        return turn @ self.rotation @ turn

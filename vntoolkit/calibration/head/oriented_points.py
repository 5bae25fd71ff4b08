"""Points of the skin with normals, made from one view's depth map."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.calibration.head.hull import View

_LEAST_SLANT = 0.25  # cosine between ray and surface below which a depth says little
_LONE_STEPS = 1.0  # from the median of its neighbours: further off, a depth is alone
_TINY = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class OrientedPoints:
    """Points found by stereo, in the head frame.

    points, normals: (n, 3), outward unit normals. on_hull: (n, 3) where the hull is hit by the rays that they
    lie on. correlation: (n,).
    """

    points: Points
    normals: Points
    on_hull: Points
    correlation: FloatArray

    def chosen(self, kept: npt.NDArray[np.bool_]) -> OrientedPoints:
        """Keep some of the points, (n,)."""
        return OrientedPoints(
            points=self.points[kept],
            normals=self.normals[kept],
            on_hull=self.on_hull[kept],
            correlation=self.correlation[kept],
        )


def points_of_depth(
    view: View,
    on_hull: FloatArray,
    depth: FloatArray,
    valid: Mask,
    correlation: FloatArray,
    window: tuple[slice, slice],
    step: float,
    smoothing_px: float,
) -> OrientedPoints:
    """Take out lone depths, smooth, and take normals from the slopes of the points.

    step: between two depths that were tried; as much and more may lie between a depth and its neighbours'.
    """
    middle = cv2.medianBlur(np.where(valid, depth, 0.0).astype(np.float32), 5)
    valid = valid & (np.abs(depth - middle) <= _LONE_STEPS * step)
    weight = valid.astype(np.float64) * np.maximum(correlation, 0.0) ** 2
    total = cv2.GaussianBlur(weight, (0, 0), smoothing_px)
    level = float(np.median(depth[valid])) if valid.any() else 0.0  # keeps digits in the sums
    smooth = cv2.GaussianBlur(weight * (depth - level), (0, 0), smoothing_px)
    smooth = level + smooth / np.maximum(total, _TINY)
    points = view.camera.unproject(view.camera.pixel_grid()[window], smooth)
    down, right = np.gradient(points, axis=(0, 1))
    normals = np.cross(right, down)
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-30)
    normals *= -np.sign((normals * points).sum(-1, keepdims=True))
    kernel = np.ones((3, 3), np.uint8)
    valid &= cv2.erode(valid.astype(np.uint8), kernel) > 0
    valid &= -(normals * points).sum(-1) > _LEAST_SLANT * np.linalg.norm(points, axis=-1)
    valid[1::2], valid[:, 1::2] = False, False  # windows overlap: every second pixel says as much
    head = view.camera_from_head.inverse()
    return OrientedPoints(
        points=head.apply(points[valid]),
        normals=head.rotate(normals[valid]),
        on_hull=head.apply(view.camera.unproject(view.camera.pixel_grid()[window][valid], on_hull[valid])),
        correlation=correlation[valid],
    )

"""Stereo by correlation between neighbouring poses, searched near the hull (hernandez2004).

The images are of local contrast, so that the shading, which moves over the turning skin, does not correlate.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, ByteArray, FloatArray, Mask, Points
from vntoolkit.calibration.head.hull import SilhouetteView, neighbours_of
from vntoolkit.calibration.head.silhouettes import box_of_mask
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rays import RayScene, pixel_rays
from vntoolkit.options.head import HeadSteps

# What wide windows and smooth depths flatten is alike in all views. Noise is not, and averages out over them.
_STEP_PX = 0.6  # that a point moves in the furthest neighbour from shell to shell
_LEAST_FACING = 0.25  # cosine between ray and surface below which a window mixes too many depths


def stereo_points(
    views: Sequence[SilhouetteView],
    contrasts: Sequence[ByteArray],
    hull: Mesh,
    reference: int,
    steps: HeadSteps,
) -> "OrientedPoints":
    """Search the depth of one view along its rays about the hull; returns the points that correlate.

    contrasts: (h, w) local contrast of every view, 8 bits. reference: number of the view.
    """
    view = views[reference]
    neighbours = neighbours_of(views, reference, steps.neighbour_angles_deg)
    rows, columns = box_of_mask(view.mask)
    depth, facing = hull_depth(view, hull, rows, columns)
    typical = float(np.median(depth[depth > 0]))
    shells = _shells(view, hull, steps, typical)
    searched = np.where(depth > 0, depth, np.float32(typical))  # beside the hull rays meet no plane at 0
    scores = _scores(views, contrasts, reference, neighbours, (rows, columns), searched, shells, steps)
    offset, correlation = _best_shell(scores, shells)
    valid = (
        (depth > 0)
        & (facing > _LEAST_FACING)
        & (correlation > steps.least_correlation)
        & np.isfinite(offset)
        & view.mask[rows, columns]
    )
    found = depth + np.where(valid, offset, 0.0)
    step = float(shells[1] - shells[0])
    window = (rows, columns)
    return points_of_depth(view, depth, found, valid, correlation, window, step, steps.smoothing_px)


def hull_depth(
    view: SilhouetteView, hull: Mesh, rows: slice, columns: slice
) -> tuple[FloatArray, FloatArray]:
    """Return depth (h, w) of the hull in the window, 0 where it is not hit, and the cosine to the ray."""
    pixels = view.camera.pixel_grid()[rows, columns]
    rays = np.concatenate(pixel_rays(view.camera, pixels), axis=-1, dtype=np.float32)
    hits = RayScene((view.camera_from_head.apply(hull.vertices), hull.faces)).first_hits(rays.reshape(-1, 6))
    directions = rays.reshape(-1, 6)[hits.rays, 3:]
    cosine = -(hits.normals * directions).sum(-1) / np.linalg.norm(directions, axis=-1)
    shape = (pixels.shape[0], pixels.shape[1])
    return hits.image(hits.distances, shape, 0.0), hits.image(cosine, shape, 0.0)


def _shells(view: SilhouetteView, hull: Mesh, steps: HeadSteps, depth: float) -> FloatArray:
    """Return the depths relative to the hull (s,), so close that a point moves `_STEP_PX` between two."""
    furthest = np.sin(np.deg2rad(max(steps.neighbour_angles_deg)))
    step = _STEP_PX * depth / (view.camera.matrix[0, 0] * furthest)
    before, behind = steps.before * hull.diagonal, steps.behind * hull.diagonal
    return np.arange(-np.ceil(before / step), np.ceil(behind / step) + 1).astype(np.float32) * np.float32(
        step
    )


def _scores(
    views: Sequence[SilhouetteView],
    contrasts: Sequence[ByteArray],
    reference: int,
    neighbours: Sequence[int],
    window: tuple[slice, slice],
    depth: FloatArray,
    shells: FloatArray,
    steps: HeadSteps,
) -> FloatArray:
    """Return (s, h, w) the mean of the better half of the neighbours' correlations, −1 without any."""
    view = views[reference]
    own = contrasts[reference][window].astype(np.float32)
    size = (steps.stereo_window_px, steps.stereo_window_px)
    statistics = _Statistics(own, size)
    pixels = view.camera.pixel_grid()[window]
    rays = view.camera.unproject(pixels, np.ones(pixels.shape[:2]))
    best = np.full((len(shells), *own.shape), -1.0, dtype=np.float32)
    runner_up = best.copy() if len(neighbours) > 2 else None
    for k in neighbours:
        other = views[k]
        relative = other.camera_from_head @ view.camera_from_head.inverse()
        matrix = other.camera.matrix
        slope = (relative.rotate(rays) @ matrix.T).astype(np.float32)
        shift = (matrix @ relative.translation).astype(np.float32)
        for s, offset in enumerate(shells):
            z = depth + offset
            w = np.float32(1.0) / (slope[..., 2] * z + shift[2])
            u, v = (slope[..., 0] * z + shift[0]) * w, (slope[..., 1] * z + shift[1]) * w
            warped = cv2.remap(contrasts[k], u, v, cv2.INTER_LINEAR, borderValue=0)
            score = statistics.correlation(warped.astype(np.float32))
            if runner_up is not None:
                np.maximum(runner_up[s], np.minimum(best[s], score), out=runner_up[s])
            np.maximum(best[s], score, out=best[s])
    return best if runner_up is None else 0.5 * (best + runner_up)


class _Statistics:
    """Normalised correlation of one image's windows with another's."""

    def __init__(self, image: FloatArray, size: tuple[int, int]) -> None:
        self._size = size
        self._image = image
        self._mean = cv2.blur(image, size)
        self._spread = np.sqrt(np.maximum(cv2.blur(image * image, size) - self._mean**2, 1.0))

    def correlation(self, other: FloatArray) -> FloatArray:
        mean = cv2.blur(other, self._size)
        variance = cv2.blur(other * other, self._size) - mean * mean
        shared = cv2.blur(self._image * other, self._size) - self._mean * mean
        return np.asarray(shared / (self._spread * np.sqrt(np.maximum(variance, 1.0))))


_TINY = 1e-6


def _best_shell(scores: FloatArray, shells: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the offset (h, w) of the best shell, refined by a parabola, NaN at the ends; and its score."""
    best = scores.argmax(axis=0)
    inner = (best > 0) & (best < len(shells) - 1)
    at = np.clip(best, 1, len(shells) - 2)[None]
    left, middle, right = (np.take_along_axis(scores, at + d, axis=0)[0] for d in (-1, 0, 1))
    bend = left - 2.0 * middle + right
    shift = np.where(bend < -_TINY, 0.5 * (left - right) / np.minimum(bend, -_TINY), 0.0)
    offset = shells[0] + (at[0] + np.clip(shift, -0.5, 0.5)) * (shells[1] - shells[0])
    return np.where(inner, offset, np.nan), scores.max(axis=0)


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

    def chosen(self, kept: BoolArray) -> "OrientedPoints":
        """Keep some of the points, (n,)."""
        return OrientedPoints(
            points=self.points[kept],
            normals=self.normals[kept],
            on_hull=self.on_hull[kept],
            correlation=self.correlation[kept],
        )


# Points of the skin with normals, made from one view's depth map.


_LONE_STEPS = 1.0  # from the median of its neighbours: further off, a depth is alone


def points_of_depth(
    view: SilhouetteView,
    on_hull: FloatArray,
    depth: FloatArray,
    valid: Mask,
    correlation: FloatArray,
    window: tuple[slice, slice],
    step: float,
    smoothing_px: float,
) -> OrientedPoints:
    """Remove isolated depths, smooth, and compute normals from the slopes of the points.

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
    valid &= -(normals * points).sum(-1) > _LEAST_FACING * np.linalg.norm(points, axis=-1)
    valid[1::2], valid[:, 1::2] = False, False  # windows overlap: every second pixel says as much
    head = view.camera_from_head.inverse()
    return OrientedPoints(
        points=head.apply(points[valid]),
        normals=head.rotate(normals[valid]),
        on_hull=head.apply(view.camera.unproject(view.camera.pixel_grid()[window][valid], on_hull[valid])),
        correlation=correlation[valid],
    )

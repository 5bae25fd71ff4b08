"""Matches between two frames that agree on one epipolar geometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, IntArray, Points2
from vntoolkit.calibration.head.colmap import colmap_from_pixels

_LARGEST_ANGLE = 0.7  # between descriptors of one point, radians
_ESTIMATE_PX, _GUIDE_PX = 2.0, 1.5  # from the epipolar line: while it is sought, and once it is known
_NEVER = 9.0

Features = tuple[Points2, FloatArray]  # positions (n, 2) and unit descriptors (n, 128)


@dataclass(frozen=True, kw_only=True)
class EpipolarMatches:
    """Limits. ratio: of best to second best. least: matches. share: of them, on one geometry."""

    ratio: float
    least: int
    share: float


def match_two_views(camera: Any, first: Features, second: Features, limits: EpipolarMatches) -> IntArray:
    """Match, find the epipolar geometry by RANSAC, match again along its lines; (m, 2) numbers of features.

    camera: pycolmap's. None where too few agree: chance finds such pairs, too.
    """
    import pycolmap

    none = np.zeros((0, 2), np.int64)
    if min(len(first[0]), len(second[0])) < limits.least:
        return none
    angles = np.arccos(np.clip(first[1] @ second[1].T, -1.0, 1.0))
    matches = _mutual(angles, limits.ratio)
    if len(matches) < limits.least:
        return none
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers = limits.least
    options.detect_watermark = False
    options.ransac.max_error = _ESTIMATE_PX
    options.ransac.random_seed = 0
    a, b = colmap_from_pixels(first[0]), colmap_from_pixels(second[0])
    found = pycolmap.estimate_calibrated_two_view_geometry(
        camera, a, camera, b, matches.astype(np.uint32), options
    )
    agreeing = len(found.inlier_matches)
    if found.F is None or agreeing < max(limits.least, limits.share * len(matches)):
        return none
    off = _distance_to_lines(np.asarray(found.F), a, b)
    return _mutual(np.where(off < _GUIDE_PX, angles, _NEVER), limits.ratio)


def _mutual(angles: FloatArray, ratio: float) -> IntArray:
    """Return pairs (m, 2) that are each other's nearest, clearly nearer than the second nearest."""
    rows = np.arange(len(angles))
    two = np.argpartition(angles, 1, axis=1)[:, :2]
    near = np.take_along_axis(angles, two, axis=1)
    best = two[rows, near.argmin(axis=1)]
    least, next_least = near.min(axis=1), near.max(axis=1)
    kept = (angles.argmin(axis=0)[best] == rows) & (least < ratio * next_least) & (least < _LARGEST_ANGLE)
    return np.column_stack([rows[kept], best[kept]])


def _distance_to_lines(fundamental: npt.NDArray[np.float64], a: Points2, b: Points2) -> FloatArray:
    """Return (n, m) the distance in pixels of points b (m, 2) from the epipolar lines of points a (n, 2)."""
    lines = np.column_stack([a, np.ones(len(a))]) @ fundamental.T
    lines /= np.maximum(np.linalg.norm(lines[:, :2], axis=1, keepdims=True), 1e-12)
    return np.abs(lines @ np.column_stack([b, np.ones(len(b))]).T)

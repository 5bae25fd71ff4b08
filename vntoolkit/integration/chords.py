"""From normals to the depth difference along an edge, by the chord between its two surface points.

On a circle the chord between two points is orthogonal to the sum of their normals. Every plane section of a
sphere is a circle, so `(n_1 + n_2) · (P_2 - P_1) = 0` is exact for planes and spheres, orthographic or
perspective, up to the very rim, where the mean of the two slopes grows without bound. Measured on depth of
real objects it is free of bias at every inclination; the mean of the slopes falls too fast from 60 degrees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.integration.graph import PixelGraph

Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class ChordField:
    """One row per edge of a graph, float64.

    difference: (m,) wanted difference of depth (or log depth times focal length), in pixels. variance: (m,)
    its variance, relative to that of an edge between two normals that face the camera.
    """

    difference: Float64
    variance: Float64


def chords_from_normals(
    normals: FloatArray,
    points: FloatArray,
    graph: PixelGraph,
    *,
    perspective: bool,
    pixels_per_unit: float,
    steepest_slope_deg: float,
) -> ChordField:
    """Wanted differences along all edges from normals (n, 3) and image plane points (n, 2) per node.

    A turn of a normal by an angle ε moves its slope by ε / cos² of its inclination: grazing ends make an
    edge unsure. So does a bend, as far as the two ends disagree on the slope (`_BEND`).
    """
    least_facing = float(np.cos(np.deg2rad(steepest_slope_deg)))
    difference, variance = _chords(
        np.ascontiguousarray(normals, dtype=np.float64),
        np.ascontiguousarray(points, dtype=np.float64),
        graph.tail,
        graph.head,
        1.0 if perspective else 0.0,
        pixels_per_unit,
        least_facing,
    )
    return ChordField(difference=difference, variance=variance)


_BEND = 10.0  # standard deviations of a facing edge's difference per pixel of disagreement
_STEEPEST_HALF = 0.9  # half of the difference of log depth, by the chord: 1 would be infinitely steep


@numba.njit(cache=True)
def _along(nx, ny, nz, x1, y1, x2, y2, perspective, scale, least_facing):  # type: ignore[no-untyped-def]
    """Difference in pixels between two points of one plane, and how much the plane faces the rays."""
    rise = nx * (x2 - x1) + ny * (y2 - y1)
    facing = -(perspective * 0.5 * (nx * (x1 + x2) + ny * (y1 + y2)) + nz)
    facing = max(facing, least_facing)
    slope = rise / facing
    if perspective > 0.0:
        half = min(max(0.5 * slope, -_STEEPEST_HALF), _STEEPEST_HALF)
        slope = 2.0 * np.arctanh(half)
    return slope * scale, facing


@numba.njit(cache=True)
def _chords(n, xy, tail, head, perspective, scale, least_facing):  # type: ignore[no-untyped-def]
    count = len(tail)
    difference, variance = np.empty(count), np.empty(count)
    for e in range(count):
        i, j = tail[e], head[e]
        x1, y1, x2, y2 = xy[i, 0], xy[i, 1], xy[j, 0], xy[j, 1]
        sx, sy, sz = n[i, 0] + n[j, 0], n[i, 1] + n[j, 1], n[i, 2] + n[j, 2]
        length = max(np.sqrt(sx * sx + sy * sy + sz * sz), 1e-6)
        difference[e], _ = _along(
            sx / length, sy / length, sz / length, x1, y1, x2, y2, perspective, scale, least_facing
        )
        one, facing1 = _along(n[i, 0], n[i, 1], n[i, 2], x1, y1, x2, y2, perspective, scale, least_facing)
        two, facing2 = _along(n[j, 0], n[j, 1], n[j, 2], x1, y1, x2, y2, perspective, scale, least_facing)
        bend = _BEND * (one - two)
        variance[e] = 0.5 * (facing1**-4.0 + facing2**-4.0) + bend * bend
    return difference, variance

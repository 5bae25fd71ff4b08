"""The bone that a vertex covers: the first that a ball meets which grows on the inner side of the cloth."""

from __future__ import annotations

import numba
import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points

_CLOSER = 1 - 1e-9  # of the ball so far: bones meet at joints, where the first of them is taken


def covered_bones(
    vertices: Points, normals: Points, joints: IntArray, starts: Points, ends: Points
) -> tuple[IntArray, FloatArray]:
    """Return the joint that each vertex covers (n,), −1 for none, and its distance to that bone (n,), inf.

    vertices, normals: (n, 3), outward. joints, starts, ends: bones as `bone_segments` gives them. The ball
    touches the cloth at the vertex from within, so |p − v|² / (2 n·(v − p)) is its radius when it reaches
    a point p: a flank covers the spine, although an arm that hangs beside it is nearer.
    """
    return _first_met(
        np.ascontiguousarray(vertices, dtype=np.float64),
        np.ascontiguousarray(normals, dtype=np.float64),
        joints,
        np.ascontiguousarray(starts),
        np.ascontiguousarray(ends),
    )


@numba.njit(cache=True)
def _first_met(vertices, normals, joints, starts, ends):  # type: ignore[no-untyped-def]
    covered = np.full(len(vertices), -1, np.int32)
    distances = np.full(len(vertices), np.inf)
    for v in range(len(vertices)):
        least = np.inf
        for b in range(len(joints)):
            radius, along = _ball_radius(vertices[v], normals[v], starts[b], ends[b])
            if radius < _CLOSER * least:
                least = radius
                covered[v] = joints[b]
                squared = 0.0
                for axis in range(3):
                    foot = starts[b, axis] + along * (ends[b, axis] - starts[b, axis])
                    squared += (foot - vertices[v, axis]) ** 2
                distances[v] = np.sqrt(squared)
    return covered, distances


@numba.njit(cache=True)
def _ball_radius(vertex, normal, start, end):  # type: ignore[no-untyped-def]
    """Minimise (A t² + 2 B t + C) / (2 (D + E t)) over 0 ≤ t ≤ 1; convex where D + E t > 0."""
    a = b = c = d = e = 0.0
    for axis in range(3):
        bone, away = end[axis] - start[axis], start[axis] - vertex[axis]
        a += bone * bone
        b += bone * away
        c += away * away
        d -= normal[axis] * away
        e -= normal[axis] * bone
    # The derivative vanishes where A E t² + 2 A D t + 2 B D − E C = 0, or B / A behind it where E = 0.
    level = abs(e) < 1e-12 * np.sqrt(a)
    root = np.sqrt(max(a * a * d * d - a * e * (2 * b * d - e * c), 0.0))
    flat = -b / a
    least, place = np.inf, 0.0
    for t in (
        0.0,
        1.0,
        flat if level else (root - a * d) / (a * e),
        flat if level else -(root + a * d) / (a * e),
    ):
        depth = d + e * t
        if 0.0 <= t <= 1.0 and depth > 0.0:
            radius = (a * t * t + 2 * b * t + c) / (2 * depth)
            if radius < least:
                least, place = radius, t
    return least, place

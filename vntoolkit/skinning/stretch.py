"""How far cloth is stretched, triangle by triangle, and the drawing together of what stretches too far."""

import numba
import numpy as np

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.native import njit

_REACHED = 1.02  # of the square of a length: near enough, else neighbours pull at each other without end
_SWEEPS = 24  # more of them move less than a thousandth of the cloth


def edge_lengths(vertices: Points, faces: Faces) -> FloatArray:
    """Return (m, 3): the lengths of each triangle's edges, from each corner to the next."""
    corners = vertices[faces]
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)


def greatest_growth(vertices: Points, faces: Faces, lengths: FloatArray) -> FloatArray:
    """Return (m,): how much the most stretched edge of each triangle has grown; lengths: `edge_lengths`."""
    return _greatest_growth(np.ascontiguousarray(vertices, dtype=np.float64), faces, lengths)


@njit(cache=True, parallel=True)
def _greatest_growth(vertices, faces, lengths):  # type: ignore[no-untyped-def]
    growth = np.empty(len(faces))
    for f in numba.prange(len(faces)):
        most = 0.0
        for k in range(3):
            a, b = faces[f, k], faces[f, (k + 1) % 3]
            squared = 0.0
            for axis in range(3):
                squared += (vertices[a, axis] - vertices[b, axis]) ** 2
            if lengths[f, k] > 0.0:
                most = max(most, np.sqrt(squared) / lengths[f, k])
        growth[f] = most
    return growth


def drawn_together(vertices: Points, edges: Faces, longest: FloatArray) -> Points:
    """Return (n, 3): both ends of every edge that is longer than allowed, (e,), drawn together, provot1995.

    edges: (e, 2). They take turns until none is too long, or a number of times. What is not stretched does
    not move.
    """
    moved = np.array(vertices, dtype=np.float64)
    _draw_together(moved, edges, longest)
    return moved


@njit(cache=True)
def _draw_together(vertices, edges, longest):  # type: ignore[no-untyped-def]
    squares = _REACHED * longest * longest
    now = _stretched(vertices, edges, squares)
    if not len(now):
        return
    starts, about = _edges_about(len(vertices), edges)
    is_near = np.zeros(len(edges), np.bool_)
    for sweep in range(_SWEEPS):
        is_near[:] = False
        is_done = True
        for step in range(len(now)):
            e = now[step] if sweep % 2 == 0 else now[len(now) - 1 - step]  # no side is favoured
            a, b = edges[e, 0], edges[e, 1]
            x = vertices[b, 0] - vertices[a, 0]
            y = vertices[b, 1] - vertices[a, 1]
            z = vertices[b, 2] - vertices[a, 2]
            squared = x * x + y * y + z * z
            if squared > squares[e]:
                is_done = False
                share = 0.5 * (1.0 - longest[e] / np.sqrt(squared))
                vertices[a, 0] += share * x
                vertices[a, 1] += share * y
                vertices[a, 2] += share * z
                vertices[b, 0] -= share * x
                vertices[b, 1] -= share * y
                vertices[b, 2] -= share * z
                for v in (a, b):
                    for k in range(starts[v], starts[v + 1]):
                        is_near[about[k]] = True
        if is_done:
            break
        now = np.flatnonzero(is_near)


@njit(cache=True)
def _stretched(vertices, edges, squares):  # type: ignore[no-untyped-def]
    found = np.zeros(len(edges), np.bool_)
    for e in range(len(edges)):
        squared = 0.0
        for axis in range(3):
            squared += (vertices[edges[e, 1], axis] - vertices[edges[e, 0], axis]) ** 2
        found[e] = squared > squares[e]
    return np.flatnonzero(found)


@njit(cache=True)
def _edges_about(count, edges):  # type: ignore[no-untyped-def]
    """Return where the edges about each vertex begin, (n + 1,), in the list of them, (2 e,)."""
    starts = np.zeros(count + 2, np.int64)
    for e in range(len(edges)):
        for k in range(2):
            starts[edges[e, k] + 2] += 1
    starts = np.cumsum(starts)
    about = np.empty(2 * len(edges), np.int32)
    for e in range(len(edges)):
        for k in range(2):
            v = edges[e, k]
            about[starts[v + 1]] = e
            starts[v + 1] += 1
    return starts, about

"""How far cloth is stretched, triangle by triangle, and the drawing together of what stretches too far."""

from __future__ import annotations

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

    Edges take turns until none is too long, or a number of times. What is not stretched does not move.
    """
    moved = np.array(vertices, dtype=np.float64)
    _draw_together(moved, edges, longest)
    return moved


@njit(cache=True)
def _draw_together(vertices, edges, longest):  # type: ignore[no-untyped-def]
    moved = np.full(len(vertices), -1, dtype=np.int32)  # in which sweep last: other edges are as they were
    for sweep in range(_SWEEPS):
        is_done = True
        for step in range(len(edges)):
            e = step if sweep % 2 == 0 else len(edges) - 1 - step  # no side is favoured
            a, b = edges[e, 0], edges[e, 1]
            if moved[a] < sweep - 1 and moved[b] < sweep - 1:
                continue
            x = vertices[b, 0] - vertices[a, 0]
            y = vertices[b, 1] - vertices[a, 1]
            z = vertices[b, 2] - vertices[a, 2]
            squared = x * x + y * y + z * z
            if squared > _REACHED * longest[e] * longest[e]:
                is_done = False
                moved[a], moved[b] = sweep, sweep
                share = 0.5 * (1.0 - longest[e] / np.sqrt(squared))
                vertices[a, 0] += share * x
                vertices[a, 1] += share * y
                vertices[a, 2] += share * z
                vertices[b, 0] -= share * x
                vertices[b, 1] -= share * y
                vertices[b, 2] -= share * z
        if is_done:
            break

"""How far cloth is stretched, triangle by triangle, and the drawing together of what stretches too far."""

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.native import njit

STRETCHED = 2.0  # a knit bears about so much
_REACHED = 1.02  # of the square of a length: near enough, else neighbours pull at each other without end
_SWEEPS = 24  # more of them move less than a thousandth of the cloth


def edge_lengths(vertices: Points, faces: Faces) -> FloatArray:
    """Return (m, 3): the lengths of each triangle's edges, from each corner to the next."""
    corners = vertices[faces]
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)


def greatest_growth(vertices: Points, faces: Faces, lengths: FloatArray) -> FloatArray:
    """Return (m,): how much the most stretched edge of each triangle has grown; lengths: `edge_lengths`."""
    now = edge_lengths(np.asarray(vertices, dtype=np.float64), faces)
    return np.divide(now, lengths, out=np.zeros_like(now), where=lengths > 0.0).max(axis=1)


def drawn_together(vertices: Points, edges: Faces, longest: FloatArray) -> Points:
    """Return (n, 3): both ends of every edge that is longer than allowed, (e,), drawn together, provot1995.

    edges: (e, 2). They take turns until none is too long, or a number of times. What is not stretched does
    not move.
    """
    moved, squares = np.array(vertices, dtype=np.float64), _REACHED * longest**2
    now = np.flatnonzero(np.square(moved[edges[:, 1]] - moved[edges[:, 0]]).sum(axis=1) > squares)
    if len(now):
        ends = edges.ravel()
        about = np.argsort(ends, kind="stable") // 2  # the edges of each vertex, one vertex after another
        starts = np.append(0, np.cumsum(np.bincount(ends, minlength=len(moved))))
        _draw_together(moved, edges, longest, squares, now, starts, about)
    return moved


@njit
def _draw_together(vertices, edges, longest, squares, now, starts, about):  # type: ignore[no-untyped-def]
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

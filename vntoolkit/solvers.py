"""Weighted graph Laplacians on a pixel grid, solved by conjugate gradients with a multigrid cycle.

The matrix is L = Σ_edges w_ij (e_i − e_j)(e_i − e_j)ᵀ + ground · I over the eight-neighbour edges of a grid.
Edge weights may be zero (pixels outside the mask, cut edges) or negative as long as L stays positive
semidefinite, which the assembly in `surface_kernels` guarantees.

One thread works: two would meet thousands of times a frame, and on a busy machine every meeting can cost a
time slice (measured: 35 s for what one thread does in 2).

A coarser level sums the edges between blocks of 2×2 pixels and halves them: in two dimensions that is the
matrix the coarse grid itself would have, while the plain Galerkin sum is twice too stiff for piecewise
constant prolongation (over-correction of aggregation multigrid, braess1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.native import njit

_SMALLEST_SIDE = 4
_LAST_SWEEPS = 20  # on the coarsest grid, each way
Grid = npt.NDArray[np.float32]
Row = npt.NDArray[np.float32]
_GROUND = 1e-6  # pins the free constant of every connected piece; far below any data weight


@dataclass(frozen=True, kw_only=True, eq=False)
class GridLevel:
    """One grid of the hierarchy: edges (4, h, w) float32 to the east, south, south-east and (stored at the
    upper left pixel of the 2×2 block) from the upper right to the lower left pixel, or (2, h, w), without the
    diagonal ones; inverse (h, w) of the diagonal, 0 where a pixel has no edge.
    """

    edges: Grid
    inverse: Grid


def grid_hierarchy(edges: Grid) -> list[GridLevel]:
    """Build all levels from the finest edges, (4, h, w) or (2, h, w)."""
    levels = []
    while True:
        levels.append(GridLevel(edges=edges, inverse=inverse_kernel(diagonal_kernel(edges))))
        if min(edges.shape[1:]) <= _SMALLEST_SIDE:
            return levels
        edges = coarse_edges_kernel(edges)


def solve_grid(
    levels: list[GridLevel], right: Grid, start: Grid, tolerance: float, most_iterations: int
) -> Grid:
    """Solve L x = right from `start` until the residual falls to `tolerance` of the right-hand side.

    right, start: (h, w) float32. Returns (h, w) float32, which after `most_iterations` may be short of the
    tolerance: a Gauss–Newton step need not be solved to the end.
    """
    x = start.astype(np.float32).copy()
    residual = right - apply_kernel(levels[0].edges, x)
    target = tolerance * float(np.linalg.norm(right))
    direction = np.zeros_like(x)
    previous = 0.0
    for _ in range(most_iterations):
        if float(np.linalg.norm(residual)) <= target:
            break
        cleaned = multigrid_cycle(levels, residual)
        now = _dot(residual, cleaned)
        if not now > 0.0:
            break
        direction = cleaned if previous == 0.0 else cleaned + np.float32(now / previous) * direction
        previous = now
        image = apply_kernel(levels[0].edges, direction)
        curvature = _dot(direction, image)
        if not curvature > 0.0:
            break
        step = np.float32(now / curvature)
        x += step * direction
        residual -= step * image
    return x


def _dot(first: Grid, second: Grid) -> float:
    return float(np.vdot(first, second))


def multigrid_cycle(levels: list[GridLevel], right: Grid, depth: int = 0) -> Grid:
    """Approximate the x of L x = right by one symmetric V cycle."""
    level = levels[depth]
    x = np.empty_like(right)
    first_sweep_kernel(level.edges, level.inverse, right, x)
    if depth + 1 < len(levels):
        coarse_right = restrict_rest_kernel(level.edges, x)
        prolong_add_kernel(multigrid_cycle(levels, coarse_right, depth + 1), level.inverse, x)
    else:
        for _ in range(_LAST_SWEEPS - 1):
            sweep_kernel(level.edges, level.inverse, right, x, True)
        for _ in range(_LAST_SWEEPS - 1):
            sweep_kernel(level.edges, level.inverse, right, x, False)
    sweep_kernel(level.edges, level.inverse, right, x, False)
    return x


# Compiled loops of `grid_solver`. Edges (4, h, w): see `GridLevel`.


@njit(cache=True, fastmath=True, error_model="numpy")
def apply_kernel(edges: Grid, x: Grid) -> Grid:
    """L x."""
    h, w = x.shape
    out = np.empty_like(x)
    pull = np.empty(w, np.float32)
    for v in range(h):
        row, to = x[v], out[v]
        for u in range(w):
            to[u] = np.float32(_GROUND) * row[u]
        _add_differences(edges[0, v, : w - 1], row[: w - 1], row[1:], to[: w - 1], to[1:], pull)
        if v + 1 < h:
            _add_difference(edges[1, v], row, x[v + 1], to)
            if len(edges) == 4:
                _add_difference(edges[2, v, : w - 1], row[: w - 1], x[v + 1, 1:], to[: w - 1])
                _add_difference(edges[3, v, : w - 1], row[1:], x[v + 1, : w - 1], to[1:])
        if v > 0:
            _add_difference(edges[1, v - 1], row, x[v - 1], to)
            if len(edges) == 4:
                _add_difference(edges[2, v - 1, : w - 1], row[1:], x[v - 1, : w - 1], to[1:])
                _add_difference(edges[3, v - 1, : w - 1], row[: w - 1], x[v - 1, 1:], to[: w - 1])
    return out


@njit(cache=True, fastmath=True, inline="always", error_model="numpy")
def _add_difference(weight: Row, here: Row, there: Row, out: Row) -> None:
    for u in range(len(weight)):
        out[u] += weight[u] * (here[u] - there[u])


@njit(cache=True, fastmath=True, inline="always", error_model="numpy")
def _add_differences(weight: Row, first: Row, second: Row, out: Row, other: Row, pull: Row) -> None:
    """Along a row, where both ends of an edge are in it."""
    for u in range(len(weight)):
        pull[u] = weight[u] * (first[u] - second[u])
    for u in range(len(weight)):
        out[u] += pull[u]
    for u in range(len(weight)):
        other[u] -= pull[u]


@njit(cache=True, fastmath=True, error_model="numpy")
def diagonal_kernel(edges: Grid) -> Grid:
    """L's diagonal (h, w)."""
    kinds, h, w = edges.shape
    out = np.full((h, w), np.float32(_GROUND))
    for v in range(h):
        for u in range(w):
            if u + 1 < w:
                out[v, u] += edges[0, v, u]
                out[v, u + 1] += edges[0, v, u]
            if v + 1 < h:
                out[v, u] += edges[1, v, u]
                out[v + 1, u] += edges[1, v, u]
                if u + 1 < w and kinds == 4:
                    out[v, u] += edges[2, v, u]
                    out[v + 1, u + 1] += edges[2, v, u]
                    out[v, u + 1] += edges[3, v, u]
                    out[v + 1, u] += edges[3, v, u]
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def inverse_kernel(diagonal: Grid) -> Grid:
    """1 / diagonal; 0 where a pixel has no edge: it belongs to nothing and stays as it is, at 0."""
    h, w = diagonal.shape
    out = np.zeros((h, w), np.float32)
    for v in range(h):
        for u in range(w):
            if diagonal[v, u] > np.float32(2 * _GROUND):
                out[v, u] = np.float32(1.0) / diagonal[v, u]
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def sweep_kernel(edges: Grid, inverse: Grid, right: Grid, x: Grid, forward: bool) -> None:
    """One Gauss–Seidel sweep, row by row; backward, the reverse of that.

    All of a row but the neighbour just solved is gathered first, in loops that the compiler vectorises; what
    remains is one multiplication and one addition a pixel (six times faster than pixel by pixel).
    """
    h, w = x.shape
    known, pull = np.empty(w, np.float32), np.empty(w, np.float32)
    for i in range(h):
        v = i if forward else h - 1 - i
        _gather_rows(edges, right, x, v, known)
        scale, bond, row = inverse[v], edges[0, v], x[v]
        if forward:
            for u in range(w - 1):
                known[u] = (known[u] + bond[u] * row[u + 1]) * scale[u]
            known[w - 1] *= scale[w - 1]
            for u in range(1, w):
                pull[u] = bond[u - 1] * scale[u]
            last = known[0]
            row[0] = last
            for u in range(1, w):
                last = known[u] + pull[u] * last
                row[u] = last
        else:
            for u in range(1, w):
                known[u] = (known[u] + bond[u - 1] * row[u - 1]) * scale[u]
            known[0] *= scale[0]
            for u in range(w - 1):
                pull[u] = bond[u] * scale[u]
            last = known[w - 1]
            row[w - 1] = last
            for u in range(w - 2, -1, -1):
                last = known[u] + pull[u] * last
                row[u] = last


@njit(cache=True, fastmath=True, error_model="numpy")
def _gather_rows(edges: Grid, right: Grid, x: Grid, v: int, out: Row) -> None:
    """Fill out (w,) with the right-hand side of row v and what the rows above and below pull."""
    for u in range(x.shape[1]):
        out[u] = right[v, u]
    _pull_from_below(edges, x, v, out)
    _pull_from_above(edges, x, v, out)


@njit(cache=True, fastmath=True, error_model="numpy")
def _pull_from_below(edges: Grid, x: Grid, v: int, out: Row) -> None:
    """Add to out (w,) what the row below v pulls."""
    h, w = x.shape
    if v + 1 < h:
        below, down = x[v + 1], edges[1, v]
        for u in range(w):
            out[u] += down[u] * below[u]
        if len(edges) == 4:
            east, west = edges[2, v], edges[3, v]
            for u in range(w - 1):
                out[u] += east[u] * below[u + 1]
            for u in range(1, w):
                out[u] += west[u - 1] * below[u - 1]


@njit(cache=True, fastmath=True, error_model="numpy")
def _pull_from_above(edges: Grid, x: Grid, v: int, out: Row) -> None:
    """Add to out (w,) what the row above v pulls."""
    w = x.shape[1]
    if v > 0:
        above, up = x[v - 1], edges[1, v - 1]
        for u in range(w):
            out[u] += up[u] * above[u]
        if len(edges) == 4:
            west, east = edges[2, v - 1], edges[3, v - 1]
            for u in range(w - 1):
                out[u] += east[u] * above[u + 1]
            for u in range(1, w):
                out[u] += west[u - 1] * above[u - 1]


@njit(cache=True, fastmath=True, error_model="numpy")
def coarse_edges_kernel(edges: Grid) -> Grid:
    """Half the sum of the edges between blocks of 2×2 pixels; those inside a block drop out."""
    kinds, h, w = edges.shape
    ch, cw = (h + 1) // 2, (w + 1) // 2
    out = np.zeros((kinds, ch, cw), np.float32)
    if kinds == 2:
        _halve_edges(edges, out)
        return out
    for v in range(h):
        for u in range(w):
            for kind in range(4):
                weight = edges[kind, v, u]
                if weight == 0.0:
                    continue
                u1 = u + (1 if kind == 3 else 0)
                v2 = v + (0 if kind == 0 else 1)
                u2 = u + (1 if kind == 0 or kind == 2 else 0)
                a, b = u1 // 2, v // 2
                c, d = u2 // 2, v2 // 2
                half = np.float32(0.5) * weight
                if a == c and b == d:
                    continue
                if b == d:
                    out[0, b, min(a, c)] += half
                elif a == c:
                    out[1, b, a] += half
                elif c > a:
                    out[2, b, a] += half
                else:
                    out[3, b, c] += half
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def _halve_edges(edges: Grid, out: Grid) -> None:
    """The same without diagonals: an edge between blocks starts at every second pixel."""
    _, h, w = edges.shape
    half = np.float32(0.5)
    for v in range(h):
        for column in range((w - 1) // 2):
            out[0, v // 2, column] += half * edges[0, v, 2 * column + 1]
    for v in range(1, h - 1, 2):
        for u in range(w):
            out[1, v // 2, u // 2] += half * edges[1, v, u]


@njit(cache=True, fastmath=True, error_model="numpy")
def first_sweep_kernel(edges: Grid, inverse: Grid, right: Grid, x: Grid) -> None:
    """Fill x with the forward sweep from 0: a pixel sees only those before it."""
    h, w = x.shape
    known, pull = np.empty(w, np.float32), np.empty(w, np.float32)
    for v in range(h):
        bond, scale, row, asked = edges[0, v], inverse[v], x[v], right[v]
        for u in range(w):
            known[u] = asked[u]
        _pull_from_above(edges, x, v, known)
        for u in range(w):
            known[u] *= scale[u]
        for u in range(1, w):
            pull[u] = bond[u - 1] * scale[u]
        last = known[0]
        row[0] = last
        for u in range(1, w):
            last = known[u] + pull[u] * last
            row[u] = last


@njit(cache=True, fastmath=True, error_model="numpy")
def restrict_rest_kernel(edges: Grid, x: Grid) -> Grid:
    """Sum what `first_sweep_kernel` leaves of the right-hand side over blocks of 2×2 pixels.

    Every pixel was right when it was solved; what is left is what the pixels after it pull.
    """
    h, w = x.shape
    out = np.zeros(((h + 1) // 2, (w + 1) // 2), np.float32)
    left = np.empty(w + 1, np.float32)
    for v in range(h):
        bond, row, to = edges[0, v], x[v], out[v // 2]
        for u in range(w - 1):
            left[u] = bond[u] * row[u + 1]
        left[w - 1] = left[w] = np.float32(0.0)
        _pull_from_below(edges, x, v, left)
        for u in range(len(to)):
            to[u] += left[2 * u] + left[2 * u + 1]
    return out


@njit(cache=True, fastmath=True, error_model="numpy")
def prolong_add_kernel(coarse: Grid, inverse: Grid, x: Grid) -> None:
    """Add to every pixel that has an edge the value of its block."""
    h, w = x.shape
    for v in range(h):
        for u in range(w):
            if inverse[v, u] > 0.0:
                x[v, u] += coarse[v // 2, u // 2]

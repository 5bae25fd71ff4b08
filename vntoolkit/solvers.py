"""Weighted graph Laplacians on a pixel grid, solved by conjugate gradients with a multigrid cycle.

The matrix is L = Σ_edges w_ij (e_i − e_j)(e_i − e_j)ᵀ + ground · I over the eight-neighbour edges of a grid.
Edge weights may be zero (pixels outside the mask, cut edges) or negative as long as L stays positive
semidefinite, which the assembly in `shadows/surface.py` guarantees.

The upper and the lower half of a large grid are swept at the same time, each as if the other stood still;
for every number of threads the sums are the same. On small grids one thread works: two would meet thousands
of times a frame, and on a busy machine every meeting can cost a time slice (measured: 35 s instead of 2).

A coarser level sums the edges between blocks of 2×2 pixels and halves them: in two dimensions that is the
matrix the coarse grid itself would have, while the plain Galerkin sum is twice too stiff for piecewise
constant prolongation (over-correction of aggregation multigrid, braess1995).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.native import njit

_SMALLEST_SIDE = 4
_LAST_SWEEPS = 20  # on the coarsest grid, each way
_LARGE = 40_000  # pixels from which on a grid is swept in two halves
Grid = npt.NDArray[np.float32]
Row = npt.NDArray[np.float32]
_GROUND = 1e-6  # pins the free constant of every connected piece; far below any data weight


@dataclass(frozen=True, kw_only=True, eq=False)
class GridHierarchy:
    """Grids, each about half as high and wide as the one before.

    edges: per grid (4, h, w) float32 to the east, south, south-east and (stored at the upper left pixel of
    the 2×2 block) from the upper right to the lower left pixel, or (2, h, w), without the diagonal ones.
    inverse: per grid (h, w), 1 over the diagonal, 0 where a pixel has no edge. shapes: (n, 2), first:
    (n + 1,), where each grid begins in `flat`: kinds of edges, inverse, right-hand side and solution.
    """

    edges: list[Grid]
    inverse: list[Grid]
    shapes: npt.NDArray[np.int64]
    first: npt.NDArray[np.int64]
    flat: Grid


def grid_hierarchy(edges: Grid) -> GridHierarchy:
    """Build all grids from the finest edges, (4, h, w) or (2, h, w)."""
    kinds, height, width = edges.shape
    shapes = [(height, width)]
    while min(shapes[-1]) > _SMALLEST_SIDE:
        shapes.append(((shapes[-1][0] + 1) // 2, (shapes[-1][1] + 1) // 2))
    first = np.concatenate([[0], np.cumsum([h * w for h, w in shapes])])
    flat = np.empty((kinds + 3) * int(first[-1]), np.float32)
    all_edges: list[Grid] = []
    all_inverse: list[Grid] = []
    for i, (h, w) in enumerate(shapes):
        start = (kinds + 3) * int(first[i])
        own = flat[start : start + kinds * h * w].reshape(kinds, h, w)
        if i == 0:
            own[...] = edges
        else:
            coarse_edges_kernel(all_edges[-1], own)
        inverse = flat[start + kinds * h * w :][: h * w].reshape(h, w)
        inverse_kernel(own, inverse)
        all_edges.append(own)
        all_inverse.append(inverse)
    return GridHierarchy(
        edges=all_edges, inverse=all_inverse, shapes=np.array(shapes), first=first, flat=flat
    )


def solve_grid(
    levels: GridHierarchy, right: Grid, start: Grid, tolerance: float, most_iterations: int
) -> Grid:
    """Solve L x = right from `start` until the residual falls to `tolerance` of the right-hand side.

    right, start: (h, w) float32. Returns (h, w) float32, which after `most_iterations` may be short of the
    tolerance: a Gauss–Newton step need not be solved to the end.
    """
    x = start.astype(np.float32).copy()
    residual = right - apply_kernel(levels.edges[0], x)
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
        image = apply_kernel(levels.edges[0], direction)
        curvature = _dot(direction, image)
        if not curvature > 0.0:
            break
        step = np.float32(now / curvature)
        x += step * direction
        residual -= step * image
    return x


def _dot(first: Grid, second: Grid) -> float:
    return float(np.vdot(first, second))


def multigrid_cycle(levels: GridHierarchy, right: Grid) -> Grid:
    """Approximate the x of L x = right by one symmetric V cycle."""
    x = np.empty_like(right)
    _cycle_kernel(levels.flat, levels.shapes, levels.first, len(levels.edges[0]), right, x)
    return x


@njit(cache=True, fastmath=True, error_model="numpy")
def _cycle_kernel(
    flat: Row, shapes: npt.NDArray[np.int64], first: npt.NDArray[np.int64], kinds: int, right: Grid, x: Grid
) -> None:
    count = len(shapes)
    last = count - 1
    for i in range(count):
        edges, inverse, asked, solution = _grid_of(flat, shapes, first, kinds, i)
        if i == 0:
            asked[...] = right
        first_sweep_kernel(edges, inverse, asked, solution)
        if i < last:
            _, _, coarse_right, _ = _grid_of(flat, shapes, first, kinds, i + 1)
            restrict_rest_kernel(edges, solution, coarse_right)
    edges, inverse, asked, solution = _grid_of(flat, shapes, first, kinds, last)
    for i in range(2 * (_LAST_SWEEPS - 1)):
        sweep_kernel(edges, inverse, asked, solution, i < _LAST_SWEEPS - 1)
    for k in range(count):
        i = last - k
        edges, inverse, asked, solution = _grid_of(flat, shapes, first, kinds, i)
        if i < last:
            _, _, _, coarse = _grid_of(flat, shapes, first, kinds, i + 1)
            prolong_add_kernel(coarse, inverse, solution)
        last_sweep_kernel(edges, inverse, asked, solution)
    x[...] = solution


@njit(cache=True, error_model="numpy")
def _grid_of(
    flat: Row, shapes: npt.NDArray[np.int64], first: npt.NDArray[np.int64], kinds: int, i: int
) -> tuple[Grid, Grid, Grid, Grid]:
    """Return edges, inverse, right-hand side and solution of one grid."""
    h, w = shapes[i, 0], shapes[i, 1]
    size, start = h * w, (kinds + 3) * first[i]
    after = start + kinds * size
    return (
        flat[start:after].reshape((kinds, h, w)),
        flat[after : after + size].reshape((h, w)),
        flat[after + size : after + 2 * size].reshape((h, w)),
        flat[after + 2 * size : after + 3 * size].reshape((h, w)),
    )


# Compiled loops. Edges (4, h, w): see `GridHierarchy`.


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
def inverse_kernel(edges: Grid, out: Grid) -> None:
    """1 / L's diagonal; 0 where a pixel has no edge: it belongs to nothing and stays as it is, at 0."""
    h, w = out.shape
    last, one, ground = w - 1, np.float32(1.0), np.float32(_GROUND)
    for v in range(h):
        to, after, east = out[v], out[v, 1:], edges[0, v, :last]
        for u in range(w):
            to[u] = ground
        _add(east, to)
        _add(east, after)
        if v + 1 < h:
            _add(edges[1, v], to)
            if len(edges) == 4:
                _add(edges[2, v, :last], to)
                _add(edges[3, v, :last], after)
        if v > 0:
            _add(edges[1, v - 1], to)
            if len(edges) == 4:
                _add(edges[2, v - 1, :last], after)
                _add(edges[3, v - 1, :last], to)
        for u in range(w):
            some = to[u] > np.float32(2 * _GROUND)
            to[u] = one / to[u] if some else np.float32(0.0)


@njit(cache=True, fastmath=True, forceinline=True, error_model="numpy")
def _add(weight: Row, out: Row) -> None:
    for u in range(len(weight)):
        out[u] += weight[u]


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
    if v + 1 < len(x):
        _pull_from_below(edges, x[v + 1], v, out)
    if v > 0:
        _pull_from_above(edges, x[v - 1], v, out)


@njit(cache=True, fastmath=True, error_model="numpy")
def _pull_from_below(edges: Grid, below: Row, v: int, out: Row) -> None:
    """Add to out (w,) what the row below v pulls."""
    w = len(below)
    down = edges[1, v]
    for u in range(w):
        out[u] += down[u] * below[u]
    if len(edges) == 4:
        east, west, ahead, beside = edges[2, v], edges[3, v], below[1:], out[1:]
        for u in range(w - 1):
            out[u] += east[u] * ahead[u]
        for u in range(w - 1):
            beside[u] += west[u] * below[u]


@njit(cache=True, fastmath=True, error_model="numpy")
def _pull_from_above(edges: Grid, above: Row, v: int, out: Row) -> None:
    """Add to out (w,) what the row above v pulls."""
    w = len(above)
    up = edges[1, v - 1]
    for u in range(w):
        out[u] += up[u] * above[u]
    if len(edges) == 4:
        west, east, ahead, beside = edges[2, v - 1], edges[3, v - 1], above[1:], out[1:]
        for u in range(w - 1):
            beside[u] += west[u] * above[u]
        for u in range(w - 1):
            out[u] += east[u] * ahead[u]


@njit(cache=True, error_model="numpy")
def _middle(h: int, w: int) -> int:
    """Return the row where the lower half begins; 0 where a grid is swept in one."""
    return 2 * (h // 4) if h * w >= _LARGE else 0


@njit(cache=True, fastmath=True, error_model="numpy")
def coarse_edges_kernel(edges: Grid, out: Grid) -> None:
    """Fill out with half the sum of the edges between blocks of 2×2 pixels; those inside one drop out."""
    kinds, h, w = edges.shape
    out[...] = np.float32(0.0)
    if kinds == 2:
        _halve_edges(edges, out)
        return
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


@njit(cache=True, fastmath=True, error_model="numpy", parallel=True)
def _two_first_sweeps(edges: Grid, inverse: Grid, right: Grid, x: Grid, middle: int) -> None:
    for half in prange(2):
        _first_sweep(edges, inverse, right, x, half * middle, middle if half == 0 else len(x))


@njit(cache=True, fastmath=True, error_model="numpy")
def first_sweep_kernel(edges: Grid, inverse: Grid, right: Grid, x: Grid) -> None:
    """Fill x with the forward sweep from 0: a pixel sees only those before it, in its half."""
    middle = _middle(*x.shape)
    if middle:
        _two_first_sweeps(edges, inverse, right, x, middle)
    else:
        _first_sweep(edges, inverse, right, x, np.int64(0), len(x))


@njit(cache=True, fastmath=True, error_model="numpy")
def _first_sweep(edges: Grid, inverse: Grid, right: Grid, x: Grid, top: int, end: int) -> None:
    w = x.shape[1]
    known, pull = np.empty(w, np.float32), np.empty(w, np.float32)
    for v in range(top, end):
        scale, row, asked = inverse[v], x[v], right[v]
        for u in range(w):
            known[u] = asked[u]
        if v > top:
            _pull_from_above(edges, x[v - 1], v, known)
        _scale_row(known, edges[0, v], scale[1:], scale, pull[1:])
        last = known[0]
        row[0] = last
        for u in range(1, w):
            last = known[u] + pull[u] * last
            row[u] = last


@njit(cache=True, fastmath=True, error_model="numpy")
def _scale_row(known: Row, bond: Row, beside: Row, scale: Row, pull: Row) -> None:
    for u in range(len(known)):
        known[u] *= scale[u]
    for u in range(len(pull)):
        pull[u] = bond[u] * beside[u]


@njit(cache=True, fastmath=True, error_model="numpy", parallel=True)
def _two_last_sweeps(edges: Grid, inverse: Grid, right: Grid, x: Grid, middle: int) -> None:
    above, below = x[middle - 1].copy(), x[middle].copy()
    for half in prange(2):
        if half == 0:
            _last_sweep(edges, inverse, right, x, 0, middle, above, below)
        else:
            _last_sweep(edges, inverse, right, x, middle, len(x), above, below)


@njit(cache=True, fastmath=True, error_model="numpy")
def last_sweep_kernel(edges: Grid, inverse: Grid, right: Grid, x: Grid) -> None:
    """One sweep back: the transpose of `first_sweep_kernel`."""
    middle = _middle(*x.shape)
    if middle:
        _two_last_sweeps(edges, inverse, right, x, middle)
    else:
        _last_sweep(edges, inverse, right, x, np.int64(0), len(x), x[0], x[0])


@njit(cache=True, fastmath=True, error_model="numpy")
def _last_sweep(
    edges: Grid, inverse: Grid, right: Grid, x: Grid, top: int, end: int, above: Row, below: Row
) -> None:
    """above, below: the rows before and from the middle on as they were: what the other half holds."""
    h, w = x.shape
    known, pull = np.empty(w, np.float32), np.empty(w, np.float32)
    for i in range(end - top):
        v = end - 1 - i
        scale, row, bond = inverse[v], x[v], edges[0, v]
        for u in range(w):
            known[u] = right[v, u]
        if v + 1 < h:
            _pull_from_below(edges, below if v + 1 == end else x[v + 1], v, known)
        if v > 0:
            _pull_from_above(edges, above if v == top else x[v - 1], v, known)
        beside = known[1:]
        for u in range(w - 1):
            beside[u] += bond[u] * row[u]
        _scale_row(known, bond, scale[: w - 1], scale, pull[: w - 1])
        last = known[w - 1]
        row[w - 1] = last
        for u in range(w - 2, -1, -1):
            last = known[u] + pull[u] * last
            row[u] = last


@njit(cache=True, fastmath=True, error_model="numpy")
def restrict_rest_kernel(edges: Grid, x: Grid, out: Grid) -> None:
    """Fill out with the sums over blocks of 2×2 pixels of what `first_sweep_kernel` leaves.

    Every pixel was right when it was solved; what is left is what the pixels after it, and the other half,
    pull.
    """
    middle = _middle(*x.shape)
    _restrict(edges, x, out, np.int64(0), middle)
    _restrict(edges, x, out, middle, len(x))


@njit(cache=True, fastmath=True, error_model="numpy")
def _restrict(edges: Grid, x: Grid, out: Grid, top: int, end: int) -> None:
    h, w = x.shape
    left = np.empty(w + 1, np.float32)
    for v in range(top, end):
        bond, row, to = edges[0, v], x[v], out[v // 2]
        beside = row[1:]
        for u in range(w - 1):
            left[u] = bond[u] * beside[u]
        left[w - 1] = left[w] = np.float32(0.0)
        if v + 1 < h:
            _pull_from_below(edges, x[v + 1], v, left[:w])
        if v == top and v > 0:
            _pull_from_above(edges, x[v - 1], v, left[:w])
        if v % 2 == 0:
            for u in range(len(to)):
                to[u] = np.float32(0.0)
        for u in range(len(to)):
            to[u] += left[2 * u] + left[2 * u + 1]


@njit(cache=True, fastmath=True, error_model="numpy")
def prolong_add_kernel(coarse: Grid, inverse: Grid, x: Grid) -> None:
    """Add to every pixel that has an edge the value of its block."""
    for v in range(len(x)):
        row, to, some = coarse[v // 2], x[v], inverse[v]
        for u in range(len(to)):
            value = row[u // 2]
            to[u] += value if some[u] > np.float32(0.0) else np.float32(0.0)

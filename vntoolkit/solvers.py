"""Weighted graph Laplacians on a pixel grid, solved by conjugate gradients with a multigrid cycle.

The matrix is L = Σ_edges w_ij (e_i − e_j)(e_i − e_j)ᵀ + ground · I over the eight-neighbour edges of a grid.
Edge weights may be zero (pixels outside the mask, cut edges) or negative as long as L stays positive
semidefinite, which the assembly in `geometry/slope_grid.py` guarantees.

Pixels are swept in four colours, by whether row and column are even: no two of one colour share an edge, so
that the compiler does eight at a time. Every image is read once on the way down and once on the way up, in
each row from the first to the last pixel that has an edge. The two halves of a large grid are swept at once,
all but what both touch: the same bytes for any number of threads. On small grids one thread works: two would
meet thousands of times a frame.

A coarser level sums the edges between blocks of 2×2 pixels and halves them: in two dimensions that is the
matrix the coarse grid itself would have. Corrections are interpolated linearly between blocks, less across
an edge that is weaker than the one inside the block, not at all across a cut one. Each pixel's value taken
from its block alone needs half as many cycles more, or two thirds.
"""

from dataclasses import dataclass

import numpy as np
from numba import prange

from vntoolkit.arrays import Float32Array, Int64Array
from vntoolkit.native import njit

_SMALLEST_SIDE = 4
_LAST_SWEEPS = 4  # on the coarsest grid, each way
_LARGE = 40_000  # pixels from which on a grid is swept in two halves
Grid = Float32Array
Row = Float32Array
Places = Int64Array
_GROUND = 1e-6  # pins the free constant of every connected piece; far below any data weight
_WEAK = 0.05  # share of an edge in all edges of its pixel; .03 to .1 need as many cycles
_IMAGES = 5  # of a grid beside its edges: inverse, shares, right-hand side, solution


@dataclass(frozen=True, kw_only=True, eq=False)
class GridHierarchy:
    """Grids, each about half as high and wide as the one before.

    edges: (4, h, w) float32 of the finest grid, to the east, south, south-east and (stored at the upper left
    pixel of the 2×2 block) from the upper right to the lower left pixel, or (2, h, w), without the diagonal
    ones. places: (n, 4), height and width of each grid and where it begins in `flat` and in `spans`. flat:
    1 over the diagonal, 0 where a pixel has no edge; the shares (2, h, w) of the block beside and of the
    block above or below in a pixel's correction; right-hand side; solution; and, of all but the finest, the
    edges. spans: (rows, 2), the first pixel with an edge, even, and the one after the last.
    """

    edges: Grid
    places: Places
    flat: Row
    spans: Places


def grid_hierarchy(edges: Grid) -> GridHierarchy:
    """Build all grids from the finest edges, (4, h, w) or (2, h, w); those that leave the grid are 0."""
    given: Grid = np.ascontiguousarray(edges, np.float32)
    kinds, height, width = given.shape
    places, start, row = [], 0, 0
    while True:
        places.append((height, width, start, row))
        start, row = start + (_IMAGES + (kinds if row else 0)) * height * width, row + height
        if min(height, width) <= _SMALLEST_SIDE:
            break
        height, width = (height + 1) // 2, (width + 1) // 2
    levels = GridHierarchy(
        edges=given,
        places=np.array(places),
        flat=np.empty(start, np.float32),
        spans=np.empty((row, 2), np.int64),
    )
    _build_kernel(levels.edges, levels.places, levels.flat, levels.spans)
    return levels


def solve_grid(
    levels: GridHierarchy, right: Grid, start: Grid, tolerance: float, most_iterations: int
) -> Grid:
    """Solve L x = right from `start` until the residual falls to `tolerance` of the right-hand side.

    right, start: (h, w) float32. Returns (h, w) float32, which after `most_iterations` may be short of the
    tolerance: a Gauss–Newton step need not be solved to the end.
    """
    x: Grid = np.array(start, np.float32, order="C")
    _solve_kernel(
        levels.edges, levels.places, levels.flat, levels.spans, right, tolerance, most_iterations, x
    )
    return x


def multigrid_cycle(levels: GridHierarchy, right: Grid) -> Grid:
    """Approximate the x of L x = right by one symmetric V cycle."""
    x = np.zeros_like(right)
    _cycle_kernel(levels.edges, levels.places, levels.flat, levels.spans, right, x)
    return x


@njit(cache=True, fastmath=True, error_model="numpy")
def _solve_kernel(
    edges: Grid, places: Places, flat: Row, spans: Places, right: Grid, tolerance: float,
    most_iterations: int, x: Grid,
) -> None:  # fmt: skip
    h, w = right.shape
    residual, image, cleaned = np.empty_like(x), np.empty_like(x), np.zeros_like(x)
    direction = np.zeros_like(x)
    apply_kernel(edges, x, residual)
    asked, left = 0.0, 0.0
    for v in range(h):
        for u in range(w):
            rest = right[v, u] - residual[v, u]
            residual[v, u] = rest
            asked += right[v, u] * right[v, u]
            left += rest * rest
    target, previous = tolerance * tolerance * asked, 0.0
    for _ in range(most_iterations):
        if left <= target:
            return
        _cycle_kernel(edges, places, flat, spans, residual, cleaned)
        now = _dot(residual, cleaned)
        if not now > 0.0:
            return
        share = np.float32(now / previous if previous > 0.0 else 0.0)
        previous = now
        for v in range(h):
            to, more = direction[v], cleaned[v]
            for u in range(w):
                to[u] = share * to[u] + more[u]
        apply_kernel(edges, direction, image)
        curvature = _dot(direction, image)
        if not curvature > 0.0:
            return
        step, left = np.float32(now / curvature), 0.0
        for v in range(h):
            to, way, rest, taken = x[v], direction[v], residual[v], image[v]
            for u in range(w):
                to[u] += step * way[u]
                rest[u] -= step * taken[u]
            for u in range(w):
                left += rest[u] * rest[u]


@njit(cache=True, fastmath=True, error_model="numpy")
def _dot(first: Grid, second: Grid) -> float:
    total = 0.0
    for v in range(len(first)):
        one, two = first[v], second[v]
        for u in range(len(one)):
            total += one[u] * two[u]
    return total


@njit(cache=True, error_model="numpy")
def _grid_of(
    finest: Grid, places: Places, flat: Row, spans: Places, i: int
) -> tuple[Grid, Grid, Grid, Grid, Grid, Places]:
    """Return edges, inverse, shares, right-hand side, solution and spans of one grid."""
    h, w, start, row = places[i]
    size, kinds = h * w, len(finest)
    after = start + _IMAGES * size
    return (
        flat[after : after + kinds * size].reshape((kinds, h, w)) if i else finest,
        flat[start : start + size].reshape((h, w)),
        flat[start + size : start + 3 * size].reshape((2, h, w)),
        flat[start + 3 * size : start + 4 * size].reshape((h, w)),
        flat[start + 4 * size : after].reshape((h, w)),
        spans[row : row + h],
    )


@njit(cache=True, fastmath=True, error_model="numpy")
def _cycle_kernel(finest: Grid, places: Places, flat: Row, spans: Places, right: Grid, x: Grid) -> None:
    """Fill x, 0 where its pixels have no edge, with one cycle."""
    last = len(places) - 1
    edges, inverse, shares, _, _, inside = _grid_of(finest, places, flat, spans, 0)
    asked, solution = right, x
    for i in range(last):
        _, _, _, coarse, _, _ = _grid_of(finest, places, flat, spans, i + 1)
        _descend(edges, inverse, shares, inside, asked, solution, coarse)
        edges, inverse, shares, asked, solution, inside = _grid_of(finest, places, flat, spans, i + 1)
    solution[...] = np.float32(0.0)
    for k in range(2 * _LAST_SWEEPS):
        sweep_kernel(edges, inverse, inside, asked, solution, k < _LAST_SWEEPS)
    for k in range(last):
        i = last - 1 - k
        _, _, _, _, correction, _ = _grid_of(finest, places, flat, spans, i + 1)
        edges, inverse, shares, asked, solution, inside = _grid_of(finest, places, flat, spans, i)
        if i == 0:
            asked, solution = right, x
        _ascend(edges, inverse, shares, inside, asked, correction, solution)


# Compiled loops. Edges (4, h, w): see `GridHierarchy`.


@njit(cache=True, fastmath=True, error_model="numpy")
def apply_kernel(edges: Grid, x: Grid, out: Grid) -> None:
    """Fill out with L x."""
    h, w = x.shape
    for v in range(h):
        row, to = x[v], out[v]
        for u in range(w):
            to[u] = np.float32(_GROUND) * row[u]
        _add_difference(edges[0, v, : w - 1], row[: w - 1], row[1:], to[: w - 1])
        _add_difference(edges[0, v, : w - 1], row[1:], row[: w - 1], to[1:])
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


@njit(cache=True, fastmath=True, inline="always", error_model="numpy")
def _add_difference(weight: Row, here: Row, there: Row, out: Row) -> None:
    for u in range(len(weight)):
        out[u] += weight[u] * (here[u] - there[u])


@njit(cache=True, fastmath=True, error_model="numpy")
def _build_kernel(finest: Grid, places: Places, flat: Row, spans: Places) -> None:
    kinds = len(finest)
    for i in range(len(places)):
        edges, inverse, shares, _, solution, inside = _grid_of(finest, places, flat, spans, i)
        if i > 0:
            finer, _, _, _, _, _ = _grid_of(finest, places, flat, spans, i - 1)
            coarse_edges_kernel(finer, edges)
            solution[...] = np.float32(0.0)
        inverse_kernel(edges, inverse)
        _span_kernel(inverse, 2 if kinds == 4 else 0, inside)
        _shares_kernel(edges, inverse, inside, shares)


@njit(cache=True, error_model="numpy")
def _span_kernel(inverse: Grid, rim: int, out: Places) -> None:
    """Fill the spans, with a rim: diagonal edges lead a pixel further than the row's own span."""
    h, w = inverse.shape
    for v in range(h):
        row, first, last = inverse[v], 0, w
        while last > 0 and row[last - 1] == np.float32(0.0):
            last -= 1
        while first < last and row[first] == np.float32(0.0):
            first += 1
        rim_here = rim if first < last else 0
        out[v, 0] = max(first - first % 2 - rim_here, 0)
        out[v, 1] = min(last + last % 2 + rim_here, w)


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
def coarse_edges_kernel(edges: Grid, out: Grid) -> None:
    """Fill out with half the sum of the edges between blocks of 2×2 pixels; those inside one drop out."""
    kinds, h, w = edges.shape
    half, zero = np.float32(0.5), np.float32(0.0)
    for b in range(out.shape[1]):
        upper, has_lower = 2 * b, 2 * b + 1 < h
        lower = 2 * b + 1 if has_lower else upper
        for kind in range(kinds):
            out[kind, b, :] = zero
        pairs = w // 2
        east, south, above, below = out[0, b], out[1, b], edges[0, upper], edges[0, lower]
        part = half if has_lower else zero
        for a in range(pairs):
            east[a] = half * above[2 * a + 1] + part * below[2 * a + 1]
        if kinds == 4:
            down, back = edges[2, upper], edges[3, upper]
            for a in range(pairs):
                east[a] += half * (down[2 * a + 1] + back[2 * a + 1])
        if not has_lower:
            continue
        below = edges[1, lower]
        for a in range(pairs):
            south[a] = half * (below[2 * a] + below[2 * a + 1])
        if w % 2:
            south[pairs] = half * below[w - 1]
        if kinds == 4:
            down, back, first, second = edges[2, lower], edges[3, lower], out[2, b], out[3, b]
            for a in range(pairs):
                south[a] += half * (down[2 * a] + back[2 * a])
                first[a], second[a] = half * down[2 * a + 1], half * back[2 * a + 1]


@njit(cache=True, fastmath=True, error_model="numpy")
def _shares_kernel(edges: Grid, inverse: Grid, spans: Places, out: Grid) -> None:
    """Fill out (2, h, w): a quarter where all edges are alike, as between the centres of two blocks.

    Less where the edge to the other block is weak among all edges of its pixel. That block may be almost
    free. Then its correction is large, and pixels that take it over make it larger on every finer grid.
    """
    _, h, w = edges.shape
    zero, one, three, tiny = np.float32(0.0), np.float32(1.0), np.float32(3.0), np.float32(1e-30)
    east, weak = np.empty(w + 1, np.float32), np.empty(w, np.float32)
    for v in range(h):
        a, b = spans[v]
        if a == b:
            continue
        weights, beside, above, rest = edges[0, v, a:b], out[0, v, a:b], out[1, v, a:b], weak[: b - a]
        for u in range(b - a):
            east[u + 1] = max(weights[u], zero)
            rest[u] = np.float32(_WEAK) / max(inverse[v, a + u], tiny)
        east[0] = east[b - a] = zero  # nothing is beyond the span
        west, own = east[: b - a], east[1:]
        for u in range(b - a):
            is_odd = u & 1
            outer, within = (own[u] if is_odd else west[u]), (west[u] if is_odd else own[u])
            beside[u] = outer / (outer + three * within + rest[u])
        outwards, inwards = (v, v - 1) if v % 2 else (v - 1, v)
        if 0 <= outwards < h - 1:
            outer_weights, inner_weights = edges[1, outwards, a:b], edges[1, inwards, a:b]
            for u in range(b - a):
                outer, within = max(outer_weights[u], zero), max(inner_weights[u], zero)
                above[u] = outer / (outer + three * within + rest[u])
        else:
            above[:] = zero
        for u in range(b - a):
            over = one / max(beside[u] + above[u], one)
            beside[u] *= over
            above[u] *= over


@njit(cache=True, fastmath=True, error_model="numpy")
def _gather_rows(edges: Grid, x: Grid, v: int, a: int, b: int, out: Row) -> None:
    """Add to out (b - a,) what the rows above and below give the pixels from a to b of row v."""
    w = b - a
    if v + 1 < len(x):
        below, down = x[v + 1, a:b], edges[1, v, a:b]
        for u in range(w):
            out[u] += down[u] * below[u]
        if len(edges) == 4:
            east, west, ahead, beside = edges[2, v, a:b], edges[3, v, a:b], below[1:], out[1:]
            for u in range(w - 1):
                out[u] += east[u] * ahead[u]
            for u in range(w - 1):
                beside[u] += west[u] * below[u]
    if v > 0:
        above, up = x[v - 1, a:b], edges[1, v - 1, a:b]
        for u in range(w):
            out[u] += up[u] * above[u]
        if len(edges) == 4:
            west, east, ahead, beside = edges[2, v - 1, a:b], edges[3, v - 1, a:b], above[1:], out[1:]
            for u in range(w - 1):
                beside[u] += west[u] * above[u]
            for u in range(w - 1):
                out[u] += east[u] * ahead[u]


@njit(cache=True, fastmath=True, error_model="numpy")
def _neighbour_sums(weights: Row, row: Row, out: Row) -> None:
    """Fill out (w,) with the weighted sum of each pixel's neighbours in its row."""
    last = len(row) - 1
    if last < 1:
        out[:] = np.float32(0.0)
        return
    inner, west, ahead, own = out[1:last], weights, row[2:], weights[1:]
    out[0], out[last] = weights[0] * row[1], weights[last - 1] * row[last - 1]
    for u in range(last - 1):
        inner[u] = own[u] * ahead[u] + west[u] * row[u]


@njit(cache=True, fastmath=True, error_model="numpy")
def _solve_row(
    edges: Grid, inverse: Grid, spans: Places, right: Grid, x: Grid, v: int, first: int, known: Row, sums: Row
) -> None:
    """Solve the pixels of one row whose column is even (first = 0) or odd (1), then the others."""
    a, b = spans[v]
    row, scale, asked, weights = x[v, a:b], inverse[v, a:b], right[v, a:b], edges[0, v, a:b]
    for u in range(len(row)):
        known[u] = asked[u]
    _gather_rows(edges, x, v, a, b, known[: b - a])
    for k in range(2):
        parity = first ^ k
        _neighbour_sums(weights, row, sums[: b - a])
        for u in range(len(row)):
            row[u] = (known[u] + sums[u]) * scale[u] if (u & 1) == parity else row[u]


@njit(cache=True, fastmath=True, error_model="numpy")
def sweep_kernel(edges: Grid, inverse: Grid, spans: Places, right: Grid, x: Grid, forward: bool) -> None:
    """One Gauss–Seidel sweep over the four colours; backward, the reverse of that."""
    h, w = x.shape
    known, sums = np.empty(w, np.float32), np.empty(w, np.float32)
    for k in range(2):
        for v in range(k if forward else 1 - k, h, 2):
            _solve_row(edges, inverse, spans, right, x, v, 0 if forward else 1, known, sums)


@njit(cache=True, fastmath=True, error_model="numpy")
def _descend(
    edges: Grid, inverse: Grid, shares: Grid, spans: Places, right: Grid, x: Grid, coarse: Grid
) -> None:
    """Fill x with the forward sweep from 0, and coarse with what is left, by the transpose of `_ascend`."""
    h, w = x.shape
    middle, scratch = _middle(h, w), _scratch(w)
    coarse[...] = np.float32(0.0)
    if middle:
        _first_row(edges, inverse, spans, right, x, middle, scratch[0], scratch[1])
        _two_descents(edges, inverse, shares, spans, right, x, middle, coarse)
        for v in range(middle - 1, middle + 1):
            _restrict_row(edges, shares, spans, x, v, coarse, scratch)
    else:
        _descend_rows(edges, inverse, shares, spans, right, x, np.int64(0), h, coarse)


@njit(cache=True, error_model="numpy")
def _middle(h: int, w: int) -> int:
    """Return the even row where the lower half begins; 0 where a grid is swept in one."""
    return 2 * (h // 4) if h * w >= _LARGE else 0


@njit(cache=True, error_model="numpy")
def _scratch(w: int) -> Grid:
    return np.empty((5, w + 5), np.float32)


@njit(cache=True, fastmath=True, error_model="numpy", parallel=True)
def _two_descents(
    edges: Grid, inverse: Grid, shares: Grid, spans: Places, right: Grid, x: Grid, middle: int, coarse: Grid
) -> None:
    for half in prange(2):
        end = middle if half == 0 else len(x)
        _descend_rows(edges, inverse, shares, spans, right, x, half * middle, end, coarse)


@njit(cache=True, fastmath=True, error_model="numpy")
def _descend_rows(
    edges: Grid, inverse: Grid, shares: Grid, spans: Places, right: Grid, x: Grid, top: int, end: int,
    coarse: Grid,
) -> None:  # fmt: skip
    """`_descend` from row top, solved before where that is not 0, to end; what both halves touch is left."""
    h, w = x.shape
    scratch = _scratch(w)
    known, sums = scratch[0], scratch[1]
    for v in range(top, end + 3, 2):
        if v < end and (v > top or top == 0):
            _first_row(edges, inverse, spans, right, x, v, known, sums)
        if top < v <= end:
            _first_row(edges, inverse, spans, right, x, v - 1, known, sums)
        for i in range(max(v - 2, top), min(v, end)):
            if (i > top or top == 0) and (i < end - 1 or end == h):
                _restrict_row(edges, shares, spans, x, i, coarse, scratch)


@njit(cache=True, fastmath=True, error_model="numpy")
def _first_row(
    edges: Grid, inverse: Grid, spans: Places, right: Grid, x: Grid, v: int, known: Row, sums: Row
) -> None:
    """`_solve_row` forward from 0, where even rows come first."""
    a, b = spans[v]
    row, scale, asked, weights = x[v, a:b], inverse[v, a:b], right[v, a:b], edges[0, v, a:b]
    for u in range(len(row)):
        known[u] = asked[u]
    if v % 2:
        _gather_rows(edges, x, v, a, b, known[: b - a])
    for u in range(len(row)):
        row[u] = known[u] * scale[u]
    _neighbour_sums(weights, row, sums[: b - a])
    for u in range(len(row)):
        row[u] += sums[u] * scale[u] if u & 1 else np.float32(0.0)


@njit(cache=True, fastmath=True, error_model="numpy")
def _restrict_row(
    edges: Grid, shares: Grid, spans: Places, x: Grid, v: int, coarse: Grid, scratch: Grid
) -> None:
    """Add what `_first_row` leaves in one row to the blocks that its corrections come from."""
    a, b = spans[v]
    left, own, beside, first = scratch[1, : b - a], scratch[2], scratch[3], a // 2
    side, along = shares[0, v, a:b], shares[1, v, a:b]
    _neighbour_sums(edges[0, v, a:b], x[v, a:b], left)
    for u in range(len(left)):
        left[u] = np.float32(0.0) if u & 1 else left[u]
    if v % 2 == 0:
        _gather_rows(edges, x, v, a, b, left)
    block, count, one = v // 2, (len(left) + 1) // 2, np.float32(1.0)
    other = block + 1 if v % 2 else block - 1
    to, before, middle, after = coarse[block, first : first + count], beside[1:], beside[2:], beside[4:]
    own[2 * count - 1 : 2 * count] = np.float32(0.0)  # beside the last pixel of an odd row
    beside[:2], beside[len(left) + 2 : len(left) + 5] = np.float32(0.0), np.float32(0.0)
    for u in range(len(left)):
        own[u] = left[u] * (one - side[u] - along[u])
        middle[u] = left[u] * side[u]
    for u in range(count):
        to[u] += (own[2 * u] + own[2 * u + 1]) + (before[2 * u] + after[2 * u])
    if 0 <= other < len(coarse):
        to = coarse[other, first : first + count]
        for u in range(len(left)):
            own[u] = left[u] * along[u]
        for u in range(count):
            to[u] += own[2 * u] + own[2 * u + 1]


@njit(cache=True, fastmath=True, error_model="numpy")
def _ascend(
    edges: Grid, inverse: Grid, shares: Grid, spans: Places, right: Grid, coarse: Grid, x: Grid
) -> None:
    """Add the coarser grid's correction to x, and sweep back: the transpose of `_descend`."""
    h, w = x.shape
    middle, scratch = _middle(h, w), _scratch(w)
    if middle:
        _prolong_row(coarse, shares, spans, middle, scratch, x)
        _two_ascents(edges, inverse, shares, spans, right, coarse, middle, x)
        _solve_row(edges, inverse, spans, right, x, middle, 1, scratch[0], scratch[1])
    else:
        _ascend_rows(edges, inverse, shares, spans, right, coarse, np.int64(0), h, x)


@njit(cache=True, fastmath=True, error_model="numpy", parallel=True)
def _two_ascents(
    edges: Grid, inverse: Grid, shares: Grid, spans: Places, right: Grid, coarse: Grid, middle: int, x: Grid
) -> None:
    for half in prange(2):
        end = middle if half == 0 else len(x)
        _ascend_rows(edges, inverse, shares, spans, right, coarse, half * middle, end, x)


@njit(cache=True, fastmath=True, error_model="numpy")
def _ascend_rows(
    edges: Grid, inverse: Grid, shares: Grid, spans: Places, right: Grid, coarse: Grid, top: int, end: int,
    x: Grid,
) -> None:  # fmt: skip
    """`_ascend` from row top, corrected already and solved later where it is not 0, to row end."""
    scratch = _scratch(x.shape[1])
    if top == 0:
        _prolong_row(coarse, shares, spans, 0, scratch, x)
    for v in range(top + 1, end + 1, 2):
        for i in range(v, min(v + 2, end)):
            _prolong_row(coarse, shares, spans, i, scratch, x)
        if v < end:
            _solve_row(edges, inverse, spans, right, x, v, 1, scratch[0], scratch[1])
        if v - 1 > top or top == 0:
            _solve_row(edges, inverse, spans, right, x, v - 1, 1, scratch[0], scratch[1])


@njit(cache=True, fastmath=True, error_model="numpy")
def _prolong_row(coarse: Grid, shares: Grid, spans: Places, v: int, scratch: Grid, x: Grid) -> None:
    a, b = spans[v]
    own, beside, other = scratch[2], scratch[3], scratch[4]
    if a == b:
        return
    block, first, end = v // 2, a // 2, (b + 1) // 2
    line, row, side, along = coarse[block, first:end], x[v, a:b], shares[0, v, a:b], shares[1, v, a:b]
    near = coarse[min(max(block + 1 if v % 2 else block - 1, 0), len(coarse) - 1), first:end]
    last, inner, after = len(line) - 1, beside[2:], line[2:]
    for u in range(len(line)):
        own[2 * u] = own[2 * u + 1] = line[u]
    beside[0], beside[1] = line[0], line[min(1, last)]
    for u in range(last - 1):
        inner[2 * u], inner[2 * u + 1] = line[u], after[u]
    if last > 0:
        beside[2 * last] = beside[2 * last + 1] = line[last - 1]  # the share of what is beyond is 0
    for u in range(len(row)):
        other[u] = near[u // 2]
    for u in range(len(row)):
        here = own[u]
        row[u] += here + side[u] * (beside[u] - here) + along[u] * (other[u] - here)

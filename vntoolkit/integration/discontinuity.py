"""Integration with depth discontinuities: robust, one-sided, iteratively reweighted least squares.

Cao et al. (`cao2022`) showed that normals alone tell where depth is discontinuous if, at every pixel, the
solution may choose which neighbour it continues to; they reweigh a pixel's two one-sided equations against
each other by the residuals. This module keeps the idea, an iteratively reweighted least squares whose
weights cut edges, and changes four things, each of which lowers the error on real objects:

- an edge's wanted difference is the chord (`chords_from_normals`), free of bias at grazing normals;
- an edge is judged by its own residual against what the noise of the normals explains (Geman and
  McClure's weight, annealed from a wide scale to a narrow one), and that noise is measured on the map, as
  the circulation of the wanted differences around 2×2 pixels, which is 0 on a surface without noise;
- an edge is doubted beforehand as far as the circulation on both its sides is more than noise;
- the judgement is one-sided: where one surface hides another, depth falls **further** along the slope than
  the normals say, never less, so a residual the other way cuts only when it is far larger.

The weights differ by many orders of magnitude between neighbours, along curves that no grid of squares can
follow. So the linear systems are solved by conjugate gradients preconditioned by algebraic multigrid: nodes
are merged along their strongest edges, pairwise, twice per level (Notay 2010, `notay2010`), so that no coarse
node reaches across a cut. The coarse problems are solved by the K-cycle, which makes plain aggregation
converge at a rate that does not depend on the size. All levels live in one index space: level l owns the
nodes first[l] … first[l+1].
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import Float64Array, FloatArray, Int32Array, Mask, Weight
from vntoolkit.errors import SolverFailed
from vntoolkit.integration.edges import ChordField, PixelGraph, divergence_on_graph
from vntoolkit.native import njit

_LEAST_WEIGHT = 1e-9  # of a fully cut edge: keeps parts that only cuts connect from floating freely
_LEAST_NOISE = 1e-4  # pixels: rounding of float32 normals; a noiseless map has no other scale
_MEDIAN_TO_DEVIATION = 1.4826

# The reweighting. Scales are in units of `Evidence.noise`.
_ROUNDS = 15  # times the weights are computed anew
_WIDEST_SCALE = 12.0  # of the first round: nothing is cut that a smooth surface might still explain
_NARROWEST_SCALE, _NARROWEST_SCALE_NOISY = 0.5, 4.0  # of the last: clean normals; noisy ones, whose residuals
# are noise where depth is continuous
_NOISY_PX = 0.02  # `Evidence.noise` of a noisy map; that of normals off by 1.6 degrees
_CONTRADICTION = 40.0  # factor on the scale where depth falls less than the slope, as no occlusion makes it
_STEEP_SLOPE = 0.3  # pixels per pixel from which the side of an occlusion is known
_CIRCULATION = 0.05  # share of the squared circulation around an edge's better square that is its variance
_FIRST_TOLERANCE, _ROUND_TOLERANCE = (
    1e-3,
    0.03,
)  # relative residual of the first linear solve; what every later
# one leaves of the residual before it, so that a part that hangs on few edges finds its place too

# The linear solver.
_COARSEST = 60  # nodes that a dense inverse takes without being noticed
_MOST_LEVELS = 12
_LARGEST_GROUP = 4
_STRONG = 0.1  # an edge weaker than this share of a node's strongest does not merge it
_DESCEND, _CORRECTED_ONCE, _CORRECTED_TWICE = 0, 1, 2
_GOOD_ENOUGH = 0.0625  # squared residual share after one coarse step that spares the second


def solve_discontinuous(
    graph: PixelGraph,
    difference: Float64Array,
    evidence: "Evidence",
    confidence: Float64Array,
    *,
    start: Float64Array | None,
    most_iterations: int,
) -> Float64Array:
    """Return depth in pixels per node (n,), arbitrary offset per component.

    difference: (m,) wanted, pixels. confidence: (m,) weight per edge from 0 to 1. start: a first guess (n,).
    """
    trust = confidence / evidence.variance
    depth = np.zeros(len(graph.pixels)) if start is None else start
    weight = trust
    noisiness = min(1.0, (evidence.noise / _NOISY_PX) ** 2)
    narrowest = _NARROWEST_SCALE + noisiness * (_NARROWEST_SCALE_NOISY - _NARROWEST_SCALE)
    widest = max(_WIDEST_SCALE, narrowest)
    for this_round in range(_ROUNDS + 1):
        hierarchy = hierarchy_from_graph(graph.row_start, graph.neighbour, weight[graph.edge])
        missing = difference - (depth[graph.head] - depth[graph.tail])
        correction, _ = solve_laplacian(
            hierarchy,
            divergence_on_graph(graph, weight, missing),
            np.zeros(len(depth)),
            tolerance=_FIRST_TOLERANCE if this_round == 0 else _ROUND_TOLERANCE,
            most_iterations=most_iterations,
        )
        depth = depth + correction
        progress = min(1.0, this_round / max(1.0, 0.7 * _ROUNDS))
        scale = evidence.noise * widest * (narrowest / widest) ** progress
        weight = _reweighted(depth, graph.tail, graph.head, difference, evidence.variance, trust, scale)
    return depth


@njit(cache=True)
def _reweighted(depth, tail, head, wanted, variance, trust, scale):  # type: ignore[no-untyped-def]
    weight = np.empty(len(tail))
    for e in range(len(tail)):
        residual = depth[head[e]] - depth[tail[e]] - wanted[e]
        tolerated = scale * scale * variance[e]
        if abs(wanted[e]) > _STEEP_SLOPE and residual * wanted[e] < 0.0:
            tolerated *= _CONTRADICTION * _CONTRADICTION
        share = 1.0 / (1.0 + residual * residual / tolerated)
        weight[e] = trust[e] * max(share * share, _LEAST_WEIGHT)
    return weight


@dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """Noise and inconsistency measured in the wanted differences themselves.

    noise: standard deviation in pixels of the difference along an edge between facing normals, which is
    that of their slopes over √2. variance: (m,) of every edge, in units of noise²: that of the normals plus
    the circulation that no surface can explain.
    """

    noise: float
    variance: Float64Array


def evidence_from_chords(graph: PixelGraph, chords: ChordField, domain: Mask) -> Evidence:
    """Measure the noise of the map, and find the edges with inconsistent circulation.

    The differences around 2×2 pixels sum to zero on a surface. Their typical sum gives the noise. Where depth
    jumps by an amount that changes along the way the sum is large on both sides of every edge that crosses
    the jump, but only on one side of an edge beside it: an edge is as bad as the better of its two squares.
    """
    right, down = np.full((2, *domain.shape), np.nan), np.full((2, *domain.shape), np.nan)
    for k, values in enumerate((chords.difference, chords.variance)):
        right[k].ravel()[graph.pixels[graph.tail[: graph.across]]] = values[: graph.across]
        down[k].ravel()[graph.pixels[graph.tail[graph.across :]]] = values[graph.across :]
    turn = right[0, :-1, :-1] + down[0, :-1, 1:] - right[0, 1:, :-1] - down[0, :-1, :-1]
    spread = right[1, :-1, :-1] + down[1, :-1, 1:] + right[1, 1:, :-1] + down[1, :-1, :-1]
    normalised = np.abs(turn / np.sqrt(spread))
    normalised = normalised[np.isfinite(normalised)]
    noise = _LEAST_NOISE
    if normalised.size:
        noise = max(noise, _MEDIAN_TO_DEVIATION * float(np.median(normalised)))
    square = np.pad(np.where(np.isfinite(turn), turn * turn, np.inf), 1, constant_values=np.inf)
    across = np.minimum(square[:-1, 1:], square[1:, 1:])  # of the edge to the right of each pixel
    along = np.minimum(square[1:, :-1], square[1:, 1:])
    excess = np.concatenate(
        [
            across.ravel()[graph.pixels[graph.tail[: graph.across]]],
            along.ravel()[graph.pixels[graph.tail[graph.across :]]],
        ]
    )
    excess = np.where(np.isfinite(excess), excess, 0.0) * _CIRCULATION / noise**2
    return Evidence(noise=noise, variance=chords.variance + excess)


def confidence_of_edges(graph: PixelGraph, weight: Weight | None) -> Float64Array:
    """Weight per edge (m,): that of its worse end; 1 without a weight."""
    if weight is None:
        return np.ones(len(graph.tail))
    per_node: FloatArray = weight.ravel()[graph.pixels].astype(np.float64)
    return np.minimum(per_node[graph.tail], per_node[graph.head])


# Weighted Laplacians of any graph, and their coarser levels.


@dataclass(frozen=True, kw_only=True, eq=False)
class Hierarchy:
    """Laplacians of all levels. diagonal (n,), parent (n,) global index on the next level or -1."""

    first: Int32Array
    row_start: Int32Array
    neighbour: Int32Array
    weight: Float64Array
    diagonal: Float64Array
    parent: Int32Array
    coarsest_inverse: Float64Array


def hierarchy_from_graph(row_start: Int32Array, neighbour: Int32Array, weight: Float64Array) -> Hierarchy:
    """Coarsen the graph Laplacian with adjacency (row_start, neighbour) and slot weights > 0."""
    graphs, parents = [(row_start, neighbour, weight)], []
    while len(graphs[-1][0]) - 1 > _COARSEST and len(graphs) < _MOST_LEVELS:
        once, *graph = _merge_pairs(*graphs[-1])
        twice, *graph = _merge_pairs(*graph)
        if len(graph[0]) > 0.8 * len(graphs[-1][0]):
            break  # what is left are islands: the smoother alone deals with them
        graphs.append((graph[0], graph[1], graph[2]))
        parents.append(twice[once])
    return _join(graphs, parents)


def _join(graphs: list[tuple[Int32Array, Int32Array, Float64Array]], parents: list[Int32Array]) -> Hierarchy:
    """Put all levels into one index space."""
    first = np.cumsum([0] + [len(g[0]) - 1 for g in graphs]).astype(np.int32)
    slots = np.cumsum([0] + [len(g[1]) for g in graphs])
    row_start = [g[0][:-1] + s for g, s in zip(graphs, slots[:-1], strict=True)]
    row_start.append(slots[-1:])
    rows = np.concatenate(row_start).astype(np.int32)
    neighbour = np.concatenate([g[1] + f for g, f in zip(graphs, first[:-1], strict=True)]).astype(np.int32)
    weight = np.concatenate([g[2] for g in graphs])
    last = np.full(first[-1] - first[-2], -1, dtype=np.int32)
    parent = [p + f for p, f in zip(parents, first[1:-1], strict=True)]
    diagonal = _row_sums(rows, weight)
    return Hierarchy(
        first=first,
        row_start=rows,
        neighbour=neighbour,
        weight=weight,
        diagonal=diagonal,
        parent=np.concatenate([*parent, last]).astype(np.int32),
        coarsest_inverse=_dense_inverse(first[-2], first[-1], rows, neighbour, weight, diagonal),
    )


def _dense_inverse(
    begin: int,
    end: int,
    row_start: Int32Array,
    neighbour: Int32Array,
    weight: Float64Array,
    diagonal: Float64Array,
) -> Float64Array:
    """Inverse of the coarsest Laplacian with one node of each component held at 0; empty if it is large."""
    count = end - begin
    if count > 4 * _COARSEST:
        return np.zeros((0, 0))
    slots = slice(row_start[begin], row_start[end])
    rows = np.repeat(np.arange(count), np.diff(row_start[begin : end + 1]))
    dense = np.diag(diagonal[begin:end])
    dense[rows, neighbour[slots] - begin] -= weight[slots]
    _, component = connected_components(dense != 0.0, directed=False)
    _, held = np.unique(component, return_index=True)
    dense[held, :] = 0.0
    dense[:, held] = 0.0
    dense[held, held] = 1.0
    inverse = np.asarray(np.linalg.inv(dense), dtype=np.float64)
    inverse[held, held] = 0.0
    return inverse


def solve_laplacian(
    hierarchy: Hierarchy, load: Float64Array, start: Float64Array, *, tolerance: float, most_iterations: int
) -> tuple[Float64Array, int]:
    """Solve L x = load from `start`; return x (n,), free per component, and the number of iterations.

    tolerance: of the residual's energy norm relative to the load's. Raises `SolverFailed` if the iterations
    do not suffice.
    """
    levels = (
        hierarchy.first,
        hierarchy.row_start,
        hierarchy.neighbour,
        hierarchy.weight,
        hierarchy.diagonal,
        hierarchy.parent,
        hierarchy.coarsest_inverse,
    )
    x, iterations, residual = flexible_conjugate_gradients(levels, load, start, tolerance, most_iterations)
    if residual > tolerance:
        raise SolverFailed(
            f"the linear solver reached a relative residual of {residual:.1e}, not {tolerance:.1e}, in "
            f"{most_iterations} iterations: raise most_iterations or tolerance"
        )
    return x, iterations


@njit(cache=True)
def _row_sums(row_start, weight):  # type: ignore[no-untyped-def]
    sums = np.empty(len(row_start) - 1)
    for i in range(len(sums)):
        total = 0.0
        for slot in range(row_start[i], row_start[i + 1]):
            total += weight[slot]
        sums[i] = total if total > 0.0 else 1.0  # an island has the equation 1 x = 0
    return sums


@njit(cache=True)
def _merge_pairs(row_start, neighbour, weight):  # type: ignore[no-untyped-def]
    """Merge nodes along their strongest edges, leftovers in small groups; return map (n,), coarse graph."""
    count = len(row_start) - 1
    parent = np.full(count, -1, np.int32)
    following = np.full(count, -1, np.int32)  # chains the members of a group
    leader = np.empty(count, np.int32)
    size = np.zeros(count, np.int32)
    coarse = 0
    for i in range(count):
        if parent[i] >= 0:
            continue
        strongest, free, chosen, best, group = 0.0, 0.0, -1, 0.0, -1
        for slot in range(row_start[i], row_start[i + 1]):
            j, w = neighbour[slot], weight[slot]
            strongest = max(strongest, w)
            if parent[j] < 0:
                if w > free:
                    free, chosen = w, j
            elif w > best and size[parent[j]] < _LARGEST_GROUP:
                best, group = w, parent[j]
        if free < _STRONG * strongest and best >= _STRONG * strongest and group >= 0:
            parent[i] = group
            following[i] = leader[group]
            leader[group] = i
            size[group] += 1
            continue
        parent[i], leader[coarse], size[coarse] = coarse, i, 1
        if chosen >= 0 and free >= _STRONG * strongest:
            parent[chosen], following[i], size[coarse] = coarse, chosen, 2
        coarse += 1
    return (parent, *_collapse(row_start, neighbour, weight, parent, following, leader, coarse))


@njit(cache=True)
def _collapse(row_start, neighbour, weight, parent, following, leader, coarse):  # type: ignore[no-untyped-def]
    """Sum the edges between groups into the graph of the groups."""
    starts = np.zeros(coarse + 1, np.int32)
    neighbours = np.empty(len(neighbour), np.int32)
    weights = np.empty(len(neighbour))
    seen = np.full(coarse, -1, np.int32)
    used = 0
    for c in range(coarse):
        begin = used
        i = leader[c]
        while i >= 0:
            for slot in range(row_start[i], row_start[i + 1]):
                other = parent[neighbour[slot]]
                if other == c:
                    continue
                if seen[other] >= begin:
                    weights[seen[other]] += weight[slot]
                else:
                    seen[other] = used
                    neighbours[used] = other
                    weights[used] = weight[slot]
                    used += 1
            i = following[i]
        starts[c + 1] = used
    return starts, neighbours[:used].copy(), weights[:used].copy()


# The compiled K-cycle of the hierarchy, and the conjugate gradients that it preconditions.


@njit(cache=True, fastmath=True)
def _multiply(levels, begin, end, x, out):  # type: ignore[no-untyped-def]
    _, row_start, neighbour, weight, diagonal, _, _ = levels
    for i in range(begin, end):
        total = diagonal[i] * x[i]
        for slot in range(row_start[i], row_start[i + 1]):
            total -= weight[slot] * x[neighbour[slot]]
        out[i] = total


@njit(cache=True, fastmath=True)
def _smooth_forward(levels, begin, end, b, x):  # type: ignore[no-untyped-def]
    """Gauss-Seidel from zero: later neighbours are still 0."""
    _, row_start, neighbour, weight, diagonal, _, _ = levels
    for i in range(begin, end):
        total = b[i]
        for slot in range(row_start[i], row_start[i + 1]):
            if neighbour[slot] < i:
                total += weight[slot] * x[neighbour[slot]]
        x[i] = total / diagonal[i]


@njit(cache=True, fastmath=True)
def _smooth_backward(levels, begin, end, b, x):  # type: ignore[no-untyped-def]
    _, row_start, neighbour, weight, diagonal, _, _ = levels
    for i in range(end - 1, begin - 1, -1):
        total = b[i]
        for slot in range(row_start[i], row_start[i + 1]):
            total += weight[slot] * x[neighbour[slot]]
        x[i] = total / diagonal[i]


@njit(cache=True, fastmath=True)
def _restrict_residual(levels, level, b, x):  # type: ignore[no-untyped-def]
    """Sum the residual of a level into the load of the next."""
    first, row_start, neighbour, weight, diagonal, parent, _ = levels
    b[first[level + 1] : first[level + 2]] = 0.0
    for i in range(first[level], first[level + 1]):
        total = b[i] - diagonal[i] * x[i]
        for slot in range(row_start[i], row_start[i + 1]):
            total += weight[slot] * x[neighbour[slot]]
        b[parent[i]] += total


@njit(cache=True, fastmath=True)
def _solve_coarsest(levels, begin, end, b, x):  # type: ignore[no-untyped-def]
    inverse = levels[6]
    for i in range(end - begin):
        total = 0.0
        for j in range(end - begin):
            total += inverse[i, j] * b[begin + j]
        x[begin + i] = total


@njit(cache=True, fastmath=True)
def _first_step(levels, low, high, b, x, kept, kept_product):  # type: ignore[no-untyped-def]
    """Best multiple of the first correction; return (rho, step) and whether a second one is worth it."""
    _multiply(levels, low, high, x, kept_product)
    rho, alpha, size, left = 0.0, 0.0, 0.0, 0.0
    for i in range(low, high):
        kept[i] = x[i]
        rho += x[i] * kept_product[i]
        alpha += x[i] * b[i]
        size += b[i] * b[i]
    if rho <= 0.0:
        return 1.0, 0.0, False
    step = alpha / rho
    for i in range(low, high):
        b[i] -= step * kept_product[i]
        left += b[i] * b[i]
        x[i] *= step
    return rho, step, left > _GOOD_ENOUGH * size


@njit(cache=True, fastmath=True)
def _second_step(levels, low, high, rho, step, b, x, kept, kept_product, work):  # type: ignore[no-untyped-def]
    """Best combination of both corrections (two steps of flexible conjugate gradients)."""
    _multiply(levels, low, high, x, work)
    gamma, beta, alpha = 0.0, 0.0, 0.0
    for i in range(low, high):
        gamma += x[i] * kept_product[i]
        beta += x[i] * work[i]
        alpha += x[i] * b[i]
    rest = beta - gamma * gamma / rho
    second = alpha / rest if rest > 1e-12 * beta else 0.0
    for i in range(low, high):
        x[i] = (step - gamma * second / rho) * kept[i] + second * x[i]


@njit(cache=True, fastmath=True)
def _finish(levels, level, b, x):  # type: ignore[no-untyped-def]
    """Add the coarse correction to a level and smooth it."""
    first, parent = levels[0], levels[5]
    for i in range(first[level], first[level + 1]):
        x[i] += x[parent[i]]
    _smooth_backward(levels, first[level], first[level + 1], b, x)


@njit(cache=True, fastmath=True)
def _cycle(levels, b, x, kept, kept_product, work, state, rho, step):  # type: ignore[no-untyped-def]
    """One K-cycle from the finest level: x = approximate solution with load b."""
    first, inverse = levels[0], levels[6]
    last = len(first) - 2
    level = 0
    state[0] = _DESCEND
    while level >= 0:
        begin, end = first[level], first[level + 1]
        if level == last:
            if len(inverse) > 0:
                _solve_coarsest(levels, begin, end, b, x)
            else:
                _smooth_forward(levels, begin, end, b, x)
                _smooth_backward(levels, begin, end, b, x)
            level -= 1
        elif state[level] == _DESCEND:
            _smooth_forward(levels, begin, end, b, x)
            _restrict_residual(levels, level, b, x)
            state[level] = _CORRECTED_ONCE
            level += 1
            state[level] = _DESCEND
        else:
            again = False
            low, high = end, first[level + 2]
            if state[level] == _CORRECTED_TWICE:
                _second_step(levels, low, high, rho[level], step[level], b, x, kept, kept_product, work)
            elif level + 1 < last:
                rho[level], step[level], again = _first_step(levels, low, high, b, x, kept, kept_product)
            if again:
                state[level] = _CORRECTED_TWICE
                level += 1
                state[level] = _DESCEND
            else:
                _finish(levels, level, b, x)
                level -= 1


@njit(cache=True, fastmath=True)
def _dot(a, b, count):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(count):
        total += a[i] * b[i]
    return total


@njit(cache=True, fastmath=True)
def flexible_conjugate_gradients(levels, load, start, tolerance, most):  # type: ignore[no-untyped-def]
    """Solve L x = load; return x, the number of iterations and the relative residual reached."""
    first = levels[0]
    count, total, depth = first[1], first[-1], len(first)
    b, x = np.empty(total), np.empty(total)
    kept, kept_product, work = np.empty(total), np.empty(total), np.empty(total)
    state, rho, step = np.zeros(depth, np.int64), np.ones(depth), np.zeros(depth)
    solution, residual = start.copy(), np.empty(count)
    direction, product = np.zeros(count), np.zeros(count)
    b[:count] = load
    _cycle(levels, b, x, kept, kept_product, work, state, rho, step)
    scale = _dot(load, x, count)
    if scale <= 0.0:  # nothing is asked for, whatever the start
        return np.zeros(count), 0, 0.0
    _multiply(levels, 0, count, solution, product)
    started = False
    for i in range(count):
        residual[i] = load[i] - product[i]
        product[i] = 0.0
        started |= solution[i] != 0.0
    curvature, relative = 1.0, np.inf
    for iteration in range(most + 1):
        if iteration > 0 or started:  # else x is still that of the load
            b[:count] = residual
            _cycle(levels, b, x, kept, kept_product, work, state, rho, step)
        relative = np.sqrt(max(_dot(residual, x, count), 0.0) / scale)
        if relative <= tolerance:
            return solution, iteration, relative
        # made conjugate to the last direction explicitly: the cycle is not a fixed linear operator
        factor = -_dot(product, x, count) / curvature
        for i in range(count):
            direction[i] = x[i] + factor * direction[i]
        _multiply(levels, 0, count, direction, product)
        curvature = _dot(direction, product, count)
        length = _dot(direction, residual, count) / curvature
        for i in range(count):
            solution[i] += length * direction[i]
            residual[i] -= length * product[i]
    return solution, most, relative

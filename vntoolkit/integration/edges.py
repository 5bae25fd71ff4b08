"""Wanted depth differences along the edges between neighbouring pixels, and their graph.

The difference of depth between two pixels is the integral of the slope between them. Integrating the cubic
through the four nearest slopes on the same line (fourth-order Adams quadrature: central inside,
one-sided at a border) makes the error fall with the fourth power of the pixel; the common trapezoid only
reaches the second. The differences are then what a depth map has exactly, so the discrete Poisson
equation built on them has no consistency error of its own.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import Array, Float32Array, Float64Array, FloatArray, Int32Array, Int64Array, Mask
from vntoolkit.native import njit

_C = np.float32(1.0 / 24.0)
_BEND = 10.0  # standard deviations of a facing edge's difference per pixel of disagreement
_STEEPEST_HALF = 0.9  # half of the difference of log depth, by the chord: 1 would be infinitely steep


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeField:
    """Wanted depth differences and their weights; all (h, w) float32.

    right[v, u] is the difference z(u+1, v) - z(u, v), down[v, u] is z(u, v+1) - z(u, v); the weights are 0
    where an end of the edge is outside the domain (so in the last column and row).
    """

    right: Float32Array
    down: Float32Array
    right_weight: Float32Array
    down_weight: Float32Array


def edges_from_slopes(
    p: Float32Array, q: Float32Array, domain: Mask, weight: Float32Array | None = None
) -> EdgeField:
    """Wanted differences of all edges inside `domain` from slopes per pixel along u (p) and v (q).

    weight: (h, w) confidence or None for 1; an edge is worth its worse end.
    """
    weights = domain.astype(np.float32)
    if weight is not None:
        weights *= weight
    right, right_weight = (np.zeros_like(p) for _ in range(2))
    down, down_weight = (np.zeros_like(p) for _ in range(2))
    _edges_along_rows(p, weights, right, right_weight)
    _edges_along_columns(q, weights, down, down_weight)
    return EdgeField(right=right, down=down, right_weight=right_weight, down_weight=down_weight)


@njit(cache=True, inline="always")
def _difference(a, b, c, d, a_in, d_in):  # type: ignore[no-untyped-def]
    """Integral from the second to the third of four slopes, of which the outer two may be missing."""
    if a_in and d_in:
        return (np.float32(13.0) * (b + c) - a - d) * _C
    if d_in:
        return (np.float32(10.0) * b + np.float32(16.0) * c - np.float32(2.0) * d) * _C
    if a_in:
        return (np.float32(10.0) * c + np.float32(16.0) * b - np.float32(2.0) * a) * _C
    return np.float32(0.5) * (b + c)


@njit(cache=True, inline="always")
def _one_sided(a, b, c, d):  # type: ignore[no-untyped-def]
    """Integral from the first to the second of four slopes."""
    return (np.float32(9.0) * a + np.float32(19.0) * b - np.float32(5.0) * c + d) * _C


@njit(cache=True)
def _edges_along_rows(p, weights, difference, weight):  # type: ignore[no-untyped-def]
    height, width = p.shape
    for v in range(height):
        for u in range(width - 1):
            worth = min(weights[v, u], weights[v, u + 1])
            if worth <= 0.0:
                continue
            weight[v, u] = worth
            before = u > 0 and weights[v, u - 1] > 0.0
            after = u + 2 < width and weights[v, u + 2] > 0.0
            if after and not before and u + 3 < width and weights[v, u + 3] > 0.0:
                difference[v, u] = _one_sided(p[v, u], p[v, u + 1], p[v, u + 2], p[v, u + 3])
            elif before and not after and u > 1 and weights[v, u - 2] > 0.0:
                difference[v, u] = _one_sided(p[v, u + 1], p[v, u], p[v, u - 1], p[v, u - 2])
            else:
                first = p[v, u - 1] if before else np.float32(0.0)
                last = p[v, u + 2] if after else np.float32(0.0)
                difference[v, u] = _difference(first, p[v, u], p[v, u + 1], last, before, after)


@njit(cache=True)
def _edges_along_columns(q, weights, difference, weight):  # type: ignore[no-untyped-def]
    height, width = q.shape
    for v in range(height - 1):
        for u in range(width):
            worth = min(weights[v, u], weights[v + 1, u])
            if worth <= 0.0:
                continue
            weight[v, u] = worth
            before = v > 0 and weights[v - 1, u] > 0.0
            after = v + 2 < height and weights[v + 2, u] > 0.0
            if after and not before and v + 3 < height and weights[v + 3, u] > 0.0:
                difference[v, u] = _one_sided(q[v, u], q[v + 1, u], q[v + 2, u], q[v + 3, u])
            elif before and not after and v > 1 and weights[v - 2, u] > 0.0:
                difference[v, u] = _one_sided(q[v + 1, u], q[v, u], q[v - 1, u], q[v - 2, u])
            else:
                first = q[v - 1, u] if before else np.float32(0.0)
                last = q[v + 2, u] if after else np.float32(0.0)
                difference[v, u] = _difference(first, q[v, u], q[v + 1, u], last, before, after)


@dataclass(frozen=True, kw_only=True, eq=False)
class ChordField:
    """One row per edge of a graph, float64.

    difference: (m,) wanted difference of depth (or log depth times focal length), in pixels. variance: (m,)
    its variance, relative to that of an edge between two normals that face the camera.
    """

    difference: Float64Array
    variance: Float64Array


# Differences by chords: from the normals at the two ends of an edge.


def chords_from_normals(
    normals: FloatArray,
    points: FloatArray,
    graph: "PixelGraph",
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


@njit(cache=True)
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


@njit(cache=True)
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


@dataclass(frozen=True, kw_only=True, eq=False)
class PixelGraph:
    """The edges of a domain and its adjacency.

    pixels: (n,) flat index of each node in the image, scan order. tail, head: (m,) nodes of each edge; first
    the `across` edges that go right, then those that go down. row_start (n+1,), neighbour (2m,), edge (2m,):
    for node i, slots row_start[i] … row_start[i+1] give its neighbours and the edges that lead to them.
    """

    pixels: Int64Array
    tail: Int32Array
    head: Int32Array
    across: int
    row_start: Int32Array
    neighbour: Int32Array
    edge: Int32Array


# The domain as a graph: one node per pixel, one edge per pair of pixels that share a side.


def graph_from_domain(domain: Mask) -> PixelGraph:
    """Build the graph of `domain`, (h, w) bool."""
    node = np.full(domain.shape, -1, dtype=np.int32)
    pixels = np.flatnonzero(domain)
    node.ravel()[pixels] = np.arange(len(pixels), dtype=np.int32)
    right, down = domain[:, :-1] & domain[:, 1:], domain[:-1] & domain[1:]
    tail = np.concatenate([node[:, :-1][right], node[:-1][down]])
    head = np.concatenate([node[:, 1:][right], node[1:][down]])
    row_start, neighbour, edge = _adjacency(tail, head, len(pixels))
    return PixelGraph(
        pixels=pixels,
        tail=tail,
        head=head,
        across=int(np.count_nonzero(right)),
        row_start=row_start,
        neighbour=neighbour,
        edge=edge,
    )


@njit(cache=True)
def _adjacency(tail, head, count):  # type: ignore[no-untyped-def]
    row_start = np.zeros(count + 1, np.int32)
    for e in range(len(tail)):
        row_start[tail[e] + 1] += 1
        row_start[head[e] + 1] += 1
    for i in range(count):
        row_start[i + 1] += row_start[i]
    fill = row_start[:-1].copy()
    neighbour = np.empty(2 * len(tail), np.int32)
    edge = np.empty(2 * len(tail), np.int32)
    for e in range(len(tail)):
        i, j = tail[e], head[e]
        neighbour[fill[i]], edge[fill[i]] = j, e
        neighbour[fill[j]], edge[fill[j]] = i, e
        fill[i] += 1
        fill[j] += 1
    return row_start, neighbour, edge


def divergence_on_graph(graph: PixelGraph, weight: FloatArray, difference: FloatArray) -> Float64Array:
    """Right-hand side of the weighted least squares over edges, (n,): sums to 0 over every component."""
    load = np.zeros(len(graph.pixels))
    _accumulate(graph.tail, graph.head, weight * difference, load)
    return load


@njit(cache=True)
def _accumulate(tail, head, flow, out):  # type: ignore[no-untyped-def]
    for e in range(len(flow)):
        out[head[e]] += flow[e]
        out[tail[e]] -= flow[e]


class Components:
    """Connected components (over shared pixel sides) of a domain, (h, w) bool; box: its rows and columns."""

    def __init__(self, domain: Mask) -> None:
        rows, columns = np.flatnonzero(domain.any(axis=1)), np.flatnonzero(domain.any(axis=0))
        ends = (rows[0], rows[-1] + 1, columns[0], columns[-1] + 1) if len(rows) else (0, 0, 0, 0)
        self.box = slice(int(ends[0]), int(ends[1])), slice(int(ends[2]), int(ends[3]))
        self._inside = np.ascontiguousarray(domain[self.box])
        self._labels, self.count = ndimage.label(self._inside)
        self._shape = domain.shape

    @property
    def labels(self) -> Int32Array:
        """(h, w), the component of each pixel, from 1 on; 0 outside the domain."""
        return self._whole(self._labels)

    def remove_means(self, values: FloatArray) -> Float64Array:
        """Shift `values`, of the box, to mean 0 over each component; (h, w), 0 outside the domain."""
        return self._whole(np.where(self._inside, values - self._means(values), 0.0))

    def scale_means(self, values: FloatArray) -> Float64Array:
        """Scale `values` (h, w) to mean 1 over each component; 0 outside the domain."""
        here = values[self.box]
        return self._whole(np.where(self._inside, here / self._means(here), 0.0))

    def _whole(self, part: Array) -> Array:
        whole = np.zeros(self._shape, part.dtype)
        whole[self.box] = part
        return whole

    def _means(self, values: FloatArray) -> Float64Array:
        """Mean over the component of each pixel of the box, or a scalar."""
        if self.count == 1:
            return np.asarray(values.mean(dtype=np.float64, where=self._inside))
        flat = self._labels.ravel()
        sums = np.bincount(flat, weights=values.ravel(), minlength=self.count + 1)
        means = sums / np.maximum(np.bincount(flat, minlength=self.count + 1), 1)
        return np.where(self._inside, means[self._labels], 1.0)

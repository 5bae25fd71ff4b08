"""Wanted depth differences along the edges between neighbouring pixels.

The difference of depth between two pixels is the integral of the slope between them. Integrating the cubic
through the four nearest slopes on the same line (fourth-order Adams quadrature: central inside,
one-sided at a border) makes the error fall with the fourth power of the pixel; the common trapezoid only
reaches the second. The differences are then what a depth map has exactly, so the discrete Poisson
equation built on them has no consistency error of its own.

Where depth may jump, the four slopes may belong to two surfaces. The chord takes only the normals at the two
ends; it is exact on a sphere, up to its outline.
"""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import Array, Float32Array, Float64Array, FloatArray, Int32Array, Int64Array, Mask
from vntoolkit.native import njit

_C = np.float32(1.0 / 24.0)


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeField:
    """Wanted depth differences and their weights, (2, h, w) float32: of the edges to the right, and down.

    difference[0, v, u] is z(u+1, v) - z(u, v), difference[1, v, u] is z(u, v+1) - z(u, v). The weight is 0
    where an end of the edge is outside the domain (so in the last column and row).
    """

    difference: Float32Array
    weight: Float32Array


@dataclass(frozen=True, kw_only=True, eq=False)
class FarEdges:
    """Wanted depth differences between pixels that lie apart, and their weights, (n,).

    first, last: (n, 2) int64, row and column; differences are depth at `last` less that at `first`.
    """

    first: Int64Array
    last: Int64Array
    difference: FloatArray
    weight: FloatArray

    def within(self, domain: Mask, rows: slice, columns: slice) -> "FarEdges":
        """Return those between pixels of the domain (h, w), in a window's rows and columns."""
        inside = domain[tuple(self.first.T)] & domain[tuple(self.last.T)]
        corner = rows.start, columns.start
        return FarEdges(
            first=self.first[inside] - corner,
            last=self.last[inside] - corner,
            difference=self.difference[inside],
            weight=self.weight[inside],
        )

    def residuals(self, depth: FloatArray) -> FloatArray:
        """Return (n,), what depth (h, w) differs by, less what it is wanted to."""
        found: FloatArray = depth[tuple(self.last.T)] - depth[tuple(self.first.T)]
        return found - self.difference


def edges_from_slopes(
    p: Float32Array, q: Float32Array, domain: Mask, weight: Float32Array | None = None
) -> EdgeField:
    """Wanted differences of all edges inside `domain` from slopes per pixel along u (p) and v (q).

    weight: (h, w) confidence or None for 1; an edge is worth its worse end.
    """
    weights = domain.astype(np.float32)
    if weight is not None:
        weights *= weight
    difference, worth = np.zeros((2, 2, *domain.shape), np.float32)
    _edges_along_rows(p, weights, difference[0], worth[0])
    _edges_along_columns(q, weights, difference[1], worth[1])
    return EdgeField(difference=difference, weight=worth)


@njit(forceinline=True)
def _difference(a, b, c, d, a_in, d_in):  # type: ignore[no-untyped-def]
    """Integral from the second to the third of four slopes, of which the outer two may be missing."""
    if a_in and d_in:
        return (np.float32(13.0) * (b + c) - a - d) * _C
    if d_in:
        return (np.float32(10.0) * b + np.float32(16.0) * c - np.float32(2.0) * d) * _C
    if a_in:
        return (np.float32(10.0) * c + np.float32(16.0) * b - np.float32(2.0) * a) * _C
    return np.float32(0.5) * (b + c)


@njit(forceinline=True)
def _one_sided(a, b, c, d):  # type: ignore[no-untyped-def]
    """Integral from the first to the second of four slopes."""
    return (np.float32(9.0) * a + np.float32(19.0) * b - np.float32(5.0) * c + d) * _C


@njit
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


@njit
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


def chords_from_slopes(p: Float32Array, q: Float32Array) -> Float64Array:
    """Return wanted differences (2, h, w) from the normals at the two ends of each edge alone.

    p, q: (h, w), in pixels a pixel. The chord is at right angles to the mean of the two unit normals: slopes
    count as their normals face the viewer.
    """
    facing = 1.0 / np.sqrt(1.0 + p.astype(np.float64) ** 2 + q.astype(np.float64) ** 2)
    out = np.zeros((2, *p.shape))
    for rise, to, first, last in (
        (p * facing, out[0, :, :-1], np.s_[:, :-1], np.s_[:, 1:]),
        (q * facing, out[1, :-1], np.s_[:-1], np.s_[1:]),
    ):
        to[:] = (rise[first] + rise[last]) / (facing[first] + facing[last])
    return out


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

    def moved_to(self, values: FloatArray, wanted: FloatArray, weight: FloatArray) -> Float64Array:
        """Shift `values`, of the box, by component, to the mean of `wanted`; without weight: of all."""
        labels = self._labels.ravel()
        totals = np.bincount(labels, weights=weight.ravel(), minlength=self.count + 1)
        gaps = np.bincount(labels, (weight * (wanted - values)).ravel(), self.count + 1)
        means = np.where(totals > 0, gaps / np.where(totals > 0, totals, 1.0), gaps.sum() / totals.sum())
        return np.where(self._inside, values + means[self._labels], 0.0)

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

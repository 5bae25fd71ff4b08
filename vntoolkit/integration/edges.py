"""From slopes at pixel centres to the depth difference along every edge between neighbours.

The difference of depth between two pixels is the integral of the slope between them. Integrating the cubic
through the four nearest slopes on the same line (fourth-order Adams quadrature: central inside,
one-sided at a border) makes the error fall with the fourth power of the pixel; the common trapezoid only
reaches the second. The differences are then what a depth map has exactly, so the discrete Poisson
equation built on them has no consistency error of its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Mask

Float32Image = npt.NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeField:
    """Wanted depth differences and their weights; all (h, w) float32.

    right[v, u] is the difference z(u+1, v) - z(u, v), down[v, u] is z(u, v+1) - z(u, v); the weights are 0
    where an end of the edge is outside the domain (so in the last column and row).
    """

    right: Float32Image
    down: Float32Image
    right_weight: Float32Image
    down_weight: Float32Image


def edges_from_slopes(
    p: Float32Image, q: Float32Image, domain: Mask, weight: Float32Image | None = None
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


_C = np.float32(1.0 / 24.0)


@numba.njit(cache=True, inline="always")
def _difference(a, b, c, d, a_in, d_in):  # type: ignore[no-untyped-def]
    """Integral from the second to the third of four slopes, of which the outer two may be missing."""
    if a_in and d_in:
        return (np.float32(13.0) * (b + c) - a - d) * _C
    if d_in:
        return (np.float32(10.0) * b + np.float32(16.0) * c - np.float32(2.0) * d) * _C
    if a_in:
        return (np.float32(10.0) * c + np.float32(16.0) * b - np.float32(2.0) * a) * _C
    return np.float32(0.5) * (b + c)


@numba.njit(cache=True, inline="always")
def _one_sided(a, b, c, d):  # type: ignore[no-untyped-def]
    """Integral from the first to the second of four slopes."""
    return (np.float32(9.0) * a + np.float32(19.0) * b - np.float32(5.0) * c + d) * _C


@numba.njit(cache=True, nogil=True)
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


@numba.njit(cache=True, nogil=True)
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

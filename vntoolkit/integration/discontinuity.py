"""Integration with depth discontinuities: robust, one-sided, iteratively reweighted least squares.

Cao et al. (`cao2022`) showed that normals alone tell where depth is discontinuous if, at every pixel, the
solution may choose which neighbour it continues to: the residuals reweigh the equations. This module keeps
the idea. An edge is cut where its residual is larger than the errors of the normals explain (Geman and
McClure's weight), and that scale is no constant: it is measured on the map itself, in every round anew.

- The circulation of the wanted differences around 2×2 pixels is 0 on a surface. Its median gives the noise
  of single normals. Each of the four edges accounts for a quarter of what is more than that.
- The residuals of least squares hold what neighbouring normals share, too. Their median deviation is large
  at first, where jumps bend the surface, and falls with them: few edges are cut before the others fit.
- Where one surface hides another, depth falls further along the slope than the normals say. A residual the
  other way cuts only where it is far larger.

A surface whose residuals are all explained keeps the least-squares solution.
"""

import math

import numpy as np

from vntoolkit.arrays import Float32Array, Float64Array, FloatArray, Mask
from vntoolkit.integration.edges import EdgeField
from vntoolkit.integration.poisson import MaskedSolver

_LEAST_WEIGHT = 1e-5  # of a fully cut edge: keeps parts that only cuts connect from floating freely
_SMALLEST = 1e-30
_LEAST_NOISE = 1e-4  # pixels: rounding of float32 normals; a noiseless map has no other scale
_MEDIAN_TO_DEVIATION = 1.4826
_ROUNDS = 12  # times the weights are computed anew
_SCALE = 2.0  # standard deviations of an edge's residual at which its weight is a quarter
# The first scale against the last, and the share of the rounds from which the last holds: nothing is cut at
# first that a smooth surface might still explain.
_WIDENING, _NARROW_FROM = 6.0, 0.7
_AGAINST_SLOPE = 100.0  # factor on the scale per pixel of slope where depth falls less than the slope
_ROUND_ITERATIONS = 300  # of conjugate gradients
# Relative residual of the first solution; what every later one leaves of the residual before it, so that a
# part that hangs on few edges finds its place too.
_FIRST_TOLERANCE, _ROUND_TOLERANCE = 1e-3, 0.03


def solve_discontinuous(
    solver: MaskedSolver, edges: EdgeField, variance: Float32Array, start: FloatArray | None
) -> Float64Array:
    """Return depth in pixels (h, w), of arbitrary offset per component.

    edges: wanted differences in pixels, and the confidence in each. variance: (2, h, w), of the differences,
    relative to one another. start: a first guess (h, w).
    """
    inside = edges.weight > 0
    if not inside.any():
        return np.zeros(inside.shape[1:])
    variance = np.where(inside, variance_of_edges(edges.difference, variance, inside), np.float32(1.0))
    confidences = edges.weight[inside]
    depth = solver.solve(edges, start, weighted=bool(confidences.min() < confidences.max()))
    residual = _differences(depth) - edges.difference
    if _are_explained(residual[inside], variance[inside]):
        return depth
    trust = edges.weight / variance
    trust /= trust.max(initial=_SMALLEST)
    weight, tolerance = trust, _FIRST_TOLERANCE
    for progress in np.linspace(0.0, 1.0, _ROUNDS + 1):
        field = EdgeField(difference=-residual.astype(np.float32), weight=weight)
        depth = depth + solver.solve(
            field, weighted=True, tolerance=tolerance, most_iterations=_ROUND_ITERATIONS
        )
        residual = _differences(depth) - edges.difference
        if tolerance == _FIRST_TOLERANCE and _are_explained(residual[inside], variance[inside]):
            break  # only grazing normals, which now count less, were off
        deviation = _deviation(np.abs(residual[inside]) / np.sqrt(variance[inside]))
        scale = max(_SCALE * deviation, 1.0) * _WIDENING ** max(0.0, 1.0 - progress / _NARROW_FROM)
        share = kept_share(residual, edges.difference, scale**2 * variance)
        weight, tolerance = trust * np.maximum(share, _LEAST_WEIGHT), _ROUND_TOLERANCE
    return depth


def _are_explained(residual: FloatArray, variance: FloatArray) -> bool:
    """Whether the largest residual (m,) is no larger than the largest of so many normal deviates may be."""
    normalised = np.abs(residual) / np.sqrt(variance)
    largest = math.sqrt(2.0 * math.log(normalised.size)) + 1.0
    return bool(normalised.max() <= largest * max(_deviation(normalised), 1.0))


def _deviation(normalised: FloatArray) -> float:
    return _MEDIAN_TO_DEVIATION * float(np.median(normalised))


def kept_share(residual: Float64Array, wanted: Float32Array, tolerated: Float32Array) -> Float32Array:
    """Return by how much each edge (2, h, w) still holds two pixels together, from 0 to 1.

    tolerated: squared residual, in pixels², at which an edge along the slope keeps a quarter.
    """
    against = np.where(residual * wanted < 0, 1.0 + (_AGAINST_SLOPE * wanted) ** 2, 1.0)
    return np.square(1.0 / (1.0 + residual**2 / (tolerated * against))).astype(np.float32)


def variance_of_edges(difference: Float32Array, variance: Float32Array, inside: Mask) -> Float32Array:
    """Return the variance of each difference in pixels², from what noise explains and what it does not.

    An edge is as bad as the better of its two squares of 2×2 pixels: where depth jumps by an amount that
    changes along the way, the circulation is large on both sides of every edge that crosses the jump.
    """
    right, down = np.where(inside, difference, np.nan)
    turn = right[:-1, :-1] + down[:-1, 1:] - right[1:, :-1] - down[:-1, :-1]
    spread = variance[0, :-1, :-1] + variance[1, :-1, 1:] + variance[0, 1:, :-1] + variance[1, :-1, :-1]
    known = np.isfinite(turn)
    noise = _LEAST_NOISE
    if known.any():
        normalised = np.abs(turn[known]) / np.sqrt(spread[known])
        noise = max(noise, _MEDIAN_TO_DEVIATION * float(np.median(normalised)))
    square = np.pad(np.where(known, (0.25 * turn) ** 2, np.inf), 1, constant_values=np.inf)
    better = np.zeros_like(variance)
    better[0] = np.minimum(square[:-1, 1:], square[1:, 1:])
    better[1] = np.minimum(square[1:, :-1], square[1:, 1:])
    return noise**2 * variance + np.where(np.isfinite(better), better, 0)


def _differences(depth: FloatArray) -> Float64Array:
    """Return (2, h, w), to the pixel on the right and below; 0 beyond the last."""
    out = np.zeros((2, *depth.shape))
    np.subtract(depth[:, 1:], depth[:, :-1], out=out[0, :, :-1])
    np.subtract(depth[1:], depth[:-1], out=out[1, :-1])
    return out

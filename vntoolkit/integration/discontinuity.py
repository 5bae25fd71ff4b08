"""Integration with depth discontinuities: robust, one-sided, iteratively reweighted least squares.

Cao et al. (`cao2022`) showed that normals alone tell where depth is discontinuous if, at every pixel, the
solution may choose which neighbour it continues to; they reweigh a pixel's two one-sided equations against
each other by the residuals. This module keeps the idea, an iteratively reweighted least squares whose
weights cut edges, and changes four things, each of which lowers the error on real objects:

- an edge's wanted difference is the chord (`chords`), free of bias at grazing normals;
- an edge is judged by its own residual against what the noise of the normals explains (Geman and
  McClure's weight, annealed from a wide scale to a narrow one), and that noise is measured on the map, as
  the circulation of the wanted differences around 2×2 pixels, which is 0 on a surface without noise;
- an edge is doubted beforehand as far as the circulation on both its sides is more than noise;
- the judgement is one-sided: where one surface hides another, depth falls **further** along the slope than
  the normals say, never less, so a residual the other way cuts only when it is far larger.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Weight
from vntoolkit.integration.edges import ChordField, PixelGraph, divergence_on_graph
from vntoolkit.integration.multigrid import hierarchy_from_graph, solve_laplacian
from vntoolkit.native import njit

Float64 = npt.NDArray[np.float64]

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


def solve_discontinuous(
    graph: PixelGraph,
    difference: Float64,
    evidence: Evidence,
    confidence: Float64,
    *,
    start: Float64 | None,
    most_iterations: int,
) -> Float64:
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
    variance: Float64


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


def confidence_of_edges(graph: PixelGraph, weight: Weight | None) -> Float64:
    """Weight per edge (m,): that of its worse end; 1 without a weight."""
    if weight is None:
        return np.ones(len(graph.tail))
    per_node: FloatArray = weight.ravel()[graph.pixels].astype(np.float64)
    return np.minimum(per_node[graph.tail], per_node[graph.head])

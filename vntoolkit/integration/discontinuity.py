"""Integration with depth discontinuities: robust, one-sided, iteratively reweighted least squares.

Cao et al. (`cao2022`) showed that normals alone tell where depth is discontinuous if, at every pixel, the
solution may choose which neighbour it continues to: the residuals reweigh the equations. This module keeps
the idea. An edge is cut where its residual is larger than the errors of the normals explain (Geman and
McClure's weight), and that scale is no constant.

- Where the normals come with expected errors, no error is taken to be smaller than these. The weight of an
  equation is the inverse of its variance; confidences, which come from the same errors, count no second time.
- The circulation of the wanted differences around 2×2 pixels is 0 on a surface. Its median gives the noise
  of single normals. Each of the four edges accounts for a quarter of what is more than that.
- The residuals of least squares hold what neighbouring normals share, too. Their median deviation is large
  at first, where jumps bend the surface, and falls with them: few edges are cut before the others fit.
- Where one surface hides another, depth falls further along the slope than the normals say. A residual the
  other way cuts only where it is far larger.

A surface whose residuals are all explained keeps the least-squares solution.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Mask
from vntoolkit.integration.edges import EdgeField, FarEdges, chords_from_slopes
from vntoolkit.integration.poisson import MaskedSolver
from vntoolkit.native import njit
from vntoolkit.spread import MEDIAN_TO_DEVIATION, NINE_OF_TEN_IN_PLANE

_LEAST_WEIGHT = 1e-5  # of a fully cut edge: keeps parts that only cuts connect from floating freely
_LEAST_NOISE = 1e-4  # pixels: rounding of float32 normals; a noiseless map has no other scale
_BEND = 10.0  # standard deviations of a facing edge's difference per pixel of disagreement
_PER_NORMAL = math.radians(1.0) / NINE_OF_TEN_IN_PLANE  # of directions: deviation over the bound
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
_LOOKED_AT_PX = 150_000  # at most, to tell whether there is a jump: of more, every n-th row and column
_VOTES = 20_000  # that a median is taken over, evenly spread


@dataclass(frozen=True, kw_only=True, eq=False)
class SlopeErrors:
    """What tells how far depth differences between neighbouring pixels may be off.

    p, q: (h, w) float32, slopes in pixels a pixel. inside: (h, w). error_deg: (h, w) float32, the bound that
    nine of ten normals stay within, or None. steps, of_steps: (2, h, w) float32, known steps of depth and
    their variances, or None. far: known differences between pixels that lie apart; weights are inverse
    variances.
    """

    p: Float32Array
    q: Float32Array
    inside: Mask
    error_deg: Float32Array | None = None
    steps: Float32Array | None = None
    of_steps: Float32Array | None = None
    far: FarEdges | None = None

    @cached_property
    def variance(self) -> Float32Array:
        """(2, h, w), in pixels², of the differences to the right, and down; 0 where there is none.

        A turn of a normal by an angle ε moves its slope by ε / cos² of its inclination: grazing ends make an
        edge unsure. So does a bend, as far as the two ends disagree on the slope (`_BEND`). An edge is as bad
        as the better of its two squares of 2×2 pixels: where depth jumps by an amount that changes along the
        way, the circulation is large on both sides of every edge that crosses the jump.
        """
        height, width = self.p.shape
        out = np.zeros((2, height, width), np.float32)
        turn = np.full((height + 1, width + 1), np.float32(np.inf))
        _circulations(self.p, self.q, self.inside, turn)
        _spreads(self.p, self.q, self.inside, out)
        error = np.zeros_like(self.p) if self.error_deg is None else self.error_deg
        _variances(out, turn, error, np.float32(_noise(turn[1:-1, 1:-1], out) ** 2))
        if self.of_steps is not None:
            out += np.where(out > 0, self.of_steps, np.float32(0))
        return out

    def explain(self, depth: FloatArray) -> bool:
        """Whether the residuals of least squares, depth (h, w) in pixels, are no larger than the errors.

        Only a part of the edges is looked at, and its wanted differences are mean slopes.
        """
        every = 1 + int(np.count_nonzero(self.inside)) // _LOOKED_AT_PX
        normalised = []
        for axis, slopes in enumerate((self.p, self.q)):
            lines = np.s_[:, ::every] if axis else np.s_[::every]
            residual = np.diff(depth[lines], axis=1 - axis)
            ends = np.s_[:-1] if axis else np.s_[:, :-1]
            first, last = slopes[lines][ends], slopes[lines][1:] if axis else slopes[lines][:, 1:]
            residual -= 0.5 * (first + last)
            spread = self.variance[axis][lines][ends]
            at = spread > 0
            normalised.append(np.abs(residual[at]) / np.sqrt(spread[at]))
        return are_explained(np.concatenate(normalised))


class JumpSolver:
    """Depth in pixels (h, w), of arbitrary offset per component, that may jump where the errors allow it."""

    def __init__(self, solver: MaskedSolver, errors: SlopeErrors) -> None:
        self._solver = solver
        self._variance = errors.variance
        self._smallest = float(self._variance[self._variance > 0].min(initial=np.inf))
        self._far = errors.far
        self.held = np.zeros_like(self._variance)  # weights of the last step
        self.held_far = errors.far
        self.difference = chords_from_slopes(errors.p, errors.q)
        if errors.steps is not None:
            self.difference += errors.steps

    def cut_once(self, depth: FloatArray) -> FloatArray:
        """Return depth, of least squares, after one step with the last weights."""
        residuals = normalised_residuals(depth, self.difference, self._variance)
        return self._step(depth, self._scale(residuals), _ROUND_TOLERANCE)

    def solve(self, depth: FloatArray) -> FloatArray:
        """Return the depth of all rounds; depth: that of least squares."""
        depth = self._step(depth, np.inf, _FIRST_TOLERANCE)
        for progress in np.linspace(0.0, 1.0, _ROUNDS + 1)[:-1]:
            residuals = normalised_residuals(depth, self.difference, self._variance)
            if progress == 0.0 and are_explained(residuals):
                break  # only grazing normals, which now count less, were off
            widening = _WIDENING ** max(0.0, 1.0 - progress / _NARROW_FROM)
            depth = self._step(depth, self._scale(residuals) * widening, _ROUND_TOLERANCE)
        return depth

    def _scale(self, residuals: Float32Array) -> float:
        return max(_SCALE * deviation_of(residuals), 1.0)

    def _step(self, depth: FloatArray, scale: float, tolerance: float) -> FloatArray:
        """Solve with weights of the residuals of `depth`; scale: standard deviations that keep a quarter."""
        field = EdgeField(difference=np.zeros_like(self._variance), weight=np.zeros_like(self._variance))
        smallest = np.float32(self._smallest)
        _reweigh(depth, self.difference, self._variance, scale, smallest, field.difference, field.weight)
        self.held, missing = field.weight, None
        if self._far is not None:
            residuals = self._far.residuals(depth)
            kept = 1.0 / (1.0 + residuals**2 * self._far.weight / max(scale, _SCALE) ** 2)
            self.held_far = replace(self._far, weight=kept**2 * self._far.weight * self._smallest)
            missing = replace(self.held_far, difference=-residuals)
        return depth + self._solver.solve(
            field, weighted=True, far=missing, tolerance=tolerance, most_iterations=_ROUND_ITERATIONS
        )


def normalised_residuals(depth: FloatArray, difference: FloatArray, variance: Float32Array) -> Float32Array:
    """Return (2, h, w): sizes of what edges still want, over its deviation; -1 for no edge."""
    out = np.empty_like(variance)
    _normalised(depth, difference, variance, out)
    return out


def inverse_of(variance: Float32Array) -> Float32Array:
    """Return weights (2, h, w), from 0 for no edge to 1."""
    weight = np.divide(1.0, variance, out=np.zeros_like(variance), where=variance > 0)
    return np.asarray(weight / (weight.max() or 1.0), np.float32)


def are_explained(residuals: Float32Array) -> bool:
    """Whether the largest residual is no larger than the largest of so many normal deviates may be."""
    count = int(np.count_nonzero(residuals >= 0))
    largest = math.sqrt(2.0 * math.log(max(count, 1))) + 1.0
    return bool(residuals.max(initial=0.0) <= largest * max(deviation_of(residuals), 1.0))


def deviation_of(residuals: Float32Array) -> float:
    """Return the deviation of sizes that are not below 0, by their median."""
    some = residuals[residuals >= 0]
    return MEDIAN_TO_DEVIATION * float(np.median(some[:: 1 + len(some) // _VOTES])) if len(some) else 0.0


@njit
def _normalised(depth, difference, variance, out):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    for v in range(height):
        for k in range(2):
            y, end = v + k, width - 1 + k
            for u in range(width):
                spread = variance[k, v, u]
                if u < end and y < height and spread > 0:
                    residual = depth[y, u + 1 - k] - depth[v, u] - difference[k, v, u]
                    out[k, v, u] = abs(residual) / np.sqrt(spread)
                else:
                    out[k, v, u] = np.float32(-1.0)


@njit
def _reweigh(depth, difference, variance, scale, smallest, missing, weight):  # type: ignore[no-untyped-def]
    """Fill (2, h, w) with what edges still want, and with their weights: inverse variances, less where cut.

    scale: standard deviations of a residual at which an edge along the slope keeps a quarter. smallest: the
    variance whose weight is 1.
    """
    height, width = depth.shape
    one, least, against = np.float32(1.0), np.float32(_LEAST_WEIGHT), np.float32(_AGAINST_SLOPE)
    for v in range(height):
        for k in range(2):
            y = v + k
            if y >= height:
                continue
            for u in range(width - 1 + k):
                spread = variance[k, v, u]
                if spread <= 0:
                    continue
                wanted = difference[k, v, u]
                residual = depth[y, u + 1 - k] - depth[v, u] - wanted
                tolerated = spread * np.float32(scale * scale)
                if residual * wanted < 0:
                    tolerated *= one + against * against * wanted * wanted
                kept = one / (one + residual * residual / tolerated)
                missing[k, v, u] = -residual
                weight[k, v, u] = max(kept * kept, least) * smallest / spread


@njit
def _circulations(p, q, inside, out):  # type: ignore[no-untyped-def]
    """Fill (h + 1, w + 1) within its border: sizes of the circulation around 2×2 pixels inside."""
    height, width = inside.shape
    for v in range(height - 1):
        for u in range(width - 1):
            along = p[v, u] + p[v, u + 1] - p[v + 1, u] - p[v + 1, u + 1]
            turn = np.float32(0.5) * abs(along + q[v, u + 1] + q[v + 1, u + 1] - q[v, u] - q[v + 1, u])
            is_square = inside[v, u] & inside[v, u + 1] & inside[v + 1, u] & inside[v + 1, u + 1]
            out[v + 1, u + 1] = turn if is_square else np.float32(np.inf)


@njit
def _spreads(p, q, inside, out):  # type: ignore[no-untyped-def]
    """Fill (2, h, w): variances of differences over those where normals face the camera; 0 for none."""
    height, width = inside.shape
    one, half, bent = np.float32(1.0), np.float32(0.5), np.float32(_BEND * _BEND)
    for k in range(2):
        slope = q if k else p
        for v in range(height - k):
            y = v + k
            for u in range(width - 1 + k):
                x = u + 1 - k
                first = one + p[v, u] * p[v, u] + q[v, u] * q[v, u]
                last = one + p[y, x] * p[y, x] + q[y, x] * q[y, x]
                bend = slope[y, x] - slope[v, u]
                spread = half * (first * first + last * last) + bent * bend * bend
                out[k, v, u] = spread if inside[v, u] & inside[y, x] else np.float32(0.0)


def _noise(turn: Float32Array, spread: Float32Array) -> float:
    """Return the deviation of a facing edge's difference by the circulations (h - 1, w - 1)."""
    every = 1 + int(math.sqrt(turn.size / _VOTES))
    some = np.s_[::every, ::every]
    right, down = spread
    around = right[:-1, :-1][some] + right[1:, :-1][some] + down[:-1, :-1][some] + down[:-1, 1:][some]
    is_known = turn[some] < np.inf
    return max(deviation_of(turn[some][is_known] / np.sqrt(around[is_known])), _LEAST_NOISE)


@njit
def _variances(spread, turn, error_deg, noise):  # type: ignore[no-untyped-def]
    """Turn relative variances (2, h, w) into those in pixels². noise: that of a facing edge."""
    height, width = error_deg.shape
    by_normals = np.float32(0.5 * _PER_NORMAL**2)
    for k in range(2):
        for v in range(height - k):
            y = v + k
            for u in range(width - 1 + k):
                x = u + 1 - k
                better = min(turn[v + 1, u + 1], turn[v + k, u + 1 - k])
                stated = error_deg[v, u] * error_deg[v, u] + error_deg[y, x] * error_deg[y, x]
                found = noise * spread[k, v, u]
                found += np.float32(0.0625) * better * better if better < np.inf else np.float32(0.0)
                found = max(found, by_normals * stated * spread[k, v, u])
                spread[k, v, u] = found if spread[k, v, u] > 0 else np.float32(0.0)

"""How far the normals of regions are from unit length as a material, and by which log ρ they would be nearer.

The samples of a region, a fixed number of them, are worked on many at a time, in single precision.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import prange
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points
from vntoolkit.materials.reflectance import CAP, Lamps
from vntoolkit.materials.regions import SAMPLES, Regions
from vntoolkit.native import njit

_NONE, _ONE, _TINY, _OF_CAP = np.float32(0.0), np.float32(1.0), np.float32(1e-12), np.float32(CAP**-2)
WEAK_PRIOR = 0.5  # of log ρ, in a joint fit


class Lengths(NamedTuple):
    """How far the normals of each region are from unit length as each material, arrays (n, m).

    error: mean of |n| − 1 over the samples. scatter: variance about it. noise: of one sample's.

    counts: (n, 1).
    """

    error: FloatArray
    scatter: FloatArray
    noise: FloatArray
    counts: FloatArray


def lengths_of(regions: Regions, logs: Points, lamps: Lamps) -> Lengths:
    """Return how far normals are from unit length as each material. logs: (m, 3), log ρ."""
    error, scatter, noise = np.empty((3, regions.count, len(logs)))
    _fill_lengths(
        regions.planes, regions.counts, np.exp(-logs), lamps.haze, lamps.inverse, lamps.mixing, error,
        scatter, noise,
    )  # fmt: skip
    return Lengths(error, scatter, noise, np.maximum(regions.counts, 1)[:, None].astype(np.float64))


def normal_equations(
    regions: Regions, logs: Points, lamps: Lamps, weights: FloatArray, spread: float, reach: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix (n, 3, 3) and the gradient (n, 3) of each region's lengths by its log ρ.

    logs: (n, 3), where they are taken. weights: (n,). spread: standard deviation of lengths beyond noise.
    reach: from CAP times this, or times the whole standard deviation where that is more, lengths count less.
    """
    matrices, gradients = np.empty((regions.count, 3, 3)), np.empty((regions.count, 3))
    _fill_equations(
        regions.planes, regions.counts, weights, np.exp(-logs), lamps.haze, lamps.inverse, lamps.mixing,
        np.float32(spread * spread), np.float32(reach * reach), matrices, gradients,
    )  # fmt: skip
    return matrices, gradients


# Patches.


def patches_of(regions: Regions, joined: Mask) -> IntArray:
    """Return (n,), the patch of each region. joined: (e,), steps within a patch."""
    a, b = regions.sources[joined], regions.neighbours[joined]
    graph = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(regions.count, regions.count))
    return np.asarray(connected_components(graph, directed=False)[1])


# Lengths.


@njit(cache=True, parallel=True)
def _fill_lengths(
    planes: Any, counts: Any, q: Any, haze: Any, inverse: Any, mixing: Any, error: Any, scatter: Any,
    noise: Any,
) -> None:  # fmt: skip
    numbers = np.empty((len(q), 22), np.float32)
    for m in range(len(q)):
        _fill_numbers(q[m], haze, inverse, mixing, numbers[m])
    for i in prange(len(planes)):
        n = max(counts[i], 1)
        for m in range(len(numbers)):
            first, second, variances = _add_lengths(planes[i], numbers[m])
            error[i, m] = first / n
            scatter[i, m] = max(second / n - (first / n) ** 2, 0.0)
            noise[i, m] = variances / n


@njit(cache=True, parallel=True)
def _fill_equations(
    planes: Any, counts: Any, weights: Any, q: Any, haze: Any, inverse: Any, mixing: Any, squared: Any,
    reach: Any, matrices: Any, gradients: Any,
) -> None:  # fmt: skip
    numbers = np.empty((len(q), 22), np.float32)
    for i in prange(len(planes)):
        _fill_numbers(q[i], haze, inverse, mixing, numbers[i])
        sums = _add_equations(planes[i], numbers[i], squared, reach)
        weight = weights[i] / max(counts[i], 1)
        place = 0
        for a in range(3):
            gradients[i, a] = weight * sums[6 + a]
            for b in range(a, 3):
                matrices[i, a, b] = matrices[i, b, a] = weight * sums[place]
                place += 1


@njit(cache=True)
def _fill_numbers(q: Any, haze: Any, inverse: Any, mixing: Any, numbers: Any) -> None:
    """Fill what `_unpacked` returns of a material of 1 / ρ q, (22,) in single precision."""
    bias = 0.0
    for i in range(3):
        for c in range(3):
            numbers[3 * i + c] = inverse[i, c] * q[c]
            along = inverse[i, 0] * q[0] * mixing[0, c]
            along += inverse[i, 1] * q[1] * mixing[1, c]
            along += inverse[i, 2] * q[2] * mixing[2, c]
            numbers[12 + 3 * i + c] = along
            bias += along * along
        numbers[9 + i] = inverse[i, 0] * haze[0] + inverse[i, 1] * haze[1] + inverse[i, 2] * haze[2]
    numbers[21] = bias


@njit(cache=True, inline="always")
def _unpacked(n: Any) -> Any:
    """Return a material's L⁻¹ / ρ, L⁻¹ w, L⁻¹ / ρ by the noise of the channels, and what noise adds to |n|²
    on average; tuples, which stay in registers.
    """
    return (
        (n[0], n[1], n[2], n[3], n[4], n[5], n[6], n[7], n[8]),
        (n[9], n[10], n[11]),
        (n[12], n[13], n[14], n[15], n[16], n[17], n[18], n[19], n[20]),
        n[21],
    )


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _normal(s0: Any, s1: Any, s2: Any, a: Any, origin: Any, noise: Any, bias: Any) -> Any:
    """Return the normal's three components, its length, how far that is from 1, and its variance by noise."""
    n0 = a[0] * s0 + a[1] * s1 + a[2] * s2 - origin[0]
    n1 = a[3] * s0 + a[4] * s1 + a[5] * s2 - origin[1]
    n2 = a[6] * s0 + a[7] * s1 + a[8] * s2 - origin[2]
    squared = n0 * n0 + n1 * n1 + n2 * n2
    length = np.sqrt(squared) + _TINY
    c0 = n0 * noise[0] + n1 * noise[3] + n2 * noise[6]
    c1 = n0 * noise[1] + n1 * noise[4] + n2 * noise[7]
    c2 = n0 * noise[2] + n1 * noise[5] + n2 * noise[8]
    variance = (c0 * c0 + c1 * c1 + c2 * c2) / (length * length)
    return n0, n1, n2, length, (squared - bias - _ONE) / (length + _ONE), variance


@njit(cache=True, fastmath=True, error_model="numpy")
def _add_lengths(s: Any, numbers: Any) -> Any:
    """Return the sums over samples s (4, SAMPLES) of |n| − 1, its square, and its variance by noise."""
    a, origin, noise, bias = _unpacked(numbers)
    first, second, variances = _NONE, _NONE, _NONE
    for p in range(SAMPLES):
        _, _, _, _, e, variance = _normal(s[0, p], s[1, p], s[2, p], a, origin, noise, bias)
        there = s[3, p]
        first += there * e
        second += there * e * e
        variances += there * variance
    return first, second, variances


@njit(cache=True, fastmath=True, error_model="numpy")
def _add_equations(s: Any, numbers: Any, squared: Any, reach: Any) -> Any:
    """Return the sums over samples s (4, SAMPLES) of six entries of the normal matrix and of the gradient."""
    a, origin, noise, bias = _unpacked(numbers)
    m00, m01, m02, m11, m12, m22, g0, g1, g2 = (
        _NONE, _NONE, _NONE, _NONE, _NONE, _NONE, _NONE, _NONE, _NONE,
    )  # fmt: skip
    for p in range(SAMPLES):
        n0, n1, n2, length, e, variance = _normal(s[0, p], s[1, p], s[2, p], a, origin, noise, bias)
        variance += squared
        falling = _ONE / (_ONE + e * e / max(variance, reach) * _OF_CAP)
        weight = s[3, p] * falling * falling / variance
        j0 = (n0 * a[0] + n1 * a[3] + n2 * a[6]) / length * s[0, p]
        j1 = (n0 * a[1] + n1 * a[4] + n2 * a[7]) / length * s[1, p]
        j2 = (n0 * a[2] + n1 * a[5] + n2 * a[8]) / length * s[2, p]
        m00 += weight * j0 * j0
        m01 += weight * j0 * j1
        m02 += weight * j0 * j2
        m11 += weight * j1 * j1
        m12 += weight * j1 * j2
        m22 += weight * j2 * j2
        g0 += weight * j0 * e
        g1 += weight * j1 * e
        g2 += weight * j2 * e
    return m00, m01, m02, m11, m12, m22, g0, g1, g2


@njit(cache=True)
def gather_lengths(labels: Any, matrices: Any, gradients: Any, matrix: Any, gradient: Any) -> None:
    """Add the normal equations of lengths, (n, 3, 3) and (n, 3) of the regions, to those of the materials."""
    for i in range(labels.size):
        first = 3 * labels[i]
        for a in range(3):
            gradient[first + a] += gradients[i, a]
            for b in range(3):
                matrix[first + a, first + b] += matrices[i, a, b]

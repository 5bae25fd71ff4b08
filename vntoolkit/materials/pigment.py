"""Colour that changes inside a material: freckles on skin, hair that is dark and darker, worn dye.

More of one pigment makes a material darker along one line, log ρ + t d: melanin takes most of the blue and
least of the red (tsumura1999). With d known, the unit length of the normal tells t, one number a pixel. The
line is the one that leaves the smoothest normals: what is printed on a surface is no relief. Darkening that
is grey (d equal in all bands) turns no normal, and is where the search starts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange
from scipy.optimize import minimize

from vntoolkit.arrays import FloatArray, Mask, Points, Vector3
from vntoolkit.materials.reflectance import CAP, Lamps, bias_of_noise, length_and_variance
from vntoolkit.native import njit

_PAIRS = 10_000  # of neighbouring blocks that tell how rough normals are
_FEWEST_PAIRS = 1000
_STEEP = 0.08  # difference of normals of two neighbours from which a larger one hardly counts more
_SMOOTHER = 0.95  # of the roughness: one line of two parameters always takes a little
_LEAST_TAKEN = 0.1  # of what it takes from the darkest band: a line along one band alone is its noise
_EVALUATIONS = 35
_SPREAD, _PIGMENT_SPREAD = 0.04, 0.3  # of lengths, and of t
_INDEPENDENT_PX = 64.0  # pixels that share their errors
_KNOWN_BEFORE = 0.5  # standard deviation of log ρ as it was found before
_FIT_ROUNDS, _LONGEST_STEP = 12, 0.1
_FIRST_STEP = 0.3
# Spread of the lengths for other reasons (gloss, light between folds) over that of t, and the most of t, with
# d of length 1. The line shows where t is free; pixels are corrected with care: eyes and lips are not of it.
_TRUST_OF_SEARCH = (0.3, 1.5)
TRUST = (0.5, 0.5)
_ROUNDS = 3
_LEAST_SHARE = 0.06  # of the strongest lamp's light: less may be shadow, whose length tells nothing


def pigment_of(
    contributions: FloatArray, chosen: Mask, log: Vector3, lamps: Lamps
) -> tuple[Vector3, Vector3] | None:
    """Return d (3,), of length 1, along which a material changes, and log ρ; None where it hardly does.

    contributions: (h, w, 3). chosen: (h, w), lit pixels of the material. log: (3,), of its reflectance as of
    one colour.
    """
    pairs = int((chosen[:, 1:] & chosen[:, :-1]).sum())
    if pairs < _FEWEST_PAIRS:
        return None
    factor = max(1, round(float(np.sqrt(pairs / _PAIRS))))
    s, mask = _means_of_blocks(contributions, chosen, factor)
    mixing = lamps.mixing / factor

    def roughness(ends: Any) -> float:
        return float(_roughness(s, mask, np.exp(-log), _along(ends), *lamps[1:3], mixing))

    grey = np.ones(2)
    first = grey + _FIRST_STEP * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"maxfev": _EVALUATIONS, "initial_simplex": first}
    found = minimize(roughness, grey, method="Nelder-Mead", options=options)  # neldermead1965
    direction = _along(found.x)
    is_pigment = direction.min() > _LEAST_TAKEN * direction.max() and found.fun < _SMOOTHER * roughness(grey)
    if not is_pigment:
        return None
    return direction, _of_least_pigment(log, contributions[chosen], lamps, direction)


def _means_of_blocks(contributions: FloatArray, chosen: Mask, factor: int) -> tuple[FloatArray, Mask]:
    """Return the means over blocks of factor × factor pixels, and the blocks of which every pixel is chosen.

    Paint is coarser than noise. In single pixels the line along which normals are smoothest is half that of
    the noisiest lamp.
    """
    h, w = (n // factor for n in chosen.shape)
    parts = np.s_[: h * factor, : w * factor]
    s = contributions[parts].reshape(h, factor, w, factor, 3).mean(axis=(1, 3))
    return s, np.ascontiguousarray(chosen[parts].reshape(h, factor, w, factor).all(axis=(1, 3)))


def _of_least_pigment(log: Vector3, s: Points, lamps: Lamps, direction: Vector3) -> Vector3:
    """Return log ρ (3,) again: pixels whose length pigment would change tell less of it.

    s: (n, 3), contributions. Geman and McClure's weights, about the log ρ that was found before.
    """
    prior = np.eye(3) * (_INDEPENDENT_PX / (len(s) * _KNOWN_BEFORE**2))
    found = log.copy()
    for _ in range(_FIT_ROUNDS):
        shares = s * np.exp(-found)
        normals = (shares - lamps.haze) @ lamps.inverse.T
        lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-6)
        slopes = -(normals / lengths[:, None] @ lamps.inverse) * shares
        error, variance = lengths - 1.0, _SPREAD**2 + (slopes @ direction * _PIGMENT_SPREAD) ** 2
        weights = 1.0 / variance / (1.0 + error**2 / variance / CAP**2) ** 2 / len(s)
        matrix = (slopes * weights[:, None]).T @ slopes + prior
        step = np.linalg.solve(matrix, prior @ (log - found) - (slopes * weights[:, None]).T @ error)
        found = found + step.clip(-_LONGEST_STEP, _LONGEST_STEP)
    return np.asarray(found)


def _along(ends: Any) -> Vector3:
    """(3,) of length 1, from the first and the last over the second component."""
    direction = np.array([ends[0], 1.0, ends[1]])
    return np.asarray(direction / np.linalg.norm(direction))


@njit(cache=True, parallel=True, error_model="numpy")
def _roughness(s: Any, mask: Any, q: Any, d: Any, haze: Any, inverse: Any, mixing: Any) -> float:
    """Mean of a robust squared difference of normals over neighbours in rows."""
    h, w = mask.shape
    bias = bias_of_noise(q, inverse, mixing)
    totals, counts = np.zeros(h), np.zeros(h)
    for v in prange(h):
        x, j, here, before = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
        for u in range(w):
            if not mask[v, u]:
                continue
            t = amount(s[v, u], q, d, haze, inverse, mixing, bias, _TRUST_OF_SEARCH, x, j)
            length = 0.0
            for i in range(3):
                here[i] = 0.0
                for k in range(3):
                    here[i] += inverse[i, k] * (s[v, u, k] * q[k] * np.exp(-t * d[k]) - haze[k])
                length += here[i] * here[i]
            length = np.sqrt(length) + 1e-12
            apart = 0.0
            for i in range(3):
                here[i] /= length
                apart += (here[i] - before[i]) ** 2
                before[i] = here[i]
            if u > 0 and mask[v, u - 1]:
                totals[v] += apart / (apart + _STEEP * _STEEP)
                counts[v] += 1.0
    return totals.sum() / max(counts.sum(), 1.0)


@njit(cache=True, error_model="numpy")
def amount(
    s: Any, q: Any, d: Any, haze: Any, inverse: Any, mixing: Any, bias: float, trust: Any, x: Any,
    j: Any,
) -> float:  # fmt: skip
    """Return t with which the normal of contributions s (3,) is of unit length; 0 where a lamp is missing.

    q: (3,), 1 / ρ. trust: spread of lengths for other reasons over that of t, and the most of t. x, j: (3,),
    room.
    """
    most = max(s[0], s[1], s[2])
    if min(s[0], s[1], s[2]) < _LEAST_SHARE * most:
        return 0.0
    t = 0.0
    for _ in range(_ROUNDS):
        for k in range(3):
            x[k] = q[k] * np.exp(-t * d[k])
        e, _ = length_and_variance(s, x, haze, inverse, mixing, bias, j)
        slope = j[0] * d[0] + j[1] * d[1] + j[2] * d[2]
        t = slope * (slope * t - e) / (slope * slope + trust[0] * trust[0])
        t = min(max(t, -trust[1]), trust[1])
    return t

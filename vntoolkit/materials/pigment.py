"""Colour that changes inside a material: freckles on skin, hair that is dark and darker, worn dye.

More of one pigment makes a material darker along one line, log ρ + t d: melanin takes most of the blue and
least of the red (tsumura1999). With d known, the unit length of the normal tells t, one number a pixel. The
line is the one that leaves the smoothest normals: what is printed on a surface is no relief. Darkening that
is grey (d equal in all bands) turns no normal, and is where the search starts.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.optimize import minimize

from vntoolkit.arrays import FloatArray, IntArray, Mask, Matrix3, Points, Vector3
from vntoolkit.materials.mixtures import FIRST_SPREAD, INDEPENDENT_PX
from vntoolkit.materials.reflectance import CAP, Lamps, bias_of_noise
from vntoolkit.materials.split_frame import LEAST_SHARE

_PAIRS = 10_000  # of neighbouring blocks that tell how rough normals are
_FEWEST_PAIRS = 1000  # fewer show lines where there are none
_STEEP = 0.08  # difference of two neighbours' normals from which a larger one hardly counts more
# Share of the roughness that a line takes, times the root of the pairs: up to 2.4 of yarns, 6 of skin.
_CLEAR = 4.0
_LEAST_TAKEN = 0.1  # of what it takes from the darkest band: a line along one band alone is its noise
_EVALUATIONS = 35
_PIGMENT_SPREAD = 0.3  # of t
_KNOWN_BEFORE = 0.5  # standard deviation of log ρ as it was found before
_FIT_PIXELS = 10_000  # of the material
_FIT_ROUNDS, _LONGEST_STEP = 12, 0.1
_FIRST_STEP = 0.3
# Spread of the lengths for other reasons (gloss, light between folds) over that of t, and the most of t, with
# d of length 1. The line shows where t is free; pixels are corrected with care: eyes and lips are not of it.
_TRUST_OF_SEARCH = (0.3, 1.5)
_TRUST = (0.5, 0.5)
_ROUNDS = 3  # of Gauss–Newton in t
_TINY = 1e-12


def pigment_of(
    contributions: FloatArray, chosen: Mask, log: Vector3, lamps: Lamps, of_others: Vector3 | None = None
) -> tuple[Vector3, Vector3] | None:
    """Return d (3,), of length 1, along which a material changes, and log ρ; None where it hardly does.

    contributions: (h, w, 3). chosen: (h, w), lit pixels of the material. log: (3,), of its reflectance as of
    one colour. of_others: (3,), the line of the subject's other materials, taken where too few pixels tell.
    """
    pixels = contributions[chosen]
    pixels = pixels[:: max(1, len(pixels) // _FIT_PIXELS)]
    factor = max(2, round(float(np.sqrt(_pairs(chosen) / _PAIRS))))
    s, mask = _means_of_blocks(contributions, chosen, factor)
    if _pairs(mask) < _FEWEST_PAIRS:
        return None if of_others is None else (of_others, _of_least_pigment(log, pixels, lamps, of_others))
    beside = np.zeros(mask.shape, np.bool_)
    beside[:, 1:] = mask[:, 1:] & mask[:, :-1]
    known = lamps.inverse * np.exp(-log), lamps.inverse @ lamps.ambient
    squared = 1.0 + float(bias_of_noise(np.exp(-log), lamps.inverse, lamps.mixing / factor))

    def roughness(ends: Any) -> float:
        return _roughness(s[mask], np.flatnonzero(beside[mask]), known, _along(ends), squared)

    grey = np.ones(2)
    first = grey + _FIRST_STEP * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    options = {"maxfev": _EVALUATIONS, "initial_simplex": first}
    found = minimize(roughness, grey, method="Nelder-Mead", options=options)  # neldermead1965
    direction = _along(found.x)
    takes = (1.0 - found.fun / roughness(grey)) * np.sqrt(_pairs(mask))
    is_pigment = direction.min() > _LEAST_TAKEN * direction.max() and takes > _CLEAR
    if not is_pigment:
        return None
    return direction, _of_least_pigment(log, pixels, lamps, direction)


def _pairs(chosen: Mask) -> int:
    """Number of pixels (h, w) that are chosen together with the one to their left."""
    return int((chosen[:, 1:] & chosen[:, :-1]).sum())


def _means_of_blocks(contributions: FloatArray, chosen: Mask, factor: int) -> tuple[FloatArray, Mask]:
    """Return the means over blocks of factor × factor pixels, and the blocks of which every pixel is chosen.

    Paint is coarser than noise. In single pixels the line along which normals are smoothest is half that of
    the noisiest lamp, and of a red yarn, dark in two bands, it passes for a pigment.
    """
    h, w = (n // factor for n in chosen.shape)
    parts = np.s_[: h * factor, : w * factor]
    whole = chosen[parts].reshape(h, factor, w, factor).all(axis=(1, 3))
    places = ((i, j) for i in range(factor) for j in range(factor))
    total = sum(contributions[parts][i::factor, j::factor] for i, j in places)
    return np.asarray(total / factor**2), np.ascontiguousarray(whole)


def _of_least_pigment(log: Vector3, s: Points, lamps: Lamps, direction: Vector3) -> Vector3:
    """Return log ρ (3,) again: pixels whose length pigment would change tell less of it.

    s: (n, 3), contributions. Geman and McClure's weights, about the log ρ that was found before.
    """
    prior = np.eye(3) * (INDEPENDENT_PX / (len(s) * _KNOWN_BEFORE**2))
    found = log.copy()
    for _ in range(_FIT_ROUNDS):
        shares = s * np.exp(-found)
        normals = (shares - lamps.ambient) @ lamps.inverse.T
        lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-6)
        slopes = -(normals / lengths[:, None] @ lamps.inverse) * shares
        error, variance = lengths - 1.0, FIRST_SPREAD**2 + (slopes @ direction * _PIGMENT_SPREAD) ** 2
        weights = 1.0 / variance / (1.0 + error**2 / variance / CAP**2) ** 2 / len(s)
        matrix = (slopes * weights[:, None]).T @ slopes + prior
        step = np.linalg.solve(matrix, prior @ (log - found) - (slopes * weights[:, None]).T @ error)
        found = found + step.clip(-_LONGEST_STEP, _LONGEST_STEP)
    return np.asarray(found)


def _along(ends: Any) -> Vector3:
    """(3,) of length 1, from the first and the last over the second component."""
    direction = np.array([ends[0], 1.0, ends[1]])
    return np.asarray(direction / np.linalg.norm(direction))


def _roughness(
    s: Points, pairs: IntArray, of_normals: tuple[FloatArray, FloatArray], line: Vector3, squared: float
) -> float:
    """Return the mean of a robust squared difference of neighbours' normals without pigment.

    s: (n, 3), contributions. pairs: (p,), pixels with a neighbour before them in the list. of_normals:
    L⁻¹ / ρ and L⁻¹ w. squared: the square of the length to expect, with noise.
    """
    plain = without_pigment(s, *of_normals, line, squared, _TRUST_OF_SEARCH)
    normals = plain @ of_normals[0].T - of_normals[1]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + _TINY
    apart = ((normals[pairs] - normals[pairs - 1]) ** 2).sum(axis=1)
    return float(np.mean(apart / (apart + _STEEP**2)))


def without_pigment(
    s: Points,
    matrix: Matrix3,
    origin: Vector3,
    line: Vector3,
    squared: float = 1.0,
    trust: tuple[float, float] = _TRUST,
) -> Points:
    """Return contributions (n, 3) with the pigment taken out that gives normals of unit length.

    matrix: L⁻¹ / ρ. origin: L⁻¹ w. line: d. squared: the square of the length to expect. trust: spread of
    lengths for other reasons over that of t, and the most of t. A pixel that a lamp misses stays as it is.
    """
    amount = np.zeros(len(s))
    for _ in range(_ROUNDS):
        shares = s * np.exp(-amount[:, None] * line)
        normals = shares @ matrix.T - origin
        lengths = np.linalg.norm(normals, axis=1) + _TINY
        slope = -((normals @ matrix * shares) @ line) / lengths
        error = (lengths**2 - squared) / (lengths + 1.0)
        amount = (slope * (slope * amount - error) / (slope**2 + trust[0] ** 2)).clip(-trust[1], trust[1])
    amount[s.min(axis=1) < LEAST_SHARE * s.max(axis=1)] = 0.0
    return np.asarray(s * np.exp(-amount[:, None] * line))

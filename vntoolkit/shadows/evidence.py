"""How much of a light a pixel may seem to return although the light does not reach it.

Other surfaces send some light into every shadow: next to nothing on a lone figure in a dark studio, a tenth
of the lamp in the folds of a white statue. The frame itself says how much, where a light is predicted and
all but missing. Camera noise adds to it, the more the darker the paint.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Matrix3
from vntoolkit.native import njit
from vntoolkit.shadows.contributions import LightContributions

_SMALLEST_ALBEDO = 0.02
_SMALLEST_COSINE = 1e-6
_UNKNOWN_SPREAD = 0.02
_LARGEST_EXCESS = 0.8  # of log albedo: beyond, it is paint or gloss
_SMALLEST_RATIO = 1e-3
_SHORTEST = 0.05  # of the length that a missing light leaves
_MEDIAN_PX = 3

# The dark level. A cosine is 1 where a surface of the local albedo faces the light; `typical` and `spread`
# are those of the frame's own cosines in shadow.
_MISSING_RATIO = 0.5  # a light is missing below half of its predicted cosine, within two bounds
_TURNING_COSINE = 0.3  # predicted below it, that half falls towards 0: light fades where a surface turns away
_LEAST_MARGIN = 0.015  # lower bound: typical cosine plus this, however little is predicted
_MOST_TIMES, _MOST_MARGIN, _MOST_SPREADS = 3.0, 0.015, 1.3  # upper bound: 3 × typical + margin + 1.3 × spread
CONTRIBUTION_NOISE = 0.008  # standard deviation, full scale = 1; both bounds rise by it over the albedo
_SURELY_PREDICTED = 0.4  # a cosine in shadow is measured where more than this is predicted …
_FEWEST_MISSING = 50  # … and on at least so many pixels, or typical is 0 and spread _UNKNOWN_SPREAD

# The evidence of the albedo, in the units of `robust`.
_COMPARISON = 4.0  # per squared log albedo, 1 / 2σ²: nearer to the albedo with the light or without
_DEPARTURE = 3.0  # per squared log albedo, against a light that would leave any departure
_MOST_FROM_ALBEDO = 2.0  # either way: paint and gloss depart too
WEAK_COSINE = 0.4  # only a pixel's weakest light is judged, and only below this cosine

# Sharpening.
_SHARPENING = 1.2  # part of the difference to the blurred image that is added
_BLUR_PX = 0.87  # standard deviation, about that of a lens with a Bayer pattern
_INSET_PX = 3.2  # nearer to the outline pixels are mixed with the backdrop and stay as they are


def largest_dark_cosine(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask
) -> tuple[FloatArray, FloatArray]:
    """Return per light the cosine (h, w, 3) below which it is missing, and the noise of a cosine (h, w, 1).

    cosines, predicted: (h, w, 3), measured and to be expected where the light arrives. albedo: (h, w).
    """
    typical, spread = _typical_dark_cosine(cosines, predicted, albedo, mask)
    level: FloatArray = np.empty(cosines.shape, np.float32)
    grain: FloatArray = np.empty((*mask.shape, 1), np.float32)
    _level_kernel(np.asarray(predicted), np.asarray(albedo), typical, spread, level, grain)
    return level, grain


@njit(cache=True, parallel=True)
def _level_kernel(
    predicted: FloatArray,
    albedo: FloatArray,
    typical: float,
    spread: float,
    level: FloatArray,
    grain: FloatArray,
) -> None:
    h, w = albedo.shape
    for v in prange(h):
        for u in range(w):
            noise = CONTRIBUTION_NOISE / max(albedo[v, u], _SMALLEST_ALBEDO)
            least = typical + _LEAST_MARGIN + noise
            most = max(_MOST_TIMES * typical + _MOST_MARGIN + _MOST_SPREADS * spread + noise, least)
            for k in range(3):
                expected = predicted[v, u, k]
                part = _MISSING_RATIO * min(max(expected / _TURNING_COSINE, 0.0), 1.0)
                level[v, u, k] = min(max(part * expected, least), most)
            grain[v, u, 0] = noise


def _typical_dark_cosine(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask
) -> tuple[float, float]:
    """The median cosine of a missing light, and its spread: the least of the three lights'.

    Stray light favours none. A part whose surface is predicted wrongly makes one light look missing there
    that is not, and would raise the level for itself; it seldom does so for all three.
    """
    found = [
        _missing_cosines(np.asarray(cosines), np.asarray(predicted), np.asarray(albedo), mask, k)
        for k in range(3)
    ]
    levels = [np.percentile(values, (10, 50)) for values in found if len(values) >= _FEWEST_MISSING]
    if not levels:
        return 0.0, _UNKNOWN_SPREAD
    typical = max(0.0, float(min(level[1] for level in levels)))
    return typical, float(min(level[1] - level[0] for level in levels))


@njit(cache=True)
def _missing_cosines(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask, k: int
) -> FloatArray:
    """What is left of light k, less the noise, wherever it is surely predicted and all but missing."""
    h, w = mask.shape
    found, count = np.empty(h * w, np.float32), 0
    for v in range(h):
        for u in range(w):
            expected = predicted[v, u, k]
            if mask[v, u] and expected > _SURELY_PREDICTED and cosines[v, u, k] < _MISSING_RATIO * expected:
                found[count] = cosines[v, u, k] - CONTRIBUTION_NOISE / max(albedo[v, u], _SMALLEST_ALBEDO)
                count += 1
    return found[:count]


# What the albedo says about a weak light: missing, or only fading where the surface turns from it.


def evidence_from_albedo(
    measured: LightContributions, cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask
) -> FloatArray:
    """Return (h, w, 3) evidence, positive for light, 0 where it is not asked.

    cosines, predicted: (h, w, 3), measured and to be expected where the light arrives. albedo: (h, w), that
    of the surroundings.
    """
    evidence: FloatArray = np.zeros(cosines.shape, dtype=np.float32)
    _evidence_kernel(
        measured.length, albedo, mask, cosines, predicted, np.linalg.inv(measured.directions),
        _COMPARISON, _DEPARTURE, _MOST_FROM_ALBEDO, WEAK_COSINE, evidence,
    )  # fmt: skip
    return evidence


@njit(cache=True, parallel=True)
def _evidence_kernel(
    length: FloatArray, albedo: FloatArray, mask: Mask, cosines: FloatArray, predicted: FloatArray,
    duals: Matrix3, comparison: float, departure: float, most: float, weak_cosine: float, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (h, w, 3) at each pixel's weakest light. duals: (3, 3), they make a normal of its cosines."""
    h, w = mask.shape
    for v in prange(h):
        for u in range(w):
            k = 0
            for i in range(1, 3):
                if cosines[v, u, i] < cosines[v, u, k]:
                    k = i
            if not mask[v, u] or not cosines[v, u, k] < weak_cosine:
                continue
            lost = max(predicted[v, u, k] - max(cosines[v, u, k], 0.0), 0.0)
            squared = 0.0
            for i in range(3):
                part = -lost * duals[i, k]
                for j in range(3):
                    part += duals[i, j] * predicted[v, u, j]
                squared += part * part
            excess = _log(length[v, u] / max(albedo[v, u], _SMALLEST_RATIO))
            expected = _log(max(np.sqrt(squared), _SHORTEST))
            found = comparison * expected * (expected - 2.0 * excess) - departure * excess * excess
            out[v, u, k] = min(max(found, -most), most)


@njit(cache=True, inline="always")
def _log(ratio: float) -> float:
    return min(max(np.log(max(ratio, _SMALLEST_RATIO)), -_LARGEST_EXCESS), _LARGEST_EXCESS)


# Cosines as sharp as the shadows that made them: a lens's blur and a Bayer pattern's undone in part.


def sharpened_cosines(cosines: FloatArray, mask: Mask) -> FloatArray:
    """Return cosines (h, w, 3), float32, sharpened inside `mask` (h, w) and as they were outside."""
    given: FloatArray = np.asarray(cosines, dtype=np.float32)
    blurred = cv2.GaussianBlur(given, (0, 0), _BLUR_PX)
    inset = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    inner = (inset > _INSET_PX)[..., None]
    sharp = np.where(inner, given + np.float32(_SHARPENING) * (given - blurred), given)
    return np.where(mask[..., None], cv2.medianBlur(sharp, _MEDIAN_PX), given)

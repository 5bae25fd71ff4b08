"""How much of a light a pixel may seem to return although the light does not reach it.

Other surfaces send some light into every shadow: next to nothing on a lone figure in a dark studio, a tenth
of the lamp in the folds of a white statue. The frame itself says how much, where a light is predicted and
all but missing. Camera noise adds to it, the more the darker the paint.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Matrix3
from vntoolkit.native import njit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import FLAGS, LightContributions, finite, haze_of, scaled_normal

_SMALLEST_ALBEDO = 0.02
_SMALLEST_COSINE = 1e-6
_UNKNOWN_SPREAD = 0.02
_LARGEST_EXCESS = 0.8  # of log albedo: beyond, it is paint or gloss
_SMALLEST_RATIO = 1e-3
_SHORTEST = 0.05  # of the length that a missing light leaves

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

# Evidence in units of a tolerance; cosines are 1 where a surface of the local albedo faces the light.
STRONGEST_EVIDENCE = 4.0
TOLERANCE_DARK = 0.04  # change of a cosine that is one unit of evidence where none is predicted
_TOLERANCE_BRIGHT = 0.05  # what each unit of predicted cosine adds to that
_PAINT_PART = 0.5  # dark paint: all three cosines are below this part of the predicted ones …
PAINT_COSINE = 0.12  # … and above this one
SMALLEST_ALBEDO = 1e-3
CAST_FACING = 0.2  # predicted cosine from which a shadow counts as cast
MEMORY_UNIT = STRONGEST_EVIDENCE / 127
_DOUBT = 2.5  # units below which a light is in doubt: above, no neighbour and no sharpening turns a label
_AROUND_PX = 4  # how far around a doubt pixels are looked at

# Sharpening.
_SHARPENING = 1.2  # part of the difference to the blurred image that is added
_BLUR_REACH_PX = 3  # where the blur ends
_BLUR_PX = 0.87  # standard deviation, about that of a lens with a Bayer pattern
_INSET_PX = 3.2  # nearer to the outline pixels are mixed with the backdrop and stay as they are


def largest_dark_cosine(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask
) -> tuple[FloatArray, FloatArray]:
    """Return per light the cosine (h, w, 3) below which it is missing, and the noise of a cosine (h, w, 1).

    cosines, predicted: (h, w, 3), measured and to be expected where the light arrives. albedo: (h, w).
    """
    typical, spread = typical_dark_cosine(cosines, predicted, albedo, mask)
    level: FloatArray = np.empty(cosines.shape, np.float32)
    grain: FloatArray = np.empty((*mask.shape, 1), np.float32)
    _level_kernel(np.asarray(predicted), np.asarray(albedo), typical, spread, level, grain)
    return level, grain


@njit(cache=True, inline="always", error_model="numpy")
def _bounds_of_dark(albedo: Any, typical: Any, spread: Any) -> tuple[Any, Any, Any]:
    """Return the noise of a cosine, and the lower and the upper bound of the level below which it is dark."""
    noise = np.float32(CONTRIBUTION_NOISE) / max(albedo, np.float32(_SMALLEST_ALBEDO))
    least = typical + np.float32(_LEAST_MARGIN) + noise
    most = np.float32(_MOST_TIMES) * typical + np.float32(_MOST_MARGIN) + np.float32(_MOST_SPREADS) * spread
    return noise, least, max(most + noise, least)


@njit(cache=True, inline="always", error_model="numpy")
def _dark_level(expected: Any, least: Any, most: Any) -> Any:
    part = expected * np.float32(1.0 / _TURNING_COSINE)
    part = np.float32(_MISSING_RATIO) * min(max(part, np.float32(0.0)), np.float32(1.0))
    return min(max(part * expected, least), most)


@njit(cache=True, parallel=True, error_model="numpy")
def _level_kernel(
    predicted: FloatArray,
    albedo: FloatArray,
    typical: Any,
    spread: Any,
    level: FloatArray,
    grain: FloatArray,
) -> None:
    h, w = albedo.shape
    for v in prange(h):
        for u in range(w):
            noise, least, most = _bounds_of_dark(albedo[v, u], typical, spread)
            for k in range(3):
                level[v, u, k] = _dark_level(predicted[v, u, k], least, most)
            grain[v, u, 0] = noise


def typical_dark_cosine(
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
        measured.length, albedo, mask, cosines, predicted, np.linalg.inv(measured.directions), evidence,
    )  # fmt: skip
    return evidence


@njit(cache=True, parallel=True, error_model="numpy")
def _evidence_kernel(
    length: FloatArray, albedo: FloatArray, mask: Mask, cosines: FloatArray, predicted: FloatArray,
    duals: Matrix3, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (h, w, 3) at each pixel's weakest light. duals: (3, 3), they make a normal of its cosines."""
    h, w = mask.shape
    for v in prange(h):
        for u in range(w):
            k = _weakest(cosines[v, u, 0], cosines[v, u, 1], cosines[v, u, 2])
            if mask[v, u] and cosines[v, u, k] < WEAK_COSINE:
                ratio = length[v, u] / max(albedo[v, u], _SMALLEST_RATIO)
                out[v, u, k] = _from_albedo(k, cosines[v, u, k], predicted[v, u], ratio, duals)


@njit(cache=True, inline="always", error_model="numpy")
def _weakest(a: Any, b: Any, c: Any) -> int:
    if b < a:
        return 2 if c < b else 1
    return 2 if c < a else 0


@njit(cache=True, inline="always", error_model="numpy")
def _from_albedo(k: int, cosine: Any, predicted: FloatArray, ratio: Any, duals: Matrix3) -> Any:
    """Evidence for light k from a length `ratio` times the albedo around."""
    lost = max(predicted[k] - max(cosine, 0.0), 0.0)
    squared = 0.0
    for i in range(3):
        part = -lost * duals[i, k]
        for j in range(3):
            part += duals[i, j] * predicted[j]
        squared += part * part
    excess = _log(ratio)
    expected = _log(max(np.sqrt(squared), _SHORTEST))
    found = _COMPARISON * expected * (expected - 2.0 * excess) - _DEPARTURE * excess * excess
    return min(max(found, -_MOST_FROM_ALBEDO), _MOST_FROM_ALBEDO)


@njit(cache=True, inline="always", error_model="numpy")
def _log(ratio: Any) -> Any:
    return min(max(np.log(max(ratio, _SMALLEST_RATIO)), -_LARGEST_EXCESS), _LARGEST_EXCESS)


# Dark paint, and what evidence comes of a level.


@njit(cache=True, inline="always", error_model="numpy")
def paint_scale(cosines: FloatArray, predicted: FloatArray) -> Any:
    """Return what undoes dark paint: where all three lights are missing alike, it is the albedo that is off.

    1 where there is none.
    """
    a = cosines[0] / max(predicted[0], np.float32(TOLERANCE_DARK))
    b = cosines[1] / max(predicted[1], np.float32(TOLERANCE_DARK))
    c = cosines[2] / max(predicted[2], np.float32(TOLERANCE_DARK))
    typical = max(min(a, b), min(max(a, b), c))
    if max(a, b, c) < np.float32(_PAINT_PART) and typical > np.float32(PAINT_COSINE):
        return np.float32(1.0) / max(typical, np.float32(_SMALLEST_RATIO))
    return np.float32(1.0)


@njit(cache=True, inline="always", error_model="numpy")
def evidence_over(cosine: Any, level: Any, predicted: Any, noise: Any) -> Any:
    """Return how far a cosine is above the level, in units of its tolerance."""
    unit = np.float32(TOLERANCE_DARK) + np.float32(_TOLERANCE_BRIGHT) * max(predicted, np.float32(0.0))
    found = (cosine - level) / np.sqrt(unit * unit + noise * noise)
    return min(max(found, np.float32(-STRONGEST_EVIDENCE)), np.float32(STRONGEST_EVIDENCE))


# The evidence of a whole frame against a surface that was solved on a smaller image. Most pixels are so much
# brighter than a shadow that nothing else need be asked of them.


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameEvidence:
    """What a frame says of each light where it says anything but "it arrives".

    near: (h, w), pixels in doubt and those around them; all others are lit. evidence: (3, h, w), positive for
    light, known where `near`. cosines: (h, w, 3), without paint where `near`. facing: (h, w), bit k set where
    the surface surely faces light k, known where `near`.
    """

    near: Mask
    evidence: FloatArray
    cosines: FloatArray
    facing: npt.NDArray[np.uint8]


def evidence_of_frame(
    rgb: FloatArray, mask: Mask, lamps: Lamps, expected: FloatArray, dark: tuple[float, float],
    memory: npt.NDArray[np.int8] | None,
) -> FrameEvidence:  # fmt: skip
    """Compare a frame (h, w, 3) with what a surface would return.

    expected: (h', w', 5), on a smaller image of the same field: each light's cosine, the albedo, and what
    the frame before counts, 0 to 1. dark: of a missing light, the typical cosine and its spread. memory:
    (h, w, 3) evidence of the frame before, in units of `MEMORY_UNIT`, or None.
    """
    shape = mask.shape
    cosines, doubt = np.empty((*shape, 3), np.float32), np.zeros(shape, np.uint8)
    typical, spread = np.float32(dark[0]), np.float32(dark[1])
    _doubt_kernel(rgb, mask, lamps, expected, typical, spread, cosines, doubt)
    side = 2 * _AROUND_PX + 1
    near: Mask = (cv2.dilate(doubt, np.ones((side, side), np.uint8)) > 0) & mask
    evidence, facing = np.empty((3, *shape), np.float32), np.zeros(shape, np.uint8)
    if near.any():
        sharp = _sharpened(cosines, mask, near)
        old = np.zeros((0, 0, 0), np.int8) if memory is None else memory
        _frame_kernel(
            rgb, mask, near, lamps, expected, typical, spread, sharp, old, cosines,
            evidence, facing,
        )  # fmt: skip
    return FrameEvidence(near=near, evidence=evidence, cosines=cosines, facing=facing)


class Lamps(NamedTuple):
    """What the loops know of the lamps, float32.

    split: (3, 3), contributions from colours. ambient, per_strength: (3,), of a contribution over the albedo.
    inverse, haze, rest: see `contributions`. duals: (3, 3), normals from cosines.
    """

    split: FloatArray
    ambient: FloatArray
    per_strength: FloatArray
    inverse: FloatArray
    haze: FloatArray
    rest: np.float32
    duals: FloatArray


def lamps_of(response: LightResponse) -> Lamps:
    """Lay a response out for the loops."""
    split, strengths = response.contributions_from_rgb, np.linalg.norm(response.lights, axis=1)
    haze, rest = haze_of(response)
    return Lamps(
        split=split.astype(np.float32),
        ambient=(split @ response.ambient).astype(np.float32),
        per_strength=(1.0 / strengths).astype(np.float32),
        inverse=response.inverse.astype(np.float32),
        haze=haze,
        rest=np.float32(rest),
        duals=np.linalg.inv(response.light_directions).astype(np.float32),
    )


@njit(cache=True, inline="always", error_model="numpy")
def place_between(index: int, length: int, small: int) -> tuple[int, int, Any]:
    """Return the two pixels of a smaller image beside one of a larger, and how near it is to the second."""
    place = (np.float32(index) + np.float32(0.5)) * np.float32(small / length) - np.float32(0.5)
    place = min(max(place, np.float32(0.0)), np.float32(small - 1))
    first = int(place)
    return first, min(first + 1, small - 1), place - np.float32(first)


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _doubt_kernel(
    rgb: FloatArray, mask: Mask, lamps: Lamps, expected: FloatArray, typical: Any, spread: Any,
    cosines: FloatArray, doubt: npt.NDArray[np.uint8],
) -> None:  # fmt: skip
    """Fill cosines everywhere, and doubt where one is not far above the level of a shadow."""
    h, w = mask.shape
    height, width, _ = expected.shape
    split, ambient, per_strength = lamps.split, lamps.ambient, lamps.per_strength
    one, zero = np.float32(1.0), np.float32(0.0)
    for v in prange(h):
        up, down, t = place_between(v, h, height)
        row = np.empty((width, 4), np.float32)
        for column in range(width):
            for i in range(4):
                row[column, i] = (one - t) * expected[up, column, i] + t * expected[down, column, i]
        for u in range(w):
            left, right, s = place_between(u, w, width)
            r, g, b = finite(rgb[v, u, 0]), finite(rgb[v, u, 1]), finite(rgb[v, u, 2])
            albedo = (one - s) * row[left, 3] + s * row[right, 3]
            scale = one / max(albedo, np.float32(SMALLEST_ALBEDO))
            noise, least, most = _bounds_of_dark(albedo, typical, spread)
            dark = False
            for k in range(3):
                seen = (split[k, 0] * r + split[k, 1] * g + split[k, 2] * b) * scale
                seen = (seen - ambient[k]) * per_strength[k]
                cosines[v, u, k] = seen
                facing = (one - s) * row[left, k] + s * row[right, k]
                unit = np.float32(TOLERANCE_DARK) + np.float32(_TOLERANCE_BRIGHT) * max(facing, zero) + noise
                dark |= seen - _dark_level(facing, least, most) < np.float32(_DOUBT) * unit
            if dark and mask[v, u]:
                doubt[v, u] = 1


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _frame_kernel(
    rgb: FloatArray, mask: Mask, near: Mask, lamps: Lamps, expected: FloatArray, typical: Any,
    spread: Any, sharp: FloatArray, memory: npt.NDArray[np.int8], cosines: FloatArray,
    evidence: FloatArray, facing: npt.NDArray[np.uint8],
) -> None:  # fmt: skip
    h, w = mask.shape
    height, width, _ = expected.shape
    inverse, haze, rest, duals = lamps.inverse, lamps.haze, lamps.rest, lamps.duals
    one = np.float32(1.0)
    for v in prange(h):
        up, down, t = place_between(v, h, height)
        predicted, found = np.empty(5, np.float32), np.empty(3, np.float32)
        for u in range(w):
            if not near[v, u]:
                continue
            left, right, s = place_between(u, w, width)
            for i in range(5):
                above = (one - s) * expected[up, left, i] + s * expected[up, right, i]
                below = (one - s) * expected[down, left, i] + s * expected[down, right, i]
                predicted[i] = (one - t) * above + t * below
            albedo, persistence = predicted[3], predicted[4]
            scale = paint_scale(cosines[v, u], predicted)
            for k in range(3):
                cosines[v, u, k] *= scale
                found[k] = sharp[v, u, k]
                if predicted[k] > np.float32(CAST_FACING):
                    facing[v, u] |= np.uint8(1 << k)
            scale = paint_scale(found, predicted)
            noise, least, most = _bounds_of_dark(albedo, typical, spread)
            for k in range(3):
                found[k] *= scale
                level = _dark_level(predicted[k], least, most)
                evidence[k, v, u] = evidence_over(found[k], level, predicted[k], noise)
            k = _weakest(found[0], found[1], found[2])
            if found[k] < np.float32(WEAK_COSINE):
                r, g, b = finite(rgb[v, u, 0]), finite(rgb[v, u, 1]), finite(rgb[v, u, 2])
                _, _, _, length = scaled_normal(r, g, b, inverse, haze, rest)
                ratio = length / max(albedo, np.float32(_SMALLEST_RATIO))
                total = evidence[k, v, u] + _from_albedo(k, found[k], predicted, ratio, duals)
                evidence[k, v, u] = min(max(total, -STRONGEST_EVIDENCE), STRONGEST_EVIDENCE)
            if memory.size:
                for k in range(3):
                    before = np.float32(memory[v, u, k]) * np.float32(MEMORY_UNIT)
                    evidence[k, v, u] = (one - persistence) * evidence[k, v, u] + persistence * before


def memory_of(found: FrameEvidence) -> npt.NDArray[np.int8]:
    """Return the evidence (h, w, 3) in units of `MEMORY_UNIT`, for the next frame."""
    out: npt.NDArray[np.int8] = np.empty((*found.near.shape, 3), np.int8)
    _memory_kernel(found.near, found.evidence, out)
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _memory_kernel(near: Mask, evidence: FloatArray, out: npt.NDArray[np.int8]) -> None:
    h, w = near.shape
    for v in prange(h):
        for u in range(w):
            for k in range(3):
                value = evidence[k, v, u] / MEMORY_UNIT if near[v, u] else 127.0
                out[v, u, k] = np.int8(np.rint(value))


# Cosines as sharp as the shadows that made them: a lens's blur and a Bayer pattern's undone in part.


def sharpened_cosines(cosines: FloatArray, mask: Mask) -> FloatArray:
    """Return cosines (h, w, 3), float32, sharpened inside `mask` (h, w) and as they were outside."""
    given: FloatArray = np.ascontiguousarray(cosines, dtype=np.float32)
    return np.where(mask[..., None], _sharpened(given, mask, mask), given)


def _sharpened(cosines: FloatArray, mask: Mask, near: Mask) -> FloatArray:
    """Return the sharpened cosines (h, w, 3) where `near`; the median of nine takes the noise back out."""
    inner: Mask = np.asarray(mask)
    if not mask.all():
        inner = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5) > _INSET_PX
    weights = cv2.getGaussianKernel(2 * _BLUR_REACH_PX + 1, _BLUR_PX).ravel().astype(np.float32)
    sharp, out = np.empty_like(cosines), np.empty_like(cosines)
    _sharpen_kernel(cosines, np.asarray(near), inner, weights, sharp)
    _median_kernel(cosines, sharp, np.asarray(near), out)
    return out


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _sharpen_kernel(
    cosines: FloatArray, near: Mask, inner: Mask, weights: FloatArray, out: FloatArray
) -> None:
    h, w = near.shape
    reach = len(weights) // 2
    for v in prange(h):
        for u in range(w):
            if not near[v, u]:
                continue
            if not inner[v, u]:
                for k in range(3):
                    out[v, u, k] = cosines[v, u, k]
                continue
            a, b, c = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for i in range(-reach, reach + 1):
                y = min(max(v + i, 0), h - 1)
                for j in range(-reach, reach + 1):
                    x = min(max(u + j, 0), w - 1)
                    weight = weights[i + reach] * weights[j + reach]
                    a += weight * cosines[y, x, 0]
                    b += weight * cosines[y, x, 1]
                    c += weight * cosines[y, x, 2]
            part, whole = np.float32(_SHARPENING), np.float32(1.0 + _SHARPENING)
            out[v, u, 0] = whole * cosines[v, u, 0] - part * a
            out[v, u, 1] = whole * cosines[v, u, 1] - part * b
            out[v, u, 2] = whole * cosines[v, u, 2] - part * c


@njit(cache=True, parallel=True, error_model="numpy")
def _median_kernel(cosines: FloatArray, sharp: FloatArray, near: Mask, out: FloatArray) -> None:
    """Fill out with the median of 3×3 pixels; beyond `near` of the cosines as they are."""
    h, w = near.shape
    for v in prange(h):
        nine = np.empty(9, np.float32)
        for u in range(w):
            if not near[v, u]:
                continue
            for k in range(3):
                for i in range(9):
                    y, x = min(max(v + i // 3 - 1, 0), h - 1), min(max(u + i % 3 - 1, 0), w - 1)
                    nine[i] = sharp[y, x, k] if near[y, x] else cosines[y, x, k]
                out[v, u, k] = _median_of_nine(nine)


@njit(cache=True, inline="always", error_model="numpy")
def _median_of_nine(n: FloatArray) -> Any:
    """Of rows sorted: the median of the largest first, the median second and the smallest third values."""
    low = max(min(n[0], n[1], n[2]), min(n[3], n[4], n[5]), min(n[6], n[7], n[8]))
    high = min(max(n[0], n[1], n[2]), max(n[3], n[4], n[5]), max(n[6], n[7], n[8]))
    a, b, c = _middle(n[0], n[1], n[2]), _middle(n[3], n[4], n[5]), _middle(n[6], n[7], n[8])
    return _middle(low, _middle(a, b, c), high)


@njit(cache=True, inline="always", error_model="numpy")
def _middle(a: Any, b: Any, c: Any) -> Any:
    return max(min(a, b), min(max(a, b), c))

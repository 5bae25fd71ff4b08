"""How much of a light a pixel may seem to return although the light does not reach it.

Other surfaces send some light into every shadow: next to nothing on a lone figure in a dark studio, a tenth
of the lamp in the folds of a white statue. The frame itself says how much, where a light is predicted and
all but missing. Camera noise adds to it, the more the darker the paint.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import ByteArray, FloatArray, Mask, Matrix3
from vntoolkit.native import njit
from vntoolkit.photometry.levelling import FLAGS, span_of
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import (
    Numbers,
    columns_between,
    finite,
    flat,
    haze_of,
    numbers_of,
    row_between,
    scaled_normal,
    turned,
)

_SMALLEST_ALBEDO = 0.02
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
    _level_kernel(
        flat(predicted), np.ascontiguousarray(albedo, np.float32), np.float32(typical), np.float32(spread),
        flat(level), flat(grain),
    )  # fmt: skip
    return level, grain


@njit(cache=True, forceinline=True, error_model="numpy")
def _bounds_of_dark(albedo: Any, typical: Any, spread: Any) -> tuple[Any, Any, Any]:
    """Return the noise of a cosine, and the lower and the upper bound of the level below which it is dark."""
    noise = np.float32(CONTRIBUTION_NOISE) / max(albedo, np.float32(_SMALLEST_ALBEDO))
    least = typical + np.float32(_LEAST_MARGIN) + noise
    most = np.float32(_MOST_TIMES) * typical + np.float32(_MOST_MARGIN) + np.float32(_MOST_SPREADS) * spread
    return noise, least, max(most + noise, least)


@njit(cache=True, forceinline=True, error_model="numpy")
def _dark_level(expected: Any, least: Any, most: Any) -> Any:
    part = expected * np.float32(1.0 / _TURNING_COSINE)
    part = np.float32(_MISSING_RATIO) * min(max(part, np.float32(0.0)), np.float32(1.0))
    return min(max(part * expected, least), most)


@njit(cache=True, error_model="numpy")
def _level_kernel(
    predicted: FloatArray, albedo: FloatArray, typical: Any, spread: Any, level: FloatArray, grain: FloatArray
) -> None:
    h, w = albedo.shape
    for v in range(h):
        surface, around, to, noises = predicted[v], albedo[v], level[v], grain[v]
        for u in range(w):
            noise, least, most = _bounds_of_dark(around[u], typical, spread)
            to[3 * u] = _dark_level(surface[3 * u], least, most)
            to[3 * u + 1] = _dark_level(surface[3 * u + 1], least, most)
            to[3 * u + 2] = _dark_level(surface[3 * u + 2], least, most)
            noises[u] = noise


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


@njit(cache=True, forceinline=True, error_model="numpy")
def _weakest(a: Any, b: Any, c: Any) -> int:
    if b < a:
        return 2 if c < b else 1
    return 2 if c < a else 0


@njit(cache=True, forceinline=True, error_model="numpy")
def evidence_from_albedo(k: int, cosine: Any, predicted: FloatArray, ratio: Any, duals: Matrix3) -> Any:
    """Return the evidence for light k, positive for light, of a length `ratio` times the albedo around.

    cosine: of light k as measured. predicted: (3,), to be expected where lights arrive. duals: (3, 3), they
    make a normal of its cosines.
    """
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


@njit(cache=True, forceinline=True, error_model="numpy")
def _log(ratio: Any) -> Any:
    return min(max(np.log(max(ratio, _SMALLEST_RATIO)), -_LARGEST_EXCESS), _LARGEST_EXCESS)


# Dark paint, and what evidence comes of a level.


@njit(cache=True, forceinline=True, error_model="numpy")
def paint_scale(c0: Any, c1: Any, c2: Any, p0: Any, p1: Any, p2: Any) -> Any:
    """Return what undoes dark paint: where all three lights are missing alike, it is the albedo that is off.

    c0, c1, c2: cosines; p0, p1, p2: predicted. 1 where there is none.
    """
    least = np.float32(TOLERANCE_DARK)
    a, b, c = c0 / max(p0, least), c1 / max(p1, least), c2 / max(p2, least)
    high = max(a, b)
    typical = max(min(a, b), min(high, c))
    painted = (max(high, c) < np.float32(_PAINT_PART)) & (typical > np.float32(PAINT_COSINE))
    return np.float32(1.0) / (typical if painted else np.float32(1.0))


@njit(cache=True, forceinline=True, error_model="numpy")
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
    facing: ByteArray


def evidence_of_frame(
    rgb: FloatArray, mask: Mask, inset: FloatArray | None, lamps: "Lamps", expected: FloatArray,
    dark: tuple[float, float],
) -> FrameEvidence:  # fmt: skip
    """Compare a frame (h, w, 3) with what a surface would return.

    inset: see `inset_of`. expected: (4, h', w'), on a smaller image of the same field: each light's cosine
    and the albedo. dark: of a missing light, the typical cosine and its spread.
    """
    shape = mask.shape
    cosines, doubt = np.empty((*shape, 3), np.float32), np.zeros(shape, np.uint8)
    typical, spread = np.float32(dark[0]), np.float32(dark[1])
    _doubt_kernel(flat(rgb), mask, lamps, expected, typical, spread, flat(cosines), doubt)
    side = 2 * _AROUND_PX + 1
    near: Mask = (cv2.dilate(doubt, np.ones((side, side), np.uint8)) > 0) & mask
    evidence, facing = np.empty((3, *shape), np.float32), np.zeros(shape, np.uint8)
    if near.any():
        sharp = _sharpened(cosines, near, inset)
        _frame_kernel(
            flat(rgb), near, lamps, expected, typical, spread, flat(sharp), flat(cosines), evidence, facing
        )
    return FrameEvidence(near=near, evidence=evidence, cosines=cosines, facing=facing)


class Lamps(NamedTuple):
    """What the loops know of the lamps, float32.

    split: nine, contributions from colours. ambient, per_strength: three, of a contribution over the albedo.
    inverse, haze, rest: see `contributions`. duals: (3, 3), normals from cosines.
    """

    split: Numbers
    ambient: Numbers
    per_strength: Numbers
    inverse: Numbers
    haze: Numbers
    rest: np.float32
    duals: FloatArray


def lamps_of(response: LightResponse) -> Lamps:
    """Lay a response out for the loops."""
    split, strengths = response.contributions_from_rgb, np.linalg.norm(response.lights, axis=1)
    haze, rest = haze_of(response)
    return Lamps(
        split=numbers_of(split),
        ambient=numbers_of(split @ response.ambient),
        per_strength=numbers_of(1.0 / strengths),
        inverse=numbers_of(response.inverse),
        haze=numbers_of(haze),
        rest=np.float32(rest),
        duals=np.linalg.inv(response.light_directions).astype(np.float32),
    )


@njit(cache=True, forceinline=True, error_model="numpy")
def _is_doubted(cosine: Any, predicted: Any, noise: Any, least: Any, most: Any) -> Any:
    unit = (
        np.float32(TOLERANCE_DARK) + np.float32(_TOLERANCE_BRIGHT) * max(predicted, np.float32(0.0)) + noise
    )
    return cosine - _dark_level(predicted, least, most) < np.float32(_DOUBT) * unit


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _doubt_kernel(
    rgb: FloatArray, mask: Mask, lamps: Lamps, expected: FloatArray, typical: Any, spread: Any,
    cosines: FloatArray, doubt: ByteArray,
) -> None:  # fmt: skip
    """Fill cosines everywhere, and doubt where one is not far above the level of a shadow."""
    h, w = mask.shape
    split, ambient, strength = lamps.split, lamps.ambient, lamps.per_strength
    left, part = columns_between(w, expected.shape[2])
    for v in prange(h):
        rows = np.empty((4, w), np.float32)
        row_between(expected, np.int64(v), h, left, part, rows)
        first, second, third, albedo = rows[0], rows[1], rows[2], rows[3]
        line, inside, to, found = rgb[v], mask[v], cosines[v], doubt[v]
        for u in range(w):
            r, g, b = finite(line[3 * u]), finite(line[3 * u + 1]), finite(line[3 * u + 2])
            x, y, z = turned(split, r, g, b)
            scale = np.float32(1.0) / max(albedo[u], np.float32(SMALLEST_ALBEDO))
            x = (x * scale - ambient[0]) * strength[0]
            y = (y * scale - ambient[1]) * strength[1]
            z = (z * scale - ambient[2]) * strength[2]
            to[3 * u], to[3 * u + 1], to[3 * u + 2] = x, y, z
            noise, least, most = _bounds_of_dark(albedo[u], typical, spread)
            dark = _is_doubted(x, first[u], noise, least, most)
            dark |= _is_doubted(y, second[u], noise, least, most)
            dark |= _is_doubted(z, third[u], noise, least, most)
            found[u] = dark & inside[u]


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _frame_kernel(
    rgb: FloatArray, near: Mask, lamps: Lamps, expected: FloatArray, typical: Any, spread: Any,
    sharp: FloatArray, cosines: FloatArray, evidence: FloatArray, facing: ByteArray,
) -> None:  # fmt: skip
    h, w = near.shape
    inverse, haze, rest, duals = lamps.inverse, lamps.haze, lamps.rest, lamps.duals
    left, part = columns_between(w, expected.shape[2])
    for v in prange(h):
        first, last = span_of(near[v])
        if first == last:
            continue
        rows = np.empty((7, last - first), np.float32)
        row_between(expected, np.int64(v), h, left[first:last], part[first:last], rows[:4])
        inside, seen = near[v, first:last], rows[4:]
        _evidence_row(
            inside, rows, sharp[v, 3 * first : 3 * last], typical, spread,
            cosines[v, 3 * first : 3 * last], seen, evidence[0, v, first:last],
            evidence[1, v, first:last], evidence[2, v, first:last], facing[v, first:last],
        )  # fmt: skip
        _albedo_row(
            inside, rgb[v, 3 * first : 3 * last], inverse, haze, rest, duals, rows, seen,
            evidence[:, v, first:last],
        )  # fmt: skip


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _evidence_row(
    inside: Mask, rows: FloatArray, sharp: FloatArray, typical: Any, spread: Any, cosines: FloatArray,
    seen: FloatArray, first: FloatArray, second: FloatArray, third: FloatArray,
    facing: ByteArray,
) -> None:  # fmt: skip
    """Fill the evidence of a row from the sharpened cosines; put these, without paint, into seen."""
    p, q, s, albedo = rows[0], rows[1], rows[2], rows[3]
    seen_p, seen_q, seen_s = seen[0], seen[1], seen[2]
    one, cast = np.float32(1.0), np.float32(CAST_FACING)
    for u in range(len(inside)):
        a, b, c = cosines[3 * u], cosines[3 * u + 1], cosines[3 * u + 2]
        scale = paint_scale(a, b, c, p[u], q[u], s[u])
        scale = scale if inside[u] else one
        cosines[3 * u], cosines[3 * u + 1], cosines[3 * u + 2] = a * scale, b * scale, c * scale
    for u in range(len(inside)):
        a, b, c = sharp[3 * u], sharp[3 * u + 1], sharp[3 * u + 2]
        scale = paint_scale(a, b, c, p[u], q[u], s[u])
        a, b, c = a * scale, b * scale, c * scale
        noise, least, most = _bounds_of_dark(albedo[u], typical, spread)
        first[u] = evidence_over(a, _dark_level(p[u], least, most), p[u], noise)
        second[u] = evidence_over(b, _dark_level(q[u], least, most), q[u], noise)
        third[u] = evidence_over(c, _dark_level(s[u], least, most), s[u], noise)
        seen_p[u], seen_q[u], seen_s[u] = a, b, c
    for u in range(len(inside)):
        facing[u] = (p[u] > cast) | ((q[u] > cast) << 1) | ((s[u] > cast) << 2)


@njit(cache=True, error_model="numpy")
def _albedo_row(
    inside: Mask, line: FloatArray, inverse: Numbers, haze: Numbers, rest: Any, duals: FloatArray,
    rows: FloatArray, seen: FloatArray, evidence: FloatArray,
) -> None:  # fmt: skip
    """Add the albedo's evidence where the weakest light is weak."""
    predicted = np.empty(3, np.float32)
    for u in range(len(inside)):
        k = _weakest(seen[0, u], seen[1, u], seen[2, u])
        if inside[u] and seen[k, u] < np.float32(WEAK_COSINE):
            predicted[0], predicted[1], predicted[2] = rows[0, u], rows[1, u], rows[2, u]
            r, g, b = finite(line[3 * u]), finite(line[3 * u + 1]), finite(line[3 * u + 2])
            _, _, _, length = scaled_normal(r, g, b, inverse, haze, rest)
            ratio = length / max(rows[3, u], np.float32(_SMALLEST_RATIO))
            total = evidence[k, u] + evidence_from_albedo(k, seen[k, u], predicted, ratio, duals)
            evidence[k, u] = min(max(total, -STRONGEST_EVIDENCE), STRONGEST_EVIDENCE)


# Cosines as sharp as the shadows that made them: a lens's blur and a Bayer pattern's undone in part.


def inset_of(mask: Mask) -> FloatArray | None:
    """Return (h, w), the distance in pixels from the outline inwards; None where there is no outline."""
    if mask.all():
        return None
    return np.asarray(cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5), np.float32)


def sharpened_cosines(cosines: FloatArray, mask: Mask) -> FloatArray:
    """Return cosines (h, w, 3), float32, sharpened inside `mask` (h, w) and as they were outside."""
    given: FloatArray = np.ascontiguousarray(cosines, dtype=np.float32)
    return np.where(mask[..., None], _sharpened(given, mask, inset_of(mask)), given)


def _sharpened(cosines: FloatArray, near: Mask, inset: FloatArray | None) -> FloatArray:
    """Return the sharpened cosines (h, w, 3) where `near`; the median of nine takes the noise back out."""
    inner: Mask = np.asarray(near if inset is None else inset > _INSET_PX)
    weights = cv2.getGaussianKernel(2 * _BLUR_REACH_PX + 1, _BLUR_PX).ravel().astype(np.float32)
    sharp, out = np.empty_like(cosines), np.empty_like(cosines)
    _sharpen_kernel(flat(cosines), np.asarray(near), inner, weights, flat(sharp))
    _median_kernel(flat(sharp), np.asarray(near), flat(out))
    return out


@njit(cache=True, error_model="numpy")
def _with_rim(row: FloatArray, first: int, last: int, rim: int, out: FloatArray) -> None:
    """Copy the pixels from first - rim to last + rim of a row of three values each; ends are repeated."""
    width = len(row) // 3
    for u in range(first - rim, last + rim):
        of, to = 3 * min(max(u, 0), width - 1), 3 * (u - first + rim)
        out[to], out[to + 1], out[to + 2] = row[of], row[of + 1], row[of + 2]


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _sharpen_kernel(
    cosines: FloatArray, near: Mask, inner: Mask, weights: FloatArray, out: FloatArray
) -> None:
    """Fill out (h, 3 w) about pixels that are near: sharp where near and inner, else as given."""
    h, w = near.shape
    reach = len(weights) // 2
    part, whole = np.float32(_SHARPENING), np.float32(1.0 + _SHARPENING)
    for v in prange(h):
        start, end = w, 0
        for y in range(max(v - 1, 0), min(v + 2, h)):
            first, last = span_of(near[y])
            if first < last:
                start, end = min(start, max(first - 1, 0)), max(end, min(last + 1, w))
        out[v, 3 * start : 3 * end] = cosines[v, 3 * start : 3 * end]
        first, last = span_of(near[v])
        if first == last:
            continue
        down, rim = (
            np.zeros(cosines.shape[1], np.float32),
            np.empty(3 * (last - first + 2 * reach), np.float32),
        )
        from_, to_ = 3 * max(first - reach, 0), 3 * min(last + reach, w)
        for i in range(-reach, reach + 1):
            line, total, weight = (
                cosines[min(max(v + i, 0), h - 1), from_:to_],
                down[from_:to_],
                weights[i + reach],
            )
            for j in range(len(total)):
                total[j] += weight * line[j]
        _with_rim(down, first, last, reach, rim)
        mean = np.zeros(3 * (last - first), np.float32)
        for i in range(2 * reach + 1):
            line, weight = rim[3 * i :], weights[i]
            for j in range(len(mean)):
                mean[j] += weight * line[j]
        to, line = out[v, 3 * first : 3 * last], cosines[v, 3 * first : 3 * last]
        for u in range(last - first):
            if near[v, first + u] and inner[v, first + u]:
                for k in range(3):
                    to[3 * u + k] = whole * line[3 * u + k] - part * mean[3 * u + k]


@njit(cache=True, parallel=True, error_model="numpy")
def _median_kernel(values: FloatArray, near: Mask, out: FloatArray) -> None:
    """Fill out (h, 3 w) with the median of 3×3 pixels wherever a row is near."""
    h, _ = near.shape
    for v in prange(h):
        first, last = span_of(near[v])
        if first == last:
            continue
        count = 3 * (last - first)
        rows = np.empty((3, count + 6), np.float32)
        for i in range(3):
            _with_rim(values[min(max(v + i - 1, 0), h - 1)], first, last, 1, rows[i])
        above, here, below, to = rows[0], rows[1], rows[2], out[v, 3 * first : 3 * last]
        a, b, c, d, e, f = above, above[3:], above[6:], here, here[3:], here[6:]
        g, m, n = below, below[3:], below[6:]
        for j in range(count):
            to[j] = _median_of_nine(a[j], b[j], c[j], d[j], e[j], f[j], g[j], m[j], n[j])


@njit(cache=True, forceinline=True, error_model="numpy")
def _median_of_nine(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, i: Any) -> Any:
    """Of rows sorted: the median of the largest first, the median second and the smallest third values."""
    low = _larger(_larger(_least(a, b, c), _least(d, e, f)), _least(g, h, i))
    high = _smaller(_smaller(_most(a, b, c), _most(d, e, f)), _most(g, h, i))
    return _middle(low, _middle(_middle(a, b, c), _middle(d, e, f), _middle(g, h, i)), high)


@njit(cache=True, forceinline=True, error_model="numpy")
def _larger(a: Any, b: Any) -> Any:
    return max(a, b)


@njit(cache=True, forceinline=True, error_model="numpy")
def _smaller(a: Any, b: Any) -> Any:
    return min(a, b)


@njit(cache=True, forceinline=True, error_model="numpy")
def _least(a: Any, b: Any, c: Any) -> Any:
    first = min(a, b)
    return min(first, c)


@njit(cache=True, forceinline=True, error_model="numpy")
def _most(a: Any, b: Any, c: Any) -> Any:
    first = max(a, b)
    return max(first, c)


@njit(cache=True, forceinline=True, error_model="numpy")
def _middle(a: Any, b: Any, c: Any) -> Any:
    return max(min(a, b), min(max(a, b), c))

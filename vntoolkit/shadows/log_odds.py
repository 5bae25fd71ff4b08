"""How much of a light a pixel may seem to return although the light does not reach it.

Other surfaces send some light into every shadow: next to nothing on a lone figure in a dark studio, a tenth
of the lamp in the folds of a white statue. The frame itself says how much, where a light is predicted and
all but missing. Camera noise adds to it, the more the darker the paint. Where all three lights are missing
alike, it is dark paint. Where one light is weak, the albedo tells whether it is missing or fades.

A cosine is a light's contribution over the albedo around and its strength: 1 where a surface faces the light.
"""

from typing import Any

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Matrix3
from vntoolkit.native import njit
from vntoolkit.shadows.contributions import flat

_SMALLEST_ALBEDO = 0.02
_UNKNOWN_SPREAD = 0.02
_LARGEST_EXCESS = 0.8  # of log albedo: beyond, it is paint or gloss
_SMALLEST_RATIO = 1e-3
_SHORTEST = 0.05  # of the length that a missing light leaves

# The dark level; `typical` and `spread` are those of the frame's own cosines in shadow.
_MISSING_RATIO = 0.5  # a light is missing below half of its predicted cosine, within two bounds
_TURNING_COSINE = 0.3  # predicted below it, that half falls towards 0: light fades where a surface turns away
_LEAST_MARGIN = 0.015  # lower bound: typical cosine plus this, however little is predicted
_MOST_TIMES, _MOST_MARGIN, _MOST_SPREADS = 3.0, 0.015, 1.3  # upper bound: 3 × typical + margin + 1.3 × spread
CONTRIBUTION_NOISE = 0.008  # standard deviation, full scale = 1; both bounds rise by it over the albedo
_SURELY_PREDICTED = 0.4  # a cosine in shadow is measured where more than this is predicted …
_FEWEST_MISSING = 50  # … and on at least so many pixels, or typical is 0 and spread _UNKNOWN_SPREAD

# Evidence in units of a tolerance.
LARGEST_LOG_ODDS = 4.0
_TOLERANCE_DARK = 0.04  # change of a cosine that is one unit of log odds where none is predicted
_TOLERANCE_BRIGHT = 0.05  # what each unit of predicted cosine adds to that
_PAINT_PART = 0.5  # dark paint: all three cosines are below this part of the predicted ones …
PAINT_COSINE = 0.12  # … and above this one

# The log odds of the albedo, in the same units.
_COMPARISON = 4.0  # per squared log albedo, 1 / 2σ²: nearer to the albedo with the light or without
_MISFIT = 3.0  # per squared log albedo, against a light that would leave any departure
_MOST_FROM_ALBEDO = 2.0  # either way: paint and gloss depart too
WEAK_COSINE = 0.4  # only a pixel's weakest light is judged, and only below this cosine


def typical_dark_cosine(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask
) -> tuple[float, float]:
    """The median cosine of a missing light, and its spread: the least of the three lights'.

    cosines, predicted: (h, w, 3), measured and to be expected where the light arrives. albedo: (h, w). Stray
    light favours none. A part whose surface is predicted wrongly makes one light look missing there that is
    not, and would raise the level for itself; it seldom does so for all three.
    """
    found = []
    for k in range(3):
        seen, surface = cosines[..., k], predicted[..., k]
        missing = mask & (surface > _SURELY_PREDICTED) & (seen < _MISSING_RATIO * surface)
        noise = CONTRIBUTION_NOISE / np.maximum(albedo[missing], _SMALLEST_ALBEDO)
        found.append(seen[missing] - noise)
    levels = [np.percentile(values, (10, 50)) for values in found if len(values) >= _FEWEST_MISSING]
    if not levels:
        return 0.0, _UNKNOWN_SPREAD
    typical = max(0.0, float(min(level[1] for level in levels)))
    return typical, float(min(level[1] - level[0] for level in levels))


def without_paint(cosines: FloatArray, predicted: FloatArray) -> FloatArray:
    """Undo dark paint: where all three lights are missing alike, it is the albedo that is off.

    cosines, predicted: (h, w, 3).
    """
    out: FloatArray = np.empty(cosines.shape, np.float32)
    _paint_kernel(flat(cosines), flat(predicted), flat(out))
    return out


@njit
def _paint_kernel(cosines: FloatArray, predicted: FloatArray, out: FloatArray) -> None:
    h, w = cosines.shape[0], cosines.shape[1] // 3
    one, part, least = np.float32(1.0), np.float32(_PAINT_PART), np.float32(_TOLERANCE_DARK)
    for v in range(h):
        line, surface, to = cosines[v], predicted[v], out[v]
        for u in range(w):
            i = 3 * u
            a, b, c = line[i], line[i + 1], line[i + 2]
            x, y = a / max(surface[i], least), b / max(surface[i + 1], least)
            z, high = c / max(surface[i + 2], least), max(x, y)
            typical = max(min(x, y), min(high, z))
            painted = (max(high, z) < part) & (typical > np.float32(PAINT_COSINE))
            scale = one / (typical if painted else one)
            to[i], to[i + 1], to[i + 2] = a * scale, b * scale, c * scale


def log_odds_of_lights(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, length: FloatArray | None,
    dark: tuple[float, float], directions: Matrix3,
) -> FloatArray:  # fmt: skip
    """Return (3, h, w), positive where more is measured of light k than a shadow returns.

    cosines, predicted: (h, w, 3), `without_paint`, and to be expected. albedo: (h, w), that around. length:
    (h, w), the pixel's own if all lights arrive; None where it is not asked. dark: see `typical_dark_cosine`.
    directions: (3, 3), a unit row a light.
    """
    out: FloatArray = np.empty((3, *albedo.shape), np.float32)
    ratio = np.zeros((0, 0), np.float32)
    if length is not None:
        ratio = np.asarray(length / np.maximum(albedo, np.float32(_SMALLEST_RATIO)), np.float32)
    _log_odds_kernel(
        flat(cosines), flat(predicted), np.ascontiguousarray(albedo, np.float32), ratio, np.float32(dark[0]),
        np.float32(dark[1]), np.linalg.inv(directions).astype(np.float32), out,
    )  # fmt: skip
    return out


@njit
def _log_odds_kernel(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, ratio: FloatArray, typical: Any,
    spread: Any, duals: FloatArray, out: FloatArray,
) -> None:  # fmt: skip
    _, h, w = out.shape
    strongest, zero = np.float32(LARGEST_LOG_ODDS), np.float32(0.0)
    bound = np.float32(_MOST_TIMES) * typical + np.float32(_MOST_MARGIN) + np.float32(_MOST_SPREADS) * spread
    for v in range(h):
        for u in range(w):
            noise = np.float32(CONTRIBUTION_NOISE) / max(albedo[v, u], np.float32(_SMALLEST_ALBEDO))
            least = typical + np.float32(_LEAST_MARGIN) + noise
            most = max(bound + noise, least)
            weakest = 0
            for k in range(3):
                seen, expected = cosines[v, 3 * u + k], predicted[v, 3 * u + k]
                turning = min(max(expected * np.float32(1.0 / _TURNING_COSINE), zero), np.float32(1.0))
                level = min(max(np.float32(_MISSING_RATIO) * turning * expected, least), most)
                unit = np.float32(_TOLERANCE_DARK) + np.float32(_TOLERANCE_BRIGHT) * max(expected, zero)
                found = (seen - level) / np.sqrt(unit * unit + noise * noise)
                out[k, v, u] = min(max(found, -strongest), strongest)
                if seen < cosines[v, 3 * u + weakest]:
                    weakest = k
            seen = cosines[v, 3 * u + weakest]
            if ratio.size and seen < np.float32(WEAK_COSINE):
                surface = predicted[v, 3 * u : 3 * u + 3]
                found = out[weakest, v, u] + log_odds_from_albedo(weakest, seen, surface, ratio[v, u], duals)
                out[weakest, v, u] = min(max(found, -strongest), strongest)


@njit(forceinline=True)
def log_odds_from_albedo(k: int, cosine: Any, predicted: FloatArray, ratio: Any, duals: Matrix3) -> Any:
    """Return the log odds for light k, positive for light, of a length `ratio` times the albedo around.

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
    found = _COMPARISON * expected * (expected - 2.0 * excess) - _MISFIT * excess * excess
    return min(max(found, -_MOST_FROM_ALBEDO), _MOST_FROM_ALBEDO)


@njit(forceinline=True)
def _log(ratio: Any) -> Any:
    return min(max(np.log(max(ratio, _SMALLEST_RATIO)), -_LARGEST_EXCESS), _LARGEST_EXCESS)

"""Log odds of each light, from what a pixel returns under every set of lights that may reach it.

A cosine is a light's contribution over its strength and the albedo around: 1 where the surface faces it.

- A light that arrives returns what the surface predicts, times the pixel's own albedo over that around. The
  surface may be wrong by any angle: Cauchy's likelihood.
- A light that does not arrive leaves what other surfaces send into its shadow, never less than nothing: next
  to none on a lone figure in a dark studio, a tenth in the folds of a white statue. Exponential, with the
  mean of the frame's own cosines in shadow. Camera noise widens both, the more the darker the paint.
- The logarithm of the pixel's own albedo has Cauchy's likelihood: where all three lights are weak alike, it
  is paint.

Each of the eight sets of lights takes the albedo that explains it best. The odds of a light compare the best
set with it and the best without.
"""

from typing import Any

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import BoolArray, FloatArray, Mask
from vntoolkit.native import njit
from vntoolkit.shadows.contributions import flat

SURFACE_NOISE = 0.08  # of a cosine that is predicted: what the surface's model leaves out
_CONTRIBUTION_NOISE = np.float32(0.008)  # standard deviation, full scale = 1
_DARKEST = np.float32(0.02)  # albedo
_PAINT = np.float32(1.0)  # scale of the log albedo at a pixel, about that around: black hair on white skin
_STRONGEST = np.float32(4.0)  # log odds: whatever they say, four neighbours together may say more
_UNKNOWN_STRAY, _FEWEST_DARK = 0.02, 20  # mean cosine in shadow where fewer pixels tell it
_BRIGHT = np.float32(12.0)  # scales of stray light: what is brighter outweighs any error of the surface


def mean_dark_cosine(cosines: FloatArray, lit: BoolArray, mask: Mask) -> float:
    """Return the mean cosine where a light does not arrive, away from the edges of its shadow.

    cosines, lit: (h, w, 3).
    """
    dark = (~lit & mask[..., None]).astype(np.uint8)
    values = cosines[cv2.erode(dark, np.ones((3, 3), np.uint8)) > 0]
    return float(np.maximum(values, 0.0).mean()) if len(values) >= _FEWEST_DARK else _UNKNOWN_STRAY


def log_odds(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask, stray: float
) -> FloatArray:
    """Return (3, h, w), positive where light k arrives.

    cosines, predicted: (h, w, 3), measured, and of the surface. albedo: (h, w). stray: mean cosine in shadow.
    """
    out: FloatArray = np.full((3, *mask.shape), _STRONGEST, np.float32)
    _odds_kernel(
        flat(cosines), flat(predicted), np.ascontiguousarray(albedo, np.float32), mask, np.float32(stray), out
    )
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _odds_kernel(
    cosines: FloatArray, predicted: FloatArray, albedo: FloatArray, mask: Mask, stray: Any, out: FloatArray
) -> None:
    h, w = mask.shape
    for v in prange(h):
        seen, dark = np.empty(3, np.float32), np.empty(3, np.float32)
        surface, best = np.empty(3, np.float32), np.empty((3, 2), np.float32)
        for u in range(w):
            noise = _CONTRIBUTION_NOISE / max(albedo[v, u], _DARKEST)
            scale = np.sqrt(stray * stray + noise * noise)
            variance = np.float32(SURFACE_NOISE * SURFACE_NOISE) + noise * noise
            seen[:], surface[:] = cosines[v, 3 * u : 3 * u + 3], predicted[v, 3 * u : 3 * u + 3]
            if not mask[v, u] or seen.min() > _BRIGHT * scale:
                continue
            for k in range(3):
                surface[k] = max(surface[k], np.float32(0.0))
                dark[k] = np.exp(-max(seen[k], np.float32(0.0)) / scale) / (np.float32(2.0) * scale)
            best[:] = 0.0
            for label in range(8):
                likely = _likelihood(label, seen, surface, dark, variance)
                for k in range(3):
                    arrives = (label >> k) & 1
                    best[k, arrives] = max(best[k, arrives], likely)
            for k in range(3):
                out[k, v, u] = min(max(np.log(best[k, 1] / best[k, 0]), -_STRONGEST), _STRONGEST)


@njit(cache=True, error_model="numpy")
def _likelihood(label: int, seen: FloatArray, surface: FloatArray, dark: FloatArray, variance: Any) -> Any:
    """Return how likely the cosines (3,) are if just the lights of a label arrive."""
    precision = np.float32(1.0) / (_PAINT * _PAINT)
    along = squared = precision
    for k in range(3):
        if (label >> k) & 1:
            along += seen[k] * surface[k] / variance
            squared += surface[k] * surface[k] / variance
    ratio = max(along / squared, np.float32(1e-2))
    paint = np.log(ratio)
    likely = np.float32(1.0) / (np.float32(1.0) + paint * paint * precision)
    for k in range(3):
        if (label >> k) & 1:
            rest = seen[k] - ratio * surface[k]
            likely *= np.sqrt(variance) / (np.float32(np.pi) * (variance + rest * rest))
        else:
            likely *= dark[k]
    return likely

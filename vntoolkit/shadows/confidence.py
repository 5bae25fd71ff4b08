"""How far each pixel's normal may be trusted: saturation, shadow, gloss, an albedo that does not fit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels, Weight
from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput
from vntoolkit.photometry.frame import count_lit

_SMALLEST_ALBEDO = 1e-3


@dataclass(frozen=True, kw_only=True)
class ConfidenceOptions:
    """by_lights: weight of a pixel that 0, 1, 2, 3 lights reach.

    clipped: factor on saturated pixels. albedo_tolerance: departure of a lit pixel's log albedo from its
    surroundings that halves its weight. gloss: excess of log albedo that a lit pixel's colour is allowed
    before it counts as a highlight; twice that halves the trust in the colour.
    """

    by_lights: tuple[float, float, float, float] = (0.05, 0.2, 0.5, 1.0)
    clipped: float = 0.1
    albedo_tolerance: float = 0.4
    gloss: float = 0.2

    def __post_init__(self) -> None:
        for weight in (*self.by_lights, self.clipped):
            require_in_range(weight, 0.0, 1.0, "confidence weight")
        if not (0 < self.albedo_tolerance < np.inf and 0 < self.gloss < np.inf):
            raise BadInput("confidence: albedo tolerance and gloss must be positive")


def confidence_weight(
    labels: VisibilityLabels,
    clipped: Mask,
    length: FloatArray,
    albedo: FloatArray,
    agreement: FloatArray | None,
    options: ConfidenceOptions | None = None,
) -> Weight:
    """Return (h, w) weights from 0 to 1.

    length: (h, w), the albedo if all lights arrive; albedo: (h, w), the surroundings'. agreement: (h, w), of
    colour and depth, 0 where unknown, or None.
    """
    options = options or ConfidenceOptions()
    lights = count_lit(labels)
    weight = np.asarray(options.by_lights, dtype=np.float32)[lights]
    full = lights == 3
    departure = _log_excess(length, albedo) / options.albedo_tolerance
    weight = weight * np.where(full, 1.0 / (1.0 + departure**2), 1.0)
    if agreement is not None:
        weight = weight * np.where(full & (agreement > 0.0), np.maximum(agreement, 0.1), 1.0)
    return (weight * np.where(clipped, options.clipped, 1.0)).astype(np.float32)


def gloss_trust(
    length: FloatArray, albedo: FloatArray, lit: Mask, options: ConfidenceOptions | None = None
) -> Weight:
    """Return (h, w): 1, less where a pixel of `lit` outshines matte paint of the surrounding albedo."""
    options = options or ConfidenceOptions()
    excess = np.maximum(_log_excess(length, albedo) - options.gloss, 0.0) / options.gloss
    return np.where(lit, 1.0 / (1.0 + excess**2), 1.0).astype(np.float32)


def _log_excess(length: FloatArray, albedo: FloatArray) -> FloatArray:
    return np.log(np.maximum(length, _SMALLEST_ALBEDO) / np.maximum(albedo, _SMALLEST_ALBEDO))

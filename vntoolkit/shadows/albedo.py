"""Albedo under shadows: slowly varying, read where all three lights arrive, continued where they do not."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_in_range, require_positive
from vntoolkit.shadows.filling import fill_smoothly

_DARKEST = 1e-3  # of the albedo scale; keeps the logarithm finite


@dataclass(frozen=True, kw_only=True)
class AlbedoOptions:
    """How the albedo is estimated.

    finest_level: detail below 2**finest_level pixels counts as shading, not as paint. outlier: departure of a
    pixel's log albedo from its surroundings at which it counts half. rounds: number of reweightings.
    margin_px: lit pixels this close to a shadow's edge do not count, as penumbra darkens them.
    """

    finest_level: int = 3
    outlier: float = 0.3
    rounds: int = 2
    margin_px: int = 1

    def __post_init__(self) -> None:
        require_in_range(self.finest_level, 0, 30, "albedo: finest level")
        require_positive(self.outlier, "albedo: outlier")
        require_in_range(self.rounds, 0, 1000, "albedo: rounds")
        require_in_range(self.margin_px, 0, 100, "albedo: margin in pixels")


def albedo_from_lit(length: FloatArray, lit: Mask, options: AlbedoOptions | None = None) -> FloatArray:
    """Spread the albedo of fully lit pixels over the image.

    length: (h, w), `LightShares.length`, which is the albedo where all three lights arrive (`lit`). Returns
    (h, w), positive everywhere; 1, the calibration material's, where nothing is lit.
    """
    options = options or AlbedoOptions()
    side = 2 * options.margin_px + 1
    core = cv2.erode(lit.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    if not core.any():
        core = lit
    logarithm = np.log(np.maximum(length, _DARKEST))
    trust = core.astype(np.float32)
    if not core.any():
        return np.ones_like(logarithm, dtype=np.float32)
    filled = fill_smoothly(logarithm, trust, options.finest_level)
    for _ in range(options.rounds):
        trust = core / (1.0 + ((logarithm - filled) / options.outlier) ** 2)
        filled = fill_smoothly(logarithm, trust, options.finest_level)
    return np.exp(filled)

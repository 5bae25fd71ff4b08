"""Shares as sharp as the shadows that made them: a lens's blur and a Bayer pattern's undone in part.

Blur carries light across the edge of a shadow and into shadows a few pixels wide, so that no level
of brightness separates the two. An unsharp mask gives most of it back, and noise with it, which a median over
the nearest neighbours takes out again without rounding the edges off.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_in_range

_MEDIAN_PX = 3


@dataclass(frozen=True, kw_only=True)
class SharpeningOptions:
    """How blur is undone.

    amount: part of the difference to the blurred image that is added, 0 for none. radius_px: standard
    deviation of that blur, about the camera's own, pixels. inset_px: pixels this close to the outline stay as
    they are, since they are mixed with the backdrop.
    """

    amount: float = 1.2
    radius_px: float = 0.87
    inset_px: float = 3.2

    def __post_init__(self) -> None:
        require_in_range(self.amount, 0.0, 10.0, "sharpening: amount")
        require_in_range(self.radius_px, 0.1, 50.0, "sharpening: radius in pixels")
        require_in_range(self.inset_px, 0.0, 1000.0, "sharpening: inset in pixels")


def sharpened_shares(shares: FloatArray, mask: Mask, options: SharpeningOptions | None = None) -> FloatArray:
    """Return shares (h, w, 3), float32, sharpened inside `mask` (h, w) and as they were outside."""
    options = options or SharpeningOptions()
    given: FloatArray = np.asarray(shares, dtype=np.float32)
    blurred = cv2.GaussianBlur(given, (0, 0), options.radius_px)
    inset = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    inner = (inset > options.inset_px)[..., None]
    sharp = np.where(inner, given + np.float32(options.amount) * (given - blurred), given)
    return np.where(mask[..., None], cv2.medianBlur(sharp, _MEDIAN_PX), given)

"""Where a cast shadow ends: at the pixel that less than half of the light reaches.

Blur carries light across the edge of a shadow, so that the pixels just inside it are far brighter than a
shadow is. The edge lies where half of what arrives outside is left. That holds where something else blocks
the light; where the surface itself turns from it, light fades on both sides and the half means nothing.
"""

import cv2
import numpy as np

from vntoolkit.arrays import BoolArray, FloatArray, Mask

_REACH_PX = 2  # how far nearby is: a blur of 0.9 pixels is over by then
_CAST_FACING = 0.2  # predicted cosine from which a shadow counts as cast
_FAINTEST = 0.22  # largest cosine nearby from which there is an edge to judge

_SHARPENING = 0.6  # part of the difference to the blurred image that is added
_BLUR_PX = 0.87  # standard deviation, about that of a lens with a Bayer pattern


def lit_beyond_half(lit: BoolArray, cosines: FloatArray, predicted: FloatArray, mask: Mask) -> BoolArray:
    """Return (h, w, 3), the lights of which more than half arrives beside a cast shadow.

    lit: (h, w, 3), lights that arrive anyhow. cosines, predicted: (h, w, 3), measured, and of the surface.
    """
    beside, nearby = np.ones((3, 3), np.uint8), np.ones((2 * _REACH_PX + 1,) * 2, np.uint8)
    inside = mask[..., None]
    cast = (~lit & inside & (predicted > _CAST_FACING)).astype(np.uint8)
    brightest = cv2.dilate(np.where(lit & inside, cosines, np.float32(0.0)), nearby)
    below = (cosines < 0.5 * brightest) & (brightest > _FAINTEST) & (cv2.dilate(cast, beside) > 0)
    return lit & ~(below & inside)


def sharpened(cosines: FloatArray, mask: Mask) -> FloatArray:
    """Return cosines (h, w, 3) with blur undone in part, but for the backdrop's beside the outline.

    The median of nine takes the noise back out.
    """
    size = 2 * round(3.0 * _BLUR_PX) + 1
    blurred = cv2.GaussianBlur(cosines, (size, size), _BLUR_PX)
    sharp = cv2.medianBlur(cosines + np.float32(_SHARPENING) * (cosines - blurred), 3)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((size, size), np.uint8)) > 0
    return np.where(inner[..., None], sharp, cosines)

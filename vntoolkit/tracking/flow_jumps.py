"""Steps in the weight of a normal map: edges in the image that are not fixed to the surface.

The weight tells how well a colour fits the material under all three lights. Where a shadow or a gloss ends
it jumps, and with it the normals, by tens of degrees: the strongest feature of a smooth neck is the edge of
the chin's shadow. It moves with what casts it, and what is registered by it is dragged along.

Where the surface around has strong relief of its own, such as a knit, a jump is left in: there it is the
edge of a fold as often as that of a shadow, and the relief outvotes it.

Measured over 1000 frames reconstructed without shadow detection, the mean of the 95 % error at every 50th:
simulated face 10.6 px with jumps in (and nothing said to lie still), 5.5 px without, 4.8 px without those on
strong relief too; simulated sweater 3.8, 3.6 and 3.9 px.
"""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.geometry.maps import NormalMap

_SMOOTHING_PX = 1.5
_WINDOW_PX = 5
_RATIO = 1.8  # of the greatest weight in the window to the least
_DARK = 0.05  # added to both: below it all weights mean the same
_RELIEF_PX, _AROUND_PX = 9, 17  # windows: what counts as relief, and over how far it is averaged
_STRONG_RELIEF = 0.1  # root mean square, in units of the normal: a knit has 0.12 to 0.17, skin 0.03 to 0.1


def jump_pixels(normal_map: NormalMap) -> Mask:
    """Return (h, w) True around jumps of the weight; nowhere for a map without weights."""
    mask = normal_map.mask
    if normal_map.weight is None:
        return np.zeros_like(mask)
    inside = mask.astype(np.float32)
    size = (0, 0)
    total = cv2.GaussianBlur(normal_map.weight.astype(np.float32) * inside, size, _SMOOTHING_PX)
    weight = _DARK + total / np.maximum(cv2.GaussianBlur(inside, size, _SMOOTHING_PX), 1e-3)
    window = np.ones((_WINDOW_PX, _WINDOW_PX), dtype=np.uint8)
    greatest = cv2.dilate(np.where(mask, weight, np.float32(0)), window)
    least = cv2.erode(np.where(mask, weight, weight.max()), window)
    jumps = np.asarray(mask & (greatest > _RATIO * least))
    return jumps & ~_strong_relief(normal_map, mask & ~jumps)


def _strong_relief(normal_map: NormalMap, even: Mask) -> Mask:
    """Where the surface around, as far as its weight is `even`, has relief enough to be registered by."""
    inside = even.astype(np.float32)
    normals = normal_map.normals_in_camera * inside[..., None]
    share = np.maximum(_mean(inside, _RELIEF_PX), 1e-3)
    relief = np.square(normals - (_mean(normals, _RELIEF_PX) / share[..., None]) * inside[..., None]).sum(
        axis=2
    )
    power = _mean(relief, _AROUND_PX) / np.maximum(_mean(inside, _AROUND_PX), 1e-3)
    return np.asarray(power > _STRONG_RELIEF**2)


def _mean(image: FloatArray, window_px: int) -> FloatArray:
    return np.asarray(cv2.blur(image, (window_px, window_px)))

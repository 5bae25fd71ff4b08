"""Where a cast shadow ends: at the pixel that less than half of the light reaches.

Blur carries light across the edge of a shadow, so that the pixels just inside it are far brighter than a
shadow is. The edge lies where half of what arrives outside is left. That holds where something else blocks
the light; where the surface itself turns from it, light fades on both sides and the half means nothing.
"""

import numpy as np
from numba import prange

from vntoolkit.arrays import ByteArray, FloatArray, Mask, VisibilityLabels
from vntoolkit.native import njit
from vntoolkit.photometry.frame import ALL_LIT

_PART = 0.45  # of the largest cosine nearby, below which a pixel beside the shadow joins it: half, less noise
_REACH_PX = 2  # how far nearby is: a blur of 0.9 pixels is over by then
_FAINTEST = 0.22  # largest cosine nearby from which there is an edge to judge


def labels_beyond_half(
    labels: VisibilityLabels, cosines: FloatArray, facing: ByteArray, mask: Mask
) -> VisibilityLabels:
    """Return labels (h, w) without the lights of which less than half arrives beside a cast shadow.

    cosines: (h, w, 3), measured. facing: (h, w), bit k set where the surface faces light k, so that its
    shadow is cast. mask: (h, w), holds all shadows and the pixels around them.
    """
    out: VisibilityLabels = np.array(labels)
    shadow = ((ALL_LIT - labels) & facing * mask).astype(np.uint8)
    _part_kernel(labels, shadow, cosines, mask, mask, _PART, _REACH_PX, _FAINTEST, out)
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _part_kernel(
    labels: VisibilityLabels, shadow: ByteArray, cosines: FloatArray, mask: Mask, near: Mask,
    part: float, reach: int, faintest: float, out: VisibilityLabels,
) -> None:  # fmt: skip
    """shadow: (h, w), bit k set where a shadow of light k counts, 0 outside the mask; reach: in pixels."""
    h, w = mask.shape
    for v in prange(h):
        above, below, column = max(v - 1, 0), min(v + 1, h - 1), np.zeros(w + 2, np.uint8)
        for u in range(w):
            column[u + 1] = shadow[above, u] | shadow[v, u] | shadow[below, u]
        for u in range(w):
            beside = (column[u] | column[u + 1] | column[u + 2]) & labels[v, u]
            if beside == 0 or not near[v, u] or not mask[v, u]:
                continue
            for k in range(3):
                if (beside >> k) & 1 == 0:
                    continue
                brightest = np.float32(0.0)
                for y in range(max(v - reach, 0), min(v + reach + 1, h)):
                    for x in range(max(u - reach, 0), min(u + reach + 1, w)):
                        if mask[y, x] and (labels[y, x] >> k) & 1 == 1:
                            brightest = max(brightest, cosines[y, x, k])
                if brightest > faintest and cosines[v, u, k] < part * brightest:
                    out[v, u] &= np.uint8(7 - (1 << k))

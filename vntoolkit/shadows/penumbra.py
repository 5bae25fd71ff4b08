"""Half-shadow: lit pixels at the edge of a cast shadow that a light reaches only in part.

Lamps have a size, lenses blur and Bayer patterns mix: beside the edge some of the light is missing, and what
arrives is not the cosine. There the normal is better found without that light.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.checks import require_in_range
from vntoolkit.photometry.frame import ALL_LIT, labels_from_lit, lit_from_labels


@dataclass(frozen=True, kw_only=True)
class PenumbraOptions:
    """What counts as half-shadow.

    part: a lit pixel beside a light's shadow lies in half-shadow where it returns less than this part of
    that light's largest share nearby. reach_px: how far nearby is, pixels. faintest: largest share from which
    an edge can be a cast shadow's; where a surface turns away from the light, less arrives on both sides.
    """

    part: float = 0.75
    reach_px: int = 2
    faintest: float = 0.4

    def __post_init__(self) -> None:
        require_in_range(self.part, 0.0, 1.0, "penumbra: part")
        require_in_range(self.reach_px, 1, 50, "penumbra: reach in pixels")
        require_in_range(self.faintest, -1.0, 1.0, "penumbra: faintest")


def labels_without_penumbra(
    labels: VisibilityLabels, relative: FloatArray, mask: Mask, options: PenumbraOptions | None = None
) -> VisibilityLabels:
    """Count each light as missing where it arrives in part.

    labels: (h, w), bit k set where light k arrives. relative: (h, w, 3), contributions over the albedo.
    Returns labels (h, w), 7 outside `mask`.
    """
    options = options or PenumbraOptions()
    whole = lit_from_labels(labels) | ~mask[..., None]
    for k in range(3):
        lit = whole[..., k].copy()
        whole[..., k] &= ~partly_lit(
            lit & mask, ~lit, relative[..., k], options.part, options.reach_px, options.faintest
        )
    return np.where(mask, labels_from_lit(whole), ALL_LIT).astype(np.uint8)


def partly_lit(
    lit: Mask, shadow: Mask, share: FloatArray, part: float, reach_px: int, faintest: float
) -> Mask:
    """Return (h, w): pixels of `lit` beside `shadow` with less than `part` of the largest share nearby.

    share: (h, w), what comes back of one light over the albedo. reach_px: how far nearby is. faintest: the
    largest share nearby must be more than this.
    """
    beside = cv2.dilate(shadow.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    share = np.where(lit, share, 0.0).astype(np.float32)
    brightest = cv2.dilate(share, np.ones((2 * reach_px + 1,) * 2, np.uint8))
    return np.asarray(lit & beside & (brightest > faintest) & (share < part * brightest))

"""Where a cast shadow ends: at the pixel that less than half of the light reaches.

Blur carries light across the edge of a shadow, so that the pixels just inside it are far brighter than a
shadow is. The edge lies where half of what arrives outside is left. That holds where something else blocks
the light; where the surface itself turns from it, light fades on both sides and the half means nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_in_range
from vntoolkit.shadows.penumbra import partly_lit

Lit = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class CastEdgeOptions:
    """Which pixels beside a cast shadow belong to it; shares are 1 where a surface faces the light.

    part: a pixel beside the shadow joins it with less than this part of the light's largest share nearby; 0
    for none. reach_px: how far nearby is, pixels. facing: predicted share from which a shadow counts as cast.
    faintest: the largest share nearby must be more than this.
    """

    part: float = 0.45
    reach_px: int = 2
    facing: float = 0.2
    faintest: float = 0.22

    def __post_init__(self) -> None:
        require_in_range(self.part, 0.0, 1.0, "cast shadow's edge: part")
        require_in_range(self.reach_px, 1, 50, "cast shadow's edge: reach in pixels")
        require_in_range(self.facing, -1.0, 1.0, "cast shadow's edge: facing")
        require_in_range(self.faintest, -1.0, 1.0, "cast shadow's edge: faintest")


def lit_beyond_half(
    lit: Lit, shares: FloatArray, predicted: FloatArray, mask: Mask, options: CastEdgeOptions | None = None
) -> Lit:
    """Return `lit` (h, w, 3) without the pixels beside a cast shadow that less than half the light reaches.

    shares, predicted: (h, w, 3), measured and to be expected where the light arrives.
    """
    options = options or CastEdgeOptions()
    out = lit.copy()
    for k in range(3):
        cast = mask & ~lit[..., k] & (predicted[..., k] > options.facing)
        out[..., k] &= ~partly_lit(
            lit[..., k] & mask, cast, shares[..., k], options.part, options.reach_px, options.faintest
        )
    return out

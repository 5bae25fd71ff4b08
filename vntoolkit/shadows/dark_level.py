"""How much of a light a pixel may seem to return although the light does not reach it.

Other surfaces send some light into every shadow: next to nothing on a lone figure in a dark studio, a tenth
of the lamp in the folds of a white statue. The frame itself says how much, where a light is predicted and
all but missing. Camera noise adds to it, the more the darker the paint.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput

_SMALLEST_ALBEDO = 0.02
_SMALLEST_SHARE = 1e-6
_UNKNOWN_SPREAD = 0.02


@dataclass(frozen=True, kw_only=True)
class DarkLevelOptions:
    """Shares are 1 where a surface of the local albedo faces the light.

    ratio: a light is missing where less than this part of its predicted share is measured, within two
    bounds; where less than turning_share is predicted, that part falls towards 0 with the prediction, as a
    surface that turns from the light fades without being shadowed. margin: even where less is predicted, it
    is missing below the frame's typical share in shadow plus this. most_times, most_margin, most_spreads:
    however much is predicted, it is not missing above the typical share times most_times, plus most_margin,
    plus most_spreads times the spread of shares in shadow (from their tenth to their fiftieth percentile).
    noise: standard deviation of a contribution, full scale = 1; both bounds rise by it over the albedo.
    predicted_share, fewest: at least `fewest` pixels predicted to have more than predicted_share must be
    missing, or the typical share in shadow counts as 0 and the spread as 0.02.
    """

    ratio: float = 0.5
    turning_share: float = 0.3
    margin: float = 0.015
    most_times: float = 3.0
    most_margin: float = 0.015
    most_spreads: float = 1.3
    noise: float = 0.008
    predicted_share: float = 0.4
    fewest: int = 50

    def __post_init__(self) -> None:
        require_in_range(self.ratio, 0.0, 1.0, "dark level: ratio")
        require_in_range(self.turning_share, 0.0, 1.0, "dark level: turning share")
        for value in (self.margin, self.most_times, self.most_margin, self.most_spreads, self.noise):
            if not 0 <= value < np.inf:
                raise BadInput("dark level: margins, factor and noise must not be negative")
        require_in_range(self.predicted_share, 0.0, 1.0, "dark level: predicted share")
        require_in_range(self.fewest, 1, 1e9, "dark level: fewest")


def largest_dark_share(
    shares: FloatArray,
    predicted: FloatArray,
    albedo: FloatArray,
    mask: Mask,
    options: DarkLevelOptions | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return per light the share (h, w, 3) below which it is missing, and the noise of a share (h, w, 1).

    shares, predicted: (h, w, 3), measured and to be expected where the light arrives. albedo: (h, w).
    """
    options = options or DarkLevelOptions()
    grain = options.noise / np.maximum(albedo, _SMALLEST_ALBEDO)[..., None]
    missing = mask[..., None] & (predicted > options.predicted_share) & (shares < options.ratio * predicted)
    typical, spread = _typical_share(shares - grain, missing, options.fewest)
    least = typical + options.margin + grain
    most = options.most_times * typical + options.most_margin + options.most_spreads * spread + grain
    part = options.ratio * np.clip(predicted / max(options.turning_share, _SMALLEST_SHARE), 0.0, 1.0)
    return np.clip(part * predicted, least, np.maximum(least, most)), grain


def _typical_share(shares: FloatArray, missing: Mask, fewest: int) -> tuple[float, float]:
    """The median share of a missing light, and its spread: the least of the three lights'.

    Stray light favours none. A part whose surface is predicted wrongly makes one light look missing there
    that is not, and would raise the level for itself; it seldom does so for all three.
    """
    found = [shares[..., k][missing[..., k]] for k in range(3)]
    levels = [np.percentile(values, (10, 50)) for values in found if len(values) >= fewest]
    if not levels:
        return 0.0, _UNKNOWN_SPREAD
    typical = max(0.0, float(min(level[1] for level in levels)))
    return typical, float(min(level[1] - level[0] for level in levels))

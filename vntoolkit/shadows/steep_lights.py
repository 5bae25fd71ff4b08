"""Colour before depth where all three lights meet the surface steeply.

A light that grazes the surface says little of its direction: noise, gloss and light from other surfaces are
large beside it, and the depth around knows better. Where none grazes, plain inversion is as exact as
it gets, and the depth, whose slopes are differences between pixels, takes detail away and brings in errors
from shadows nearby.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Normals
from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput
from vntoolkit.shadows.lengths import lengths_of


@dataclass(frozen=True, kw_only=True)
class SteepLightOptions:
    """Between which cosines, of the most grazing light to a lit pixel's normal from colour alone, that normal
    takes over from the one solved with the depth.

    nothing: below it the solved normal stays. everything: from it on, only the colour counts.
    """

    nothing: float = 0.6
    everything: float = 0.8

    def __post_init__(self) -> None:
        require_in_range(self.nothing, -1.0, 2.0, "steep lights: nothing")
        if not self.everything > self.nothing:
            raise BadInput("steep lights: everything must be larger than nothing")


def normals_by_steep_lights(
    solved: Normals,
    inverted: Normals,
    directions: FloatArray,
    lit: Mask,
    options: SteepLightOptions | None = None,
) -> Normals:
    """Blend two maps of normals (h, w, 3) in the pixels of `lit`, which all three lights reach.

    solved: with the depth. inverted: from colour alone. directions: (3, 3), a unit row per light.
    """
    options = options or SteepLightOptions()
    most_grazing = np.full(lit.shape, np.inf, dtype=np.float32)
    for direction in directions.astype(np.float32):
        most_grazing = np.minimum(most_grazing, inverted @ direction)
    share = np.clip((most_grazing - options.nothing) / (options.everything - options.nothing), 0.0, 1.0)
    share = np.where(lit, share, 0.0)[..., None]
    mixed = share * inverted + (1.0 - share) * solved
    return mixed / np.maximum(lengths_of(mixed), np.float32(1e-6))

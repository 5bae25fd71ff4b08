"""The lamps of a scene: positions and spectra."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray, Points, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.simulation.spectra import WAVELENGTHS_NM, white_lamp

MOST_LIGHTS = 3  # a visibility label has one bit for each of three lights


class Lighting(Enum):
    """Which lamps are on: the coloured ones, all or one alone, or a white lamp at one of the three places."""

    COLOURED = "coloured"
    RED = "red"
    GREEN = "green"
    BLUE = "blue"
    WHITE_1 = "white-1"
    WHITE_2 = "white-2"
    WHITE_3 = "white-3"


_ALONE = (Lighting.RED, Lighting.GREEN, Lighting.BLUE)


@dataclass(frozen=True, kw_only=True, eq=False)
class Lights:
    """Point lights and an ambient glow.

    positions: (k, 3) metres in the camera frame. spectra: (k, λ) relative power S_k(λ) at the scene's
    centre, on `WAVELENGTHS_NM`. ambient_spectrum: (λ,) on the same scale; it reaches every surface point
    alike, whatever its normal. bits: the bit of each light in a visibility label, default 0, 1, 2.
    """

    positions: Points
    spectra: FloatArray
    ambient_spectrum: FloatArray
    bits: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        count = len(self.positions)
        if not 1 <= count <= MOST_LIGHTS:
            raise BadInput(f"lights: expected 1 to {MOST_LIGHTS} of them, got {count}")
        shapes = {
            "positions": (count, 3),
            "spectra": (count, len(WAVELENGTHS_NM)),
            "ambient_spectrum": (len(WAVELENGTHS_NM),),
        }
        for name, shape in shapes.items():
            values = np.array(getattr(self, name), dtype=np.float64)
            require_shape(values, shape, f"lights: {name}")
            require_finite(values, f"lights: {name}")
            object.__setattr__(self, name, read_only(values))
        if self.spectra.min() < 0 or self.ambient_spectrum.min() < 0:
            raise BadInput("lights: expected spectra without negative power")
        object.__setattr__(self, "bits", self.bits or tuple(range(count)))

    def __len__(self) -> int:
        return len(self.positions)

    def under(self, lighting: Lighting) -> Lights:
        """Return these lights, one of them alone, or one of their places with a white lamp (Figure 6)."""
        if lighting is Lighting.COLOURED:
            return self
        if lighting in _ALONE:
            on = np.arange(len(self)) == _ALONE.index(lighting)
            return replace(self, spectra=self.spectra * on[:, None])
        place = int(lighting.value[-1]) - 1
        if place >= len(self):
            raise BadInput(f"lighting {lighting.value}: the scene has {len(self)} lights")
        return Lights(
            positions=self.positions[place : place + 1],
            spectra=white_lamp()[None],
            ambient_spectrum=self.ambient_spectrum,
            bits=(place,),
        )

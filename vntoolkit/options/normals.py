"""How colours become normals, and how shadows are found and filled."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.options.base import Limit, Named, Options, named, positive


class ClippedPixels(Enum):
    """How pixels with a saturated channel are treated."""

    DOWNWEIGHT = "downweight"  # a normal stays, at a tenth of its weight, so that the domain has no hole
    EXCLUDE = "exclude"


@dataclass(frozen=True, kw_only=True)
class InversionOptions(Options):
    """How colours become normals."""

    relative_albedo: Annotated[float, positive()] = 1.0
    """Expected length of M⁻¹(r − a), the surface's albedo over the calibration material's (1 if it is the
    same material; `relative_albedo_from_frame` measures it)."""
    darkest: Annotated[float, Limit("a share between 0 and 1", lambda share: 0 < share < 1)] = 0.05
    """Share of the expected albedo below which a pixel is black and has no normal."""
    clipped: Named[ClippedPixels, Literal["downweight", "exclude"]] = named(ClippedPixels.DOWNWEIGHT)
    """What becomes of saturated pixels."""

    @property
    def clipped_factor(self) -> float:
        """The factor on a clipped pixel's weight; 0 excludes it."""
        return 0.1 if self.clipped is ClippedPixels.DOWNWEIGHT else 0.0


class ShadowMethod(Enum):
    """How self-shadows are found."""

    NONE = "none"  # every pixel counts as lit by all three lights
    PUBLISHED = "published"  # edges and flood fill, brostow2011
    ROBUST = "robust"  # comparison with a surface, graph cut


ShadowMethodName: TypeAlias = Literal["none", "published", "robust"]


class RecoveryMethod(Enum):
    """How normals are found where a light is missing."""

    INVERSION = "inversion"  # as if all three lights arrived: the baseline
    TWO_LIGHTS = "two-lights"  # Onn and Bruckstein's quadratic pixel by pixel, smooth fill elsewhere
    SURFACE = "surface"  # solved together with the depth, Hernández, Vogiatzis and Cipolla

"""How footage is read, and which part of it is the subject."""

import math
from dataclasses import dataclass
from enum import Enum
from typing import Literal, TypeAlias

from vntoolkit.checks import require_in_range
from vntoolkit.errors import BadInput
from vntoolkit.options.base import Named, Options, named


@dataclass(frozen=True, kw_only=True)
class PictureLimits(Options):
    """The largest pictures that are read."""

    max_megapixels: float = 200.0
    """Largest image or frame that is read, in million pixels. A larger one is refused before memory is
    reserved."""

    def _require_valid(self) -> None:
        """Refuse limits that would let everything in, or nothing."""
        if not self.max_megapixels > 0 or math.isinf(self.max_megapixels):
            raise BadInput(
                f"--max-megapixels: expected a number above 0, such as 400, got {self.max_megapixels:g}"
            )


@dataclass(frozen=True, kw_only=True)
class MeshLimits(Options):
    """The largest meshes that are read."""

    max_vertices: int = 20_000_000
    """Meshes and point clouds with more vertices are refused. So are files that are too long for that
    many."""

    def _require_valid(self) -> None:
        if self.max_vertices < 1:
            raise BadInput(
                f"--max-vertices: expected a whole number above 0, such as 50000000, got {self.max_vertices}"
            )


@dataclass(frozen=True, kw_only=True)
class ReadingLimits(PictureLimits, MeshLimits):
    """The largest files that are read."""


class Gaps(Enum):
    """What is done where numbers of an image sequence are missing."""

    REFUSE = "refuse"
    SKIP = "skip"


GapsName: TypeAlias = Literal["refuse", "skip"]


class Bayer(Enum):
    """The colours of the top left 2×2 pixels, row by row; GenICam's BayerRG is rggb, and so on."""

    RGGB = "rggb"
    BGGR = "bggr"
    GRBG = "grbg"
    GBRG = "gbrg"


class Demosaic(Enum):
    """How the two missing colours of a pixel are found."""

    # Assumes nothing about how the channels go together; under lamps of three colours they do not.
    BILINEAR = "bilinear"
    EDGE = "edge"  # along edges: sharper where all channels share them
    HALF = "half"  # not at all: 2×2 pixels become one


@dataclass(frozen=True, kw_only=True)
class SensorOptions(Options):
    """How a sensor's own samples are read."""

    bayer: Named[Bayer | None, Literal["rggb", "bggr", "grbg", "gbrg"] | None] = named(None)
    """Colours of the top left 2×2 pixels, row by row, of frames stored as grey. Camera raw files, and files
    that state it, need none."""
    demosaic: Named[Demosaic, Literal["bilinear", "edge", "half"]] = named(Demosaic.BILINEAR)
    """How the missing colours of a Bayer mosaic are found: bilinear, edge (along edges), or half (2×2 pixels
    become one of half the picture's size)."""
    bits: int | None = None
    """Significant bits of an integer sample where the file does not tell, such as 12 for 12-bit values stored
    in 16-bit PNG."""

    def _require_valid(self) -> None:
        if self.bits is not None:
            require_in_range(self.bits, 1, 16, "capture: bits")


@dataclass(frozen=True, kw_only=True)
class MatteOptions(Options):
    """How a matte becomes a mask."""

    mask_level: float = 0.5
    """Brightness of the matte, as a share of its full scale, above which a pixel is the subject."""
    key: float | None = None
    """Difference from the background, as a share of full scale, above which a pixel is the subject. With it,
    the background is a clean plate, the set under the same lamps without the subject, and is not subtracted.
    """

    def _require_valid(self) -> None:
        require_in_range(self.mask_level, 0.0, 1.0, "mask level")
        if self.key is not None:
            require_in_range(self.key, 1e-6, 1.0, "key")

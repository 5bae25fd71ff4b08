"""How footage is read, and which part of it is the subject."""

from dataclasses import dataclass
from enum import Enum
from typing import Annotated, Literal, TypeAlias

from vntoolkit.options.base import Named, Options, named, positive, within


@dataclass(frozen=True, kw_only=True)
class PictureLimits(Options):
    """The largest pictures that are read."""

    max_megapixels: Annotated[float, positive("a number above 0, such as 400")] = 200.0
    """Largest image or frame that is read, in million pixels. A larger one is refused before memory is
    reserved."""


@dataclass(frozen=True, kw_only=True)
class MeshLimits(Options):
    """The largest meshes that are read."""

    max_vertices: Annotated[int, within(1, words="a whole number above 0, such as 50000000")] = 20_000_000
    """Meshes and point clouds with more vertices are refused. So are files that are too long for that
    many."""


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
    bits: Annotated[int | None, within(1, 16)] = None
    """Significant bits of an integer sample where the file does not tell, such as 12 for 12-bit values stored
    in 16-bit PNG."""


@dataclass(frozen=True, kw_only=True)
class MatteOptions(Options):
    """How a matte becomes a mask."""

    mask_level: Annotated[float, within(0.0, 1.0)] = 0.5
    """Brightness of the matte, as a share of its full scale, above which a pixel is the subject."""
    key: Annotated[float | None, within(1e-6, 1.0)] = None
    """Difference from the background, as a share of full scale, above which a pixel is the subject. With it,
    the background is a clean plate, the set under the same lamps without the subject, and is not subtracted.
    """

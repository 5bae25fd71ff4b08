"""An image as its file stores it: header, colours and alpha."""

from dataclasses import dataclass, field

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.io.footage.stated import Stated
from vntoolkit.options.footage import Bayer


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """How an image file stores its picture.

    format: its name. width, height: as stored, pixels; of a camera raw file as read. channels: alpha
    included. bits: per sample. chroma: subsampling (JPEG, WebP), or `Bayer`. stated: what else it states.
    mosaic_at: byte of a TIFF that states a Bayer mosaic, 0 for none. bayer: its pattern, None for none or one
    that is not stated. planar: the channels of a TIFF are stored apart. tiled: its pixels are stored in
    tiles. saturation: of a raw file's sensor.
    """

    format: str
    width: int
    height: int
    channels: int
    bits: int
    floating: bool = False
    chroma: str = "4:4:4"
    stated: Stated = field(default_factory=Stated)
    mosaic_at: int = 0
    bayer: Bayer | None = None
    planar: bool = False
    tiled: bool = False
    saturation: int | None = None

    @property
    def text(self) -> str:
        """The format in words."""
        if self.saturation is not None:
            return f"{self.format}, saturation {self.saturation}"
        return f"{self.format} {self.bits}-bit{' float' if self.floating else ''}"


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedImage:
    """Encoded values as stored: colours (h, w, 1 or 3), RGB, upright; alpha (h, w), None for none."""

    colours: Array
    alpha: Array | None
    header: ImageHeader

    @property
    def rgb(self) -> Array:
        """The colours as (h, w, 3); grey is repeated."""
        grey = self.colours.shape[2] == 1
        return np.repeat(self.colours, 3, axis=2) if grey else np.ascontiguousarray(self.colours)

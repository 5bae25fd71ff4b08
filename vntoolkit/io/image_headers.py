"""Size and sample depth of an image from its first bytes, before any pixel is decoded."""

from __future__ import annotations

import io
import logging
import struct
import zlib
from dataclasses import dataclass
from typing import Any

from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io import exr

_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
# (sampling factors of luma, number of channels): chroma's own factors are 1 × 1 in practice.
_JPEG_CHROMA = {(0x22, 3): "4:2:0", (0x21, 3): "4:2:2", (0x12, 3): "4:4:0", (0x41, 3): "4:1:1"}
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """Format name, size in pixels, channels (alpha included), bits per sample, chroma subsampling (JPEG)."""

    format: str
    width: int
    height: int
    channels: int
    bits: int
    floating: bool = False
    chroma: str = "4:4:4"


def read_image_header(data: bytes, name: str, error: type[BadInput] = BadCapture) -> ImageHeader:
    """Parse the header of a PNG, JPEG, TIFF, BMP or EXR file given as bytes; raise `error` with one line."""
    try:
        if data.startswith(_PNG):
            return _png(data, name, error)
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith(_TIFF):
            return _tiff(data, name, error)
        if data.startswith(b"BM"):
            width, height, _, bits = struct.unpack_from("<iiHH", data, 18)
            return ImageHeader(
                format="BMP", width=width, height=abs(height), channels=max(1, bits // 8), bits=8
            )
    except (struct.error, IndexError, ValueError, KeyError) as problem:
        raise error(f"{name}: the image header is damaged or cut off") from problem
    if data.startswith(exr.MAGIC):
        header = exr.read_exr_header(data, name, error)
        return ImageHeader(
            format="EXR",
            width=header.width,
            height=header.height,
            channels=len(header.channels),
            bits=32,
            floating=True,
        )
    raise error(f"{name}: is not a PNG, TIFF, JPEG, BMP or EXR image")


def _png(data: bytes, name: str, error: type[BadInput]) -> ImageHeader:
    width, height, bits, colour = struct.unpack_from(">IIBB", data, 16)
    _require_sound_chunks(data, name, error)
    return ImageHeader(
        format="PNG", width=width, height=height, channels=_PNG_CHANNELS[colour], bits=max(bits, 8)
    )


def _require_sound_chunks(data: bytes, name: str, error: type[BadInput]) -> None:
    """Check every chunk's length and CRC: libpng prints of its own what it finds, and lets some pass."""
    at, view = 8, memoryview(data)
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(view[at + 4 : end - 4]) != struct.unpack_from(">I", data, end - 4)[0]:
            raise error(f"{name}: the PNG file is damaged: the checksum at byte {at} is wrong; copy it again")
        if kind == b"IEND":
            return
        at = end
    raise error(f"{name}: the PNG file is cut off; copy or write it again")


def _jpeg(data: bytes) -> ImageHeader:
    at = 2
    while True:
        if data[at] != 0xFF:
            raise ValueError("no JPEG marker")
        marker, length = data[at + 1], struct.unpack_from(">H", data, at + 2)[0]
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            bits, height, width, channels = struct.unpack_from(">BHHB", data, at + 4)
            return ImageHeader(
                format="JPEG",
                width=width,
                height=height,
                channels=channels,
                bits=bits,
                chroma=_JPEG_CHROMA.get((data[at + 11], channels), "4:4:4"),
            )
        at += 1 if marker == 0xFF else 2 + length


def _tiff(data: bytes, name: str, error: type[BadInput]) -> ImageHeader:
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # of a damaged file the caller tells
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as tiff:
            page: Any = tiff.pages[0]
            bits = page.bitspersample
            if page.samplesperpixel > 1 and page.planarconfig != 1:  # OpenCV takes them as interleaved
                raise error(
                    f"{name}: stores its channels apart (planar), expected RGB pixel by pixel; save it so"
                )
            return ImageHeader(
                format="TIFF",
                width=int(page.imagewidth),
                height=int(page.imagelength),
                channels=int(page.samplesperpixel),
                bits=int(bits[0] if isinstance(bits, tuple) else bits),
                floating=page.sampleformat == 3,
            )
    except (tifffile.TiffFileError, AttributeError, TypeError, OverflowError) as problem:
        raise ValueError(str(problem)) from problem

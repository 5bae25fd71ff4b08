"""Single images: PNG, TIFF, JPEG, BMP, WebP by OpenCV, EXR by OpenEXR, raw by LibRaw; sizes checked first."""

import contextlib
import io
import itertools
import logging
import math
import os
import struct
import warnings
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np

from vntoolkit.arrays import Array, Float32Array, Mask
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.files import opened, require_pixels, silenced_native_output
from vntoolkit.io.footage import mosaics
from vntoolkit.io.footage.colour_profiles import bt709_from, curve_of_profile
from vntoolkit.io.footage.image_writing import in_other_order
from vntoolkit.io.footage.orientation import UPRIGHT, Orientation
from vntoolkit.io.footage.stated import (
    TRANSFER_NAMES,
    Stated,
    aspect_of_density,
    full_scale,
    require_heeded,
    require_opaque,
)
from vntoolkit.io.maps_and_meshes import exr
from vntoolkit.io.maps_and_meshes.exr import read_exr
from vntoolkit.options.footage import Bayer, SensorOptions

_LONGEST_HEADER = 32 << 20  # bytes; colour profiles and previews stand before the size in some files
_PIECE_BYTES = 1 << 20
_SHORT_CHUNK = 64  # bytes
_COUNTED = {"TIFF": "pages", "EXR": "parts or views"}
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BY_PILLOW = {"PNG": _PNG, "JPEG": b"\xff\xd8", "BMP": b"BM", "WEBP": b"RIFF"}
# TIFF and EXIF tags, and values of theirs
_SUBFILE_TYPE, _REDUCED = 254, 1
_MOST_PAGES = 64  # that are looked at; those of a damaged file may lead round in a circle
_PHOTOMETRIC, _BLACK_IS_ZERO, _MOSAIC = 262, 1, 32803
_PHOTOMETRIC_READ = (_BLACK_IS_ZERO, 2, 3, _MOSAIC)  # 2: RGB, 3: palette
_CFA_PATTERN, _ICC_PROFILE, _DNG_VERSION = 33422, 34675, 50706
_ACROSS, _DOWN = 282, 283  # pixels in a length
_BAYER_BY_CODES = {bytes("rgb".index(colour) for colour in bayer.value): bayer for bayer in Bayer}
_PHOTOMETRIC_NAMES = {
    0: "grey with white as zero", 4: "a transparency mask", 5: "CMYK", 6: "YCbCr", 8: "CIELAB", 9: "ICCLAB",
    10: "ITULAB", 32844: "LogL", 32845: "LogLuv",
}  # fmt: skip
_ORIENTATION, _EXIF_IFD, _COLOUR_SPACE, _SRGB, _FOCAL_35MM = 274, 0x8769, 0xA001, 1, 0xA405
_DIAGONAL_MM = 43.27  # of 24×36 mm
# sampling factors of luma: chroma's own are 1 × 1 in practice
_JPEG_CHROMA = {(2, 2): "4:2:0", (2, 1): "4:2:2", (1, 2): "4:4:0", (4, 1): "4:1:1"}


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedImage:
    """Encoded values as stored: colours (h, w, 1 or 3), RGB, upright; alpha (h, w), None for none."""

    colours: Array
    alpha: Array | None
    header: "ImageHeader"

    @property
    def rgb(self) -> Array:
        """The colours as (h, w, 3); grey is repeated."""
        grey = self.colours.shape[2] == 1
        return np.repeat(self.colours, 3, axis=2) if grey else np.ascontiguousarray(self.colours)


def read_image(
    path: Path | str,
    *,
    max_megapixels: float | None = None,
    sensor: SensorOptions | None = None,
    error: type[BadInput] = BadCapture,
) -> Array:
    """Read an image as (h, w, 3) RGB, encoded values as stored: uint8, uint16 or float32 (EXR, float TIFF).

    Grey is repeated in the three channels. An alpha channel is dropped where it is opaque everywhere and
    refused where it is not, since the colour beneath it is undefined. max_megapixels: None for the limit of
    `reading_limits`. sensor: how camera raw files and Bayer mosaics are read. Raises `error` with one line
    for a file that is missing, empty, damaged, too large, holds NaN or states what is not read.
    """
    sensor = sensor or SensorOptions()
    if mosaics.is_raw(path):
        return mosaics.read_raw(path, sensor.demosaic, max_megapixels=max_megapixels, error=error)[0]
    return read_opaque_image(path, max_megapixels=max_megapixels, sensor=sensor, error=error).rgb


def read_opaque_image(
    path: Path | str,
    *,
    max_megapixels: float | None = None,
    sensor: SensorOptions | None = None,
    error: type[BadInput] = BadCapture,
) -> DecodedImage:
    """Read an image that is no camera raw file, with what it states, as `read_image`."""
    image = decode_image(path, max_megapixels=max_megapixels, sensor=sensor or SensorOptions(), error=error)
    if image.alpha is not None:
        require_opaque(image.alpha, str(path), error)
    return image


def read_image_with_alpha(
    path: Path | str, *, max_megapixels: float | None = None
) -> tuple[Array, Mask | None]:
    """Read (h, w, 3) RGB and, where there is an alpha channel, the (h, w) mask of alpha >= half."""
    image = decode_image(path, max_megapixels=max_megapixels)
    return image.rgb, None if image.alpha is None else image.alpha >= full_scale(image.alpha) / 2


def decode_image(
    path: Path | str,
    *,
    max_megapixels: float | None = None,
    sensor: SensorOptions | None = None,
    error: type[BadInput] = BadInput,
) -> DecodedImage:
    """Read an image that is no camera raw file. sensor: for Bayer mosaics, or None."""
    with opened(path, error) as stream:
        header = header_of_stream(stream, str(path), error)
        require_pixels(header.width, header.height, max_megapixels, str(path), error)
        if header.format == "EXR":
            colours, alpha = _pixels_from_exr(path, header.stated, max_megapixels, error)
            return DecodedImage(colours=colours, alpha=alpha, header=header)
        stream.seek(0)
        data = stream.read()
    pixels = _samples(data, header, path, error)
    bayer = None if sensor is None else sensor.bayer or header.bayer
    if header.mosaic_at and bayer is None:
        raise error(f"{path}: is stored as a Bayer mosaic; give --bayer with its pattern, such as rggb")
    turn = header.stated.orientation
    if bayer is not None and sensor is not None:
        if pixels.ndim != 2:
            raise error(f"{path}: --bayer needs one sample a pixel, got {pixels.shape[2]}; leave it out")
        if header.format == "TIFF" and turn != UPRIGHT:  # the pattern would be turned with it
            raise error(f"{path}: is a Bayer mosaic that is to be shown turned; save it upright")
        rgb = mosaics.rgb_from_mosaic(pixels, bayer, sensor.demosaic, str(path))
        return DecodedImage(colours=turn.upright(rgb), alpha=None, header=header)
    if header.format != "TIFF":  # which OpenCV itself turns upright, and no other
        pixels = turn.upright(pixels)
    pixels = np.atleast_3d(in_other_order(pixels))
    if pixels.shape[2] in (2, 4):
        return DecodedImage(colours=pixels[..., :-1], alpha=pixels[..., -1], header=header)
    return DecodedImage(colours=pixels, alpha=None, header=header)


def _samples(data: bytes, header: "ImageHeader", path: Path | str, error: type[BadInput]) -> Array:
    """Return samples in OpenCV's order: 8 or 16 bits, whose full scale is all ones, or finite floats."""
    if header.planar or (header.floating and header.bits == 16):
        return _sound_samples(_decoded_by_tifffile(data, header, path, error), header, path, error)
    if header.mosaic_at:
        grey = struct.pack("<H" if data[:2] == b"II" else ">H", _BLACK_IS_ZERO)  # which OpenCV reads
        data = data[: header.mosaic_at] + grey + data[header.mosaic_at + 2 :]
    # a damaged file is reported by the one line below, not by OpenCV on stderr
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        with silenced_native_output():
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None and header.tiled:  # of which OpenCV 5.0 reads few
        pixels = _decoded_by_tifffile(data, header, path, error)
    if pixels is None:
        raise error(f"{path}: the {header.format} file is damaged or cut off")
    return _sound_samples(pixels, header, path, error)


def _decoded_by_tifffile(
    data: bytes, header: "ImageHeader", path: Path | str, error: type[BadInput]
) -> Array:
    """Return half floats, or channels stored apart, as OpenCV does others: upright and in its order."""
    import tifffile

    try:
        with tifffile.TiffFile(io.BytesIO(data)) as tiff:
            page: Any = tiff.pages[0]
            values: Array = page.asarray()
    except (ValueError, KeyError, TypeError, RuntimeError, OSError, struct.error) as problem:
        raise error(
            f"{path}: its samples are damaged, or compressed in a way that is not read; save them without "
            "compression"
        ) from problem
    values = np.moveaxis(values, 0, -1) if header.planar else values
    values = header.stated.orientation.upright(values)
    if values.dtype == np.float16:
        values = values.astype(np.float32)
    if values.ndim == 3 and values.shape[2] >= 3:
        values[..., :3] = values[..., 2::-1].copy()
    return values


def _sound_samples(pixels: Array, header: "ImageHeader", path: Path | str, error: type[BadInput]) -> Array:
    """Return samples of 8 or 16 bits, whose full scale is all ones, or finite floats; raise for any other."""
    if pixels.dtype == np.float64:
        pixels = pixels.astype(np.float32)
    if pixels.dtype not in (np.uint8, np.uint16, np.float32):
        raise error(f"{path}: expected 8-bit, 16-bit or float samples, got {pixels.dtype}")
    if pixels.dtype == np.uint8 and header.bits > 8:
        raise error(f"{path}: its {header.bits}-bit samples would be read as 8 bits; save it as RGB or grey")
    if pixels.dtype == np.uint16 and header.bits < 16:  # a packed TIFF, whose samples come filled with zeros
        packed = np.asarray(pixels, dtype=np.uint16)
        return packed | (packed >> np.uint16(header.bits))
    if pixels.dtype == np.float32:
        _require_numbers(pixels, path, error)
    return pixels


def _pixels_from_exr(
    path: Path | str, stated: Stated, max_megapixels: float | None, error: type[BadInput]
) -> tuple[Float32Array, Float32Array | None]:
    channels, _ = read_exr(path, max_megapixels=max_megapixels, error=error)
    names = next((kept for group in ("RGB", "YZ", "A") if (kept := [n for n in group if n in channels])), [])
    if names != ["R", "G", "B"] and len(names) != 1:
        raise error(f"{path}: expected the channels R, G, B (or Y), found {', '.join(channels)}")
    pixels = np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
    _require_numbers(pixels, path, error)
    to_bt709 = bt709_from(stated.chromaticities)
    if len(names) == 3 and to_bt709 is not None:
        pixels = pixels @ to_bt709.T.astype(np.float32)
    if "A" not in channels or names == ["A"]:
        return pixels, None
    alpha = channels["A"].astype(np.float32)
    _require_numbers(alpha, path, error)
    return pixels, alpha


def _require_numbers(pixels: Array, path: Path | str, error: type[BadInput]) -> None:
    with np.errstate(invalid="ignore"):  # of infinity minus infinity
        if math.isfinite(float(pixels.sum(dtype=np.float64))):
            return
    bad = ~np.isfinite(pixels)
    if bad.any():
        v, u = np.argwhere(bad)[0][:2]
        raise error(
            f"{path}: {int(bad.sum())} values are NaN or infinite, the first at pixel ({u}, {v}); "
            "replace them, or mask those pixels and store 0"
        )


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """How an image file stores its picture.

    format: its name. width, height: as stored, pixels. channels: alpha included. bits: per sample. chroma:
    subsampling (JPEG, WebP). stated: what else it states. mosaic_at: byte of a TIFF that states a Bayer
    mosaic, 0 for none. bayer: its pattern, None for none or one that is not stated. planar: the channels of a
    TIFF are stored apart. tiled: its pixels are stored in tiles.
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


# Size and sample depth of an image from its first bytes, before any pixel is decoded.


def header_of_stream(stream: BinaryIO, name: str, error: type[BadInput] = BadCapture) -> ImageHeader:
    """Read the header of an image file; raise `error` for what it states and no reader heeds.

    Nothing but the header is read of a long file; one far longer than its image can be is refused.
    """
    size = stream.seek(0, os.SEEK_END)
    stream.seek(0)
    data = stream.read(_LONGEST_HEADER)
    codes = _sound_chunks(stream, name, error).get(b"cICP", b"") if data.startswith(_PNG) else b""
    stream.seek(0)
    try:
        if data.startswith(exr.MAGIC):
            found = exr.read_exr_header(data, name, error)
            header = ImageHeader(
                format="EXR", width=found.width, height=found.height, channels=len(found.channels), bits=32,
                floating=True, stated=found.stated,
            )  # fmt: skip
        elif data.startswith(_TIFF):
            header = _tiff(stream if size > len(data) else io.BytesIO(data), name, error)
        else:
            header = _by_pillow(data, name, codes, error)
    except (struct.error, IndexError, ValueError, KeyError, SyntaxError, OSError) as problem:
        raise error(f"{name}: the image header is damaged or cut off") from problem
    require_heeded(header.stated, name, error, _COUNTED.get(header.format, "pictures"))
    raw = header.width * header.height * header.channels * max(1, header.bits // 8)
    if size > 2 * raw + _LONGEST_HEADER:
        size_px = f"{header.width}×{header.height}"
        raise error(
            f"{name}: is larger ({size / 1e6:.0f} MB) than one {header.format} of {size_px} pixels can be"
        )
    return header


def _by_pillow(data: bytes, name: str, codes: bytes, error: type[BadInput]) -> ImageHeader:
    """codes: of a PNG's cICP chunk, empty for none."""
    from PIL import BmpImagePlugin, JpegImagePlugin, PngImagePlugin, WebPImagePlugin

    # the classes themselves: `Image.open` has a limit of its own for the number of pixels
    readers: dict[str, Any] = {
        "PNG": PngImagePlugin.PngImageFile,
        "JPEG": JpegImagePlugin.JpegImageFile,
        "BMP": BmpImagePlugin.BmpImageFile,
        "WEBP": WebPImagePlugin.WebPImageFile,
    }
    format_name = next((known for known, magic in _BY_PILLOW.items() if data.startswith(magic)), None)
    if format_name is None or (format_name == "WEBP" and data[8:12] != b"WEBP"):
        raise error(f"{name}: is not a PNG, TIFF, JPEG, BMP, WebP or EXR image")
    image = readers[format_name](io.BytesIO(data))
    chroma = "4:2:0" if format_name == "WEBP" and b"VP8 " in data[12:4096] else "4:4:4"
    if isinstance(image, JpegImagePlugin.JpegImageFile) and image.layers == 3:
        chroma = _JPEG_CHROMA.get((image.layer[0][1], image.layer[0][2]), chroma)
    return ImageHeader(
        format=format_name,
        width=image.width,
        height=image.height,
        channels=3 if image.mode == "P" else len(image.getbands()),
        bits=16 if image.tile and "16" in str(image.tile[0][3]) else 8,
        chroma=chroma,
        stated=_stated_by(image, codes),
    )


def _stated_by(image: Any, codes: bytes) -> Stated:
    """Gather it from EXIF, profile and chunks; of several curves the one that PNG ranks first counts."""
    said = image.info
    value, is_srgb, focal_mm = 1, "srgb" in said, 0.0
    # without this test, Pillow decodes the whole PNG to look for EXIF data behind the picture
    if "exif" in said:
        unread = (struct.error, ValueError, KeyError, TypeError, SyntaxError, OSError)
        with contextlib.suppress(*unread), warnings.catch_warnings(action="ignore"):
            exif = image.getexif()
            value = exif.get(_ORIENTATION, 1)
            more = exif.get_ifd(_EXIF_IFD)
            is_srgb = is_srgb or more.get(_COLOUR_SPACE) == _SRGB
            focal_mm = float(more.get(_FOCAL_35MM, 0))
    transfer = "srgb" if is_srgb else f"gamma:{1 / said['gamma']:.3g}" if said.get("gamma") else ""
    if said.get("icc_profile"):
        transfer = curve_of_profile(said["icc_profile"])
    if codes:
        transfer = TRANSFER_NAMES.get(codes[1], "") if codes[3] else "of limited range"
    density = said.get("aspect") or said.get("dpi") or (1, 1)
    if said.get("jfif_unit") == 0:
        density = said["jfif_density"]
    focal_px = focal_mm / _DIAGONAL_MM * math.hypot(image.width, image.height)
    return Stated(
        transfer="linear" if transfer == "gamma:1" else transfer,
        orientation=Orientation.from_exif(value) if isinstance(value, int) else UPRIGHT,
        pixel_aspect=aspect_of_density(*density),
        pictures=getattr(image, "n_frames", 1),
        colours=image.mode if image.mode in ("CMYK", "LAB", "YCbCr") else "",
        focal_px=focal_px or None,
    )


def _sound_chunks(stream: BinaryIO, name: str, error: type[BadInput]) -> dict[bytes, bytes]:
    """Return a PNG's short chunks; all CRCs are checked, since libpng prints faults, or lets them pass."""
    found: dict[bytes, bytes] = {}
    at, size = 8, stream.seek(0, os.SEEK_END)
    stream.seek(at)
    while at + 12 <= size:
        length, kind = struct.unpack(">I4s", stream.read(8))
        if at + 12 + length > size:
            break
        crc, left, piece = zlib.crc32(kind), length, b""
        while left:
            piece = stream.read(min(left, _PIECE_BYTES))
            crc, left = zlib.crc32(piece, crc), left - len(piece)
        if crc != struct.unpack(">I", stream.read(4))[0]:
            raise error(f"{name}: the PNG file is damaged: the checksum at byte {at} is wrong; copy it again")
        if length <= _SHORT_CHUNK:
            found[kind] = piece
        if kind == b"IEND":
            return found
        at += 12 + length
    raise error(f"{name}: the PNG file is cut off; copy or write it again")


def _tiff(stream: BinaryIO, name: str, error: type[BadInput]) -> ImageHeader:
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # of a damaged file the caller tells
    try:
        with tifffile.TiffFile(stream) as tiff:
            page: Any = tiff.pages[0]
            if _DNG_VERSION in page.tags:
                raise error(f"{name}: is a camera raw file with levels of its own; rename it to .dng")
            bits = page.bitspersample
            return ImageHeader(
                format="TIFF",
                width=int(page.imagewidth),
                height=int(page.imagelength),
                channels=int(page.samplesperpixel),
                bits=int(bits[0] if isinstance(bits, tuple) else bits),
                floating=page.sampleformat == 3,
                stated=_stated_by_tiff(tiff, page),
                tiled=bool(page.is_tiled),
                planar=page.samplesperpixel > 1 and page.planarconfig != 1,  # which OpenCV would interleave
                mosaic_at=page.tags[_PHOTOMETRIC].valueoffset if page.photometric == _MOSAIC else 0,
                bayer=_BAYER_BY_CODES.get(bytes(page.tags.valueof(_CFA_PATTERN, b""))),
            )
    except (tifffile.TiffFileError, AttributeError, TypeError, OverflowError) as problem:
        raise ValueError(str(problem)) from problem


def _stated_by_tiff(tiff: Any, page: Any) -> Stated:
    tags = page.tags
    stored, colours = int(tags.valueof(_PHOTOMETRIC, 1)), ""
    if stored not in _PHOTOMETRIC_READ:
        colours = _PHOTOMETRIC_NAMES.get(stored, f"photometric {stored}")
    pages = itertools.islice(tiff.pages, _MOST_PAGES)
    profile = tags.valueof(_ICC_PROFILE)
    across, down = (tags.valueof(tag, (1, 1)) for tag in (_ACROSS, _DOWN))
    return Stated(
        transfer=curve_of_profile(bytes(profile)) if profile else "",
        orientation=Orientation.from_exif(int(tags.valueof(_ORIENTATION, 1))),
        pixel_aspect=aspect_of_density(across[0] * down[1], down[0] * across[1]),
        pictures=sum(not int(each.tags.valueof(_SUBFILE_TYPE, 0)) & _REDUCED for each in pages),
        colours=colours,
    )

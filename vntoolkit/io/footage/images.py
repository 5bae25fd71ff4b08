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
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np

from vntoolkit.arrays import Array, Mask
from vntoolkit.checks import sum_is_finite
from vntoolkit.errors import BadCapture
from vntoolkit.io.files import opened, require_pixels, silenced_native_output
from vntoolkit.io.footage import mosaics
from vntoolkit.io.footage.colour_profiles import bt709_from, curve_of_lights, curve_of_profile
from vntoolkit.io.footage.image_writing import in_other_order
from vntoolkit.io.footage.mosaics import DecodedImage, ImageHeader
from vntoolkit.io.footage.orientation import Orientation
from vntoolkit.io.footage.stated import (
    TRANSFER_NAMES,
    Stated,
    aspect_of_density,
    full_scale,
    require_heeded,
    require_opaque,
)
from vntoolkit.io.maps_and_meshes.exr import MAGIC, read_exr
from vntoolkit.options.footage import Bayer, SensorOptions

_LONGEST_HEADER = 32 << 20  # bytes; colour profiles and previews stand before the size in some files
_PIECE_BYTES = 1 << 20
_SHORT_CHUNK = 64  # bytes
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_BY_PILLOW = {"PNG": _PNG, "JPEG": b"\xff\xd8", "BMP": b"BM", "WEBP": b"RIFF"}
# TIFF and EXIF tags, and values of theirs
_SUBFILE_TYPE, _REDUCED = 254, 1
_MOST_PAGES = 64  # that are looked at; those of a damaged file may lead round in a circle
_PHOTOMETRIC, _BLACK_IS_ZERO, _RGB, _PALETTE, _MOSAIC = 262, 1, 2, 3, 32803
_PHOTOMETRIC_READ = (_BLACK_IS_ZERO, _RGB, _PALETTE, _MOSAIC)
_CFA_PATTERN, _ICC_PROFILE, _DNG_VERSION, _TRANSFER_FUNCTION = 33422, 34675, 50706, 301
_ACROSS, _DOWN = 282, 283  # pixels in a length
_BAYER_BY_CODES = {bytes("rgb".index(colour) for colour in bayer.value): bayer for bayer in Bayer}
_PHOTOMETRIC_NAMES = {
    0: "grey with white as zero", 4: "a transparency mask", 5: "CMYK", 6: "YCbCr", 8: "CIELAB", 9: "ICCLAB",
    10: "ITULAB", 32844: "LogL", 32845: "LogLuv",
}  # fmt: skip
_ORIENTATION, _EXIF_IFD, _COLOUR_SPACE, _SRGB, _FOCAL_35MM = 274, 0x8769, 0xA001, 1, 0xA405
_GAMMA, _INTEROPERABILITY_IFD, _INDEX, _ADOBE_RGB = 0xA500, 0xA005, 1, "R03"
_BMP_PROFILE = b"DEBM"
_BMP_SRGB = (b"BGRs", b" niW")  # Windows' own colour space is sRGB
_BMP_MASKS, _BMP_BGRA = (3, 6), (0xFF0000, 0xFF00, 0xFF, 0xFF000000)
_XMP = ("xmp", "XML:com.adobe.xmp")
_UNREAD = (struct.error, ValueError, KeyError, TypeError, SyntaxError, OSError)  # of damaged EXIF data
_DIAGONAL_MM = 43.27  # of 24×36 mm
# sampling factors of luma: chroma's own are 1 × 1 in practice
_JPEG_CHROMA = {(2, 2): "4:2:0", (2, 1): "4:2:2", (1, 2): "4:4:0", (4, 1): "4:1:1"}


def read_image(path: Path | str) -> Array:
    """Read an image as (h, w, 3) RGB, encoded values as stored: uint8, uint16 or float32 (EXR, float TIFF).

    As `read_opaque_image`, whose pixels it returns.
    """
    return read_opaque_image(path).rgb


def read_opaque_image(
    path: Path | str, *, max_megapixels: float | None = None, sensor: SensorOptions | None = None
) -> DecodedImage:
    """Read an image, with what it states.

    An alpha channel is dropped where it is opaque everywhere and refused where it is not, since the colour
    beneath it is undefined. max_megapixels: None for the limit of `reading_limits`. sensor: how camera raw
    files and Bayer mosaics are read. Raises `BadCapture` for a file that is missing, empty, damaged, too
    large, holds NaN or states what is not read.
    """
    sensor = sensor or SensorOptions()
    if mosaics.is_raw(path):
        return mosaics.read_raw(path, sensor.demosaic, max_megapixels=max_megapixels)
    image = decode_image(path, max_megapixels=max_megapixels, sensor=sensor)
    if image.alpha is not None:
        require_opaque(image.alpha, str(path))
    return image


def read_image_with_alpha(path: Path | str) -> tuple[Array, Mask | None]:
    """Read (h, w, 3) RGB and, where there is an alpha channel, the (h, w) mask of alpha >= half."""
    image = decode_image(path)
    return image.rgb, None if image.alpha is None else image.alpha >= full_scale(image.alpha) / 2


def decode_image(
    path: Path | str, *, max_megapixels: float | None = None, sensor: SensorOptions | None = None
) -> DecodedImage:
    """Read an image that is no camera raw file. sensor: for Bayer mosaics, or None."""
    with opened(path, BadCapture) as stream:
        data = stream.read(_LONGEST_HEADER)
        if data.startswith(MAGIC):
            return _image_of_exr(path, max_megapixels)
        header = _header_of(data, stream, str(path))
        require_pixels(header.width, header.height, max_megapixels, str(path))
        stream.seek(0)
        data = stream.read()
    pixels = _samples(data, header, path)
    bayer = None if sensor is None else sensor.bayer or header.bayer
    if header.mosaic_at and bayer is None:
        raise BadCapture(f"{path}: is stored as a Bayer mosaic; give --bayer with its pattern, such as rggb")
    turn = header.stated.orientation
    if bayer is not None and sensor is not None:
        if pixels.ndim != 2:
            raise BadCapture(f"{path}: --bayer needs one sample a pixel, got {pixels.shape[2]}; leave it out")
        if header.format == "TIFF" and turn is not Orientation.UPRIGHT:  # the pattern would be turned with it
            raise BadCapture(f"{path}: is a Bayer mosaic that is to be shown turned; save it upright")
        rgb = mosaics.rgb_from_mosaic(pixels, bayer, sensor.demosaic, str(path))
        return DecodedImage(colours=turn.upright(rgb), alpha=None, header=header)
    if header.format != "TIFF":  # which OpenCV itself turns upright, and no other
        pixels = turn.upright(pixels)
    pixels = np.atleast_3d(in_other_order(pixels))
    if pixels.shape[2] in (2, 4):
        return DecodedImage(colours=pixels[..., :-1], alpha=pixels[..., -1], header=header)
    return DecodedImage(colours=pixels, alpha=None, header=header)


def _samples(data: bytes, header: ImageHeader, path: Path | str) -> Array:
    """Return samples in OpenCV's order: 8 or 16 bits, whose full scale is all ones, or finite floats."""
    if header.mosaic_at:
        grey = struct.pack("<H" if data[:2] == b"II" else ">H", _BLACK_IS_ZERO)  # which OpenCV reads
        data = data[: header.mosaic_at] + grey + data[header.mosaic_at + 2 :]
    pixels = None
    if not header.planar:
        # a damaged file is reported by the one line below, not by OpenCV on stderr
        with silenced_native_output(), contextlib.suppress(cv2.error):
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if pixels is None and header.format == "TIFF":  # also half floats and compression that OpenCV lacks
        pixels = _decoded_by_tifffile(data, header, path)
    if pixels is None:
        raise BadCapture(f"{path}: the {header.format} file is damaged or cut off")
    return _sound_samples(pixels, header, path)


def _decoded_by_tifffile(data: bytes, header: ImageHeader, path: Path | str) -> Array:
    """Return half floats, or channels stored apart, as OpenCV does others: upright and in its order."""
    import lzma

    import tifffile

    damages = (*_UNREAD, RuntimeError, ArithmeticError, EOFError, zlib.error, lzma.LZMAError)
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as tiff:
            page: Any = tiff.pages[0]
            values: Array = page.asarray()
    except damages as problem:
        raise BadCapture(
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


def _sound_samples(pixels: Array, header: ImageHeader, path: Path | str) -> Array:
    """Return samples of 8 or 16 bits, whose full scale is all ones, or finite floats; raise for any other."""
    if sorted(pixels.shape[:2]) != sorted((header.height, header.width)):
        raise BadCapture(f"{path}: its samples are damaged; copy it again")
    if pixels.dtype == np.float64:
        pixels = pixels.astype(np.float32)
    if pixels.dtype not in (np.uint8, np.uint16, np.float32):
        raise BadCapture(f"{path}: expected 8-bit, 16-bit or float samples, got {pixels.dtype}")
    if pixels.dtype == np.uint8 and header.bits > 8:
        raise BadCapture(
            f"{path}: its {header.bits}-bit samples would be read as 8 bits; save it as RGB or grey"
        )
    if pixels.dtype == np.uint16 and header.bits < 16:  # a packed TIFF, whose samples come filled with zeros
        packed = np.asarray(pixels, dtype=np.uint16)
        return packed | (packed >> np.uint16(header.bits))
    if pixels.dtype == np.float32:
        _require_numbers(pixels, path)
    return pixels


def _image_of_exr(path: Path | str, max_megapixels: float | None) -> DecodedImage:
    channels, found = read_exr(path, max_megapixels=max_megapixels)
    names = next((kept for group in ("RGB", "YZ", "A") if (kept := [n for n in group if n in channels])), [])
    if names != ["R", "G", "B"] and len(names) != 1:
        raise BadCapture(f"{path}: expected the channels R, G, B (or Y), found {', '.join(channels)}")
    pixels = np.stack([channels[name] for name in names], axis=-1).astype(np.float32)
    _require_numbers(pixels, path)
    to_bt709 = bt709_from(found.stated.chromaticities)
    if len(names) == 3 and to_bt709 is not None:
        pixels = pixels @ to_bt709.T.astype(np.float32)
    alpha = None
    if "A" in channels and names != ["A"]:
        alpha = channels["A"].astype(np.float32)
        _require_numbers(alpha, path)
    header = ImageHeader(
        format="EXR", width=found.width, height=found.height, channels=len(channels), bits=32, floating=True,
        stated=found.stated,
    )  # fmt: skip
    return DecodedImage(colours=pixels, alpha=alpha, header=header)


def _require_numbers(pixels: Array, path: Path | str) -> None:
    if sum_is_finite(pixels):  # a quarter of the time
        return
    bad = ~np.isfinite(pixels)
    if bad.any():
        v, u = np.argwhere(bad)[0][:2]
        raise BadCapture(
            f"{path}: {int(bad.sum())} values are NaN or infinite, the first at pixel ({u}, {v}); "
            "replace them, or mask those pixels and store 0"
        )


# Size and sample depth of an image from its first bytes, before any pixel is decoded.


def _header_of(data: bytes, stream: BinaryIO, name: str) -> ImageHeader:
    """Read the header of an image; raise `BadCapture` for what it states and no reader heeds.

    data: the beginning of the file, all that is read of a long one; one far longer than its image can be is
    refused.
    """
    size = stream.seek(0, os.SEEK_END)
    chunks = _sound_chunks(stream, name) if data.startswith(_PNG) else {}
    stream.seek(0)
    try:
        if data.startswith(_TIFF):
            header = _tiff(stream if size > len(data) else io.BytesIO(data), name)
        else:
            with warnings.catch_warnings(action="ignore"):  # of damage, which is told of in one line
                header = _by_pillow(data, name, chunks)
    except (struct.error, IndexError, ValueError, KeyError, SyntaxError, TypeError, OSError) as problem:
        raise BadCapture(f"{name}: the image header is damaged or cut off") from problem
    require_heeded(header.stated, name, "pages" if header.format == "TIFF" else "pictures")
    raw = header.width * header.height * header.channels * max(1, header.bits // 8)
    if size > 2 * raw + _LONGEST_HEADER:
        size_px = f"{header.width}×{header.height}"
        raise BadCapture(
            f"{name}: is larger ({size / 1e6:.0f} MB) than one {header.format} of {size_px} pixels can be"
        )
    return header


def _by_pillow(data: bytes, name: str, chunks: dict[bytes, bytes]) -> ImageHeader:
    """chunks: of a PNG, as `_sound_chunks` returns them."""
    from PIL import BmpImagePlugin, Image, JpegImagePlugin, PngImagePlugin, WebPImagePlugin

    # the classes themselves: `Image.open` has a limit of its own for the number of pixels
    readers: dict[str, Any] = {
        "PNG": PngImagePlugin.PngImageFile,
        "JPEG": JpegImagePlugin.jpeg_factory,
        "BMP": BmpImagePlugin.BmpImageFile,
        "WEBP": WebPImagePlugin.WebPImageFile,
    }
    format_name = next((known for known, magic in _BY_PILLOW.items() if data.startswith(magic)), None)
    if format_name is None or (format_name == "WEBP" and data[8:12] != b"WEBP"):
        raise BadCapture(f"{name}: is not a PNG, TIFF, JPEG, BMP, WebP or EXR image")
    if format_name == "BMP" and _has_masks(data):
        raise BadCapture(
            f"{name}: stores colours by masks of its own; save it with 24 bits a pixel, or as PNG"
        )
    try:
        image = readers[format_name](io.BytesIO(data))
    except Image.DecompressionBombError as problem:  # of a size that no file of its format can have
        raise ValueError(str(problem)) from problem
    chroma = "4:2:0" if format_name == "WEBP" and b"VP8 " in data[12:4096] else "4:4:4"
    if isinstance(image, JpegImagePlugin.JpegImageFile) and image.layers == 3:
        chroma = _JPEG_CHROMA.get((image.layer[0][1], image.layer[0][2]), chroma)
    header = ImageHeader(
        format=format_name,
        width=image.width,
        height=image.height,
        channels=3 if image.mode == "P" else len(image.getbands()),
        bits=16 if format_name == "PNG" and image.tile and "16" in str(image.tile[0][3]) else 8,
        chroma=chroma,
    )
    if b"eXIf" in chunks:  # Pillow would decode the whole PNG to find one behind the picture
        image.info["exif"] = chunks[b"eXIf"]
    curve = _curve_of_bmp(data) if format_name == "BMP" else ""
    return replace(header, stated=_stated_by(image, chunks.get(b"cICP", b""), curve))


def _stated_by(image: Any, codes: bytes, curve: str) -> Stated:
    """Gather it from EXIF, profile and chunks; of several curves the one that PNG ranks first counts.

    codes: of a PNG's cICP chunk, empty for none. curve: that a BMP's header states, or empty.
    """
    said = image.info
    turn, transfer, focal_mm = Orientation.UPRIGHT, curve, 0.0
    density = said.get("aspect") or said.get("dpi") or (1, 1)
    if said.get("jfif_unit") == 0:
        density = said["jfif_density"]
    if "exif" in said or any(key in said for key in _XMP):
        with contextlib.suppress(*_UNREAD):
            exif = image.getexif()
            turn, transfer, focal_mm = _stated_by_exif(exif)
            if exif.get(_ACROSS) != exif.get(_DOWN):
                density = float(exif[_ACROSS]), float(exif[_DOWN])
    if said.get("gamma"):
        transfer = f"gamma:{1 / said['gamma']:.3g}"
    if "srgb" in said:
        transfer = "srgb"
    if said.get("icc_profile"):
        transfer = curve_of_profile(said["icc_profile"])
    if codes:
        transfer = TRANSFER_NAMES.get(codes[1], "") if codes[3] else "of limited range"
    return Stated(
        transfer="linear" if transfer == "gamma:1" else transfer,
        orientation=turn,
        pixel_aspect=aspect_of_density(*density),
        colours=image.mode if image.mode in ("CMYK", "LAB", "YCbCr") else "",
        focal_px=_focal_px(focal_mm, image.width, image.height),
        pictures=_pictures(image),
    )


def _stated_by_exif(exif: Any) -> tuple[Orientation, str, float]:
    """Return what turns the picture upright, the transfer curve and the focal length in mm, 0 for none."""
    value, more = exif.get(_ORIENTATION, 1), exif.get_ifd(_EXIF_IFD)
    curve = f"gamma:{float(more[_GAMMA]):.4g}" if more.get(_GAMMA) else ""
    if more and exif.get_ifd(_INTEROPERABILITY_IFD).get(_INDEX) == _ADOBE_RGB:
        curve = "gamma:2.199"  # 563 / 256
    if more.get(_COLOUR_SPACE) == _SRGB:
        curve = "srgb"
    turn = Orientation.from_exif(value) if isinstance(value, int) else Orientation.UPRIGHT
    return turn, curve, float(more.get(_FOCAL_35MM, 0))


def _focal_px(focal_mm: float, width: int, height: int) -> float | None:
    """Return the focal length of a picture of 24×36 mm in pixels of one with the same diagonal."""
    return focal_mm / _DIAGONAL_MM * math.hypot(width, height) or None


def _pictures(image: Any) -> int:
    """Return how many pictures an opened file holds, without the previews that cameras put behind a JPEG."""
    from PIL import Image

    count = getattr(image, "n_frames", 1)
    if image.format != "MPO":
        return int(count)
    size, alike = image.size, 0
    for number in range(count):
        with contextlib.suppress(*_UNREAD, Image.DecompressionBombError):  # of a damaged preview
            image.seek(number)
            alike += image.size == size
    return max(1, alike)


def _has_masks(data: bytes) -> bool:
    """Tell whether a bitmap stores other than a byte a colour, or the colours in an order of its own."""
    size, bits, packing = struct.unpack_from("<I10xHI", data, 14)
    is_bgra = size >= 56 and struct.unpack_from("<4I", data, 54) == _BMP_BGRA
    return size >= 40 and (bits == 16 or (packing in _BMP_MASKS and not is_bgra))


def _curve_of_bmp(data: bytes) -> str:
    """Return the transfer curve that a bitmap's header of version 4 or 5 states; empty for none."""
    if len(data) < 122 or int.from_bytes(data[14:18], "little") < 108:
        return ""
    if data[70:74] in _BMP_SRGB:
        return "srgb"
    if data[70:74] == _BMP_PROFILE and len(data) >= 138:
        at, size = struct.unpack_from("<II", data, 126)
        return curve_of_profile(data[14 + at : 14 + at + size])
    gammas = set(struct.unpack_from("<3I", data, 110))
    if data[70:74] != bytes(4) or gammas == {0}:
        return ""
    return f"gamma:{gammas.pop() / 65536:.4g}" if len(gammas) == 1 else "of three gammas"


def _sound_chunks(stream: BinaryIO, name: str) -> dict[bytes, bytes]:
    """Return a PNG's short chunks and EXIF. CRCs are checked: libpng prints faults, or lets them pass."""
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
            raise BadCapture(
                f"{name}: the PNG file is damaged: the checksum at byte {at} is wrong; copy it again"
            )
        if length <= (_PIECE_BYTES if kind == b"eXIf" else _SHORT_CHUNK):
            found[kind] = piece
        if kind == b"IEND":
            return found
        at += 12 + length
    raise BadCapture(f"{name}: the PNG file is cut off; copy or write it again")


def _tiff(stream: BinaryIO, name: str) -> ImageHeader:
    import tifffile

    logging.getLogger("tifffile").setLevel(logging.CRITICAL + 1)  # of a damaged file the caller tells
    try:
        with tifffile.TiffFile(stream) as tiff:
            page: Any = tiff.pages[0]
            if _DNG_VERSION in page.tags:
                raise BadCapture(f"{name}: is a camera raw file with levels of its own; rename it to .dng")
            bits = page.bitspersample
            return ImageHeader(
                format="TIFF",
                width=int(page.imagewidth),
                height=int(page.imagelength),
                channels=int(page.samplesperpixel),
                bits=int(bits[0] if isinstance(bits, tuple) else bits),
                floating=page.sampleformat == 3,
                stated=_stated_by_tiff(tiff, page, stream),
                planar=page.samplesperpixel > 1 and page.planarconfig != 1,  # which OpenCV would interleave
                mosaic_at=page.tags[_PHOTOMETRIC].valueoffset if page.photometric == _MOSAIC else 0,
                bayer=_BAYER_BY_CODES.get(bytes(page.tags.valueof(_CFA_PATTERN, b""))),
            )
    except (tifffile.TiffFileError, AttributeError, TypeError, ArithmeticError) as problem:
        raise ValueError(str(problem)) from problem


def _stated_by_tiff(tiff: Any, page: Any, stream: BinaryIO) -> Stated:
    tags = page.tags
    stored, samples, colours = int(tags.valueof(_PHOTOMETRIC, 1)), int(page.samplesperpixel), ""
    if stored not in _PHOTOMETRIC_READ:
        colours = _PHOTOMETRIC_NAMES.get(stored, f"photometric {stored}")
    elif samples not in ((3, 4) if stored == _RGB else (1,)):  # OpenCV would leave the others out
        colours = f"{samples} samples a pixel"
    pages = itertools.islice(tiff.pages, _MOST_PAGES)
    across, down = (tags.valueof(tag, (1, 1)) for tag in (_ACROSS, _DOWN))
    transfer, focal_px = _stated_by_exif_of_tiff(tags, page, stream)
    if (table := tags.valueof(_TRANSFER_FUNCTION)) is not None:
        light = np.reshape(table, (-1, 1 << int(page.bitspersample))) / 65535
        codes = np.linspace(0.0, 1.0, light.shape[1])
        transfer = curve_of_lights(codes, light) or "of a table, unlike any known one"
    if profile := tags.valueof(_ICC_PROFILE):
        transfer = curve_of_profile(bytes(profile))
    return Stated(
        transfer=transfer,
        orientation=Orientation.from_exif(int(tags.valueof(_ORIENTATION, 1))),
        pixel_aspect=aspect_of_density(across[0] * down[1], down[0] * across[1]),
        pictures=sum(not int(each.tags.valueof(_SUBFILE_TYPE, 0)) & _REDUCED for each in pages)
        * int(page.imagedepth),
        colours=colours,
        focal_px=focal_px,
    )


def _stated_by_exif_of_tiff(tags: Any, page: Any, stream: BinaryIO) -> tuple[str, float | None]:
    """Return the transfer curve that EXIF data in a TIFF state, and the focal length in pixels."""
    from PIL import Image

    if _EXIF_IFD not in tags:
        return "", None
    exif = Image.Exif()
    stream.seek(0)
    with contextlib.suppress(*_UNREAD), warnings.catch_warnings(action="ignore"):
        exif.load_from_fp(stream)
        _, curve, focal_mm = _stated_by_exif(exif)
        return curve, _focal_px(focal_mm, page.imagewidth, page.imagelength)
    return "", None

"""OpenEXR images: float channels by name, size checked from the header."""

import contextlib
import io
import os
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.atomic import aligned_memory, write_large
from vntoolkit.io.files import opened, require_pixels, silenced_native_output
from vntoolkit.io.footage.stated import BT709, Stated, require_heeded

MAGIC = b"\x76\x2f\x31\x01"
_LONGEST_HEADER = 32 << 20  # bytes
_MOST_CHANNELS = 16
_MOST_EMPTY = 1000  # times as large a picture as what is stored of it: a few bytes would fill the memory
_CHANNELS_OF_A_PIXEL = 5  # of our normals; those that the limit in megapixels counts with


class ExrCompression(Enum):
    """How an EXR is packed.

    1280×720, half RGBA normals and float Z with noise, milliseconds and megabytes, two cores, OpenEXR 3.5:
    NONE 7 + 2 ms, 11.1 MB; RLE 21 + 10, 8.1; ZIPS 42 + 25, 7.4; ZIP 50 + 35, 7.1; PIZ 57 + 138, 7.2.
    All are lossless.
    """

    NONE = "none"
    RLE = "rle"
    ZIPS = "zips"
    ZIP = "zip"
    PIZ = "piz"


@dataclass(frozen=True, kw_only=True)
class ExrHeader:
    """What the header says: size in pixels, channel names and the text attributes.

    width, height: of the display window, the whole picture. left, top: where in it the stored pixels begin,
    below 0 where they begin before it. stated: what else it states.
    """

    width: int
    height: int
    channels: tuple[str, ...]
    texts: Mapping[str, str]
    stored_width: int
    stored_height: int
    left: int
    top: int
    stated: Stated


def _read_header(data: bytes, name: str) -> ExrHeader:
    """Read the header of an EXR, of its first part, without decoding any pixel."""
    import OpenEXR

    try:
        with silenced_native_output():
            file = OpenEXR.File(io.BytesIO(data), header_only=True)
            header = file.header()
            channels = tuple(channel.name for channel in header["channels"])  # decoded here, as UTF-8
            stated = _stated_by(header, len(file.parts))
    except (RuntimeError, ValueError, TypeError) as problem:
        raise BadCapture(f"{name}: the EXR header is damaged or cut off") from problem
    (x0, y0), (x1, y1) = (corner.tolist() for corner in header["dataWindow"])
    (left, top), (right, bottom) = (corner.tolist() for corner in header["displayWindow"])
    return ExrHeader(
        width=right - left + 1,
        height=bottom - top + 1,
        stored_width=x1 - x0 + 1,
        stored_height=y1 - y0 + 1,
        left=x0 - left,
        top=y0 - top,
        stated=stated,
        channels=channels,
        texts={key: value for key, value in header.items() if isinstance(value, str)},
    )


def _stated_by(header: Mapping[str, Any], parts: int) -> Stated:
    coarse = any(channel.xSampling != 1 or channel.ySampling != 1 for channel in header["channels"])
    is_split = any(channel.name in ("RY", "BY") for channel in header["channels"])
    return Stated(
        pixel_aspect=float(header.get("pixelAspectRatio", 1.0)),
        pictures=max(parts, len(header.get("multiView", ()))),
        colours="luminance and chroma" if is_split else "channels of several sizes" if coarse else "",
        chromaticities=tuple(header.get("chromaticities", BT709)),
    )


def read_exr(path: Path | str, *, max_megapixels: float | None = None) -> tuple[dict[str, Array], ExrHeader]:
    """Read all channels as (h, w) arrays of their own type, and the header.

    (h, w) is the display window, the whole picture; it is 0 where no pixel is stored. Values are returned as
    stored: NaN is the caller's business. Raises `BadCapture`, also for a file of several parts.
    """
    import OpenEXR

    with opened(path, BadCapture) as stream:
        data = stream.read(_LONGEST_HEADER)
        if data[:4] != MAGIC:
            raise BadCapture(f"{path}: is not an OpenEXR file")
        header = _read_header(data, str(path))
        if len(header.channels) > _MOST_CHANNELS:
            raise BadCapture(
                f"{path}: has {len(header.channels)} channels, at most {_MOST_CHANNELS} are read; save the "
                "layer that is meant"
            )
        require_heeded(header.stated, str(path), "parts or views")
        layers = -(-len(header.channels) // _CHANNELS_OF_A_PIXEL)
        require_pixels(header.width * layers, header.height, max_megapixels, str(path))
        stored = header.stored_width * layers, header.stored_height
        require_pixels(*stored, max_megapixels, str(path))
        if header.width * header.height > _MOST_EMPTY * header.stored_width * header.stored_height:
            raise BadCapture(
                f"{path}: its {header.stored_width}×{header.stored_height} pixels lie in a picture of "
                f"{header.width}×{header.height}, a display window that can only be damaged; save it again"
            )
        size = os.fstat(stream.fileno()).st_size
        if size > len(data):
            if size > 8 * header.stored_width * header.stored_height * len(header.channels) + _LONGEST_HEADER:
                raise BadCapture(
                    f"{path}: {size / 1e6:.0f} MB are more than its {header.width}×{header.height} take"
                )
            data += stream.read()
    said = io.StringIO()
    try:
        with (
            silenced_native_output(),
            contextlib.redirect_stdout(said),  # where the module prints that it leaves pixels out
            OpenEXR.File(io.BytesIO(data), separate_channels=True) as image,
        ):
            if "Exception" in said.getvalue():
                raise ValueError(said.getvalue())
            channels = {name: np.array(channel.pixels) for name, channel in image.channels().items()}
    except (RuntimeError, ValueError, TypeError) as problem:
        reason = " ".join(str(problem).split())
        raise BadCapture(f"{path}: the EXR file is damaged or cut off ({reason}); copy it again") from problem
    for name, values in channels.items():
        shape = (header.stored_height, header.stored_width)
        require_shape(values, shape, f"{path}: channel {name}", BadCapture)
        if values.dtype == np.object_:
            raise BadCapture(f"{path}: channel {name} is deep; expected one value a pixel: flatten it first")
    return {name: _in_display_window(values, header) for name, values in channels.items()}, header


def _in_display_window(values: Array, header: ExrHeader) -> Array:
    """Return the stored pixels where they belong in the whole picture, 0 around them."""
    if (header.left, header.top, *values.shape) == (0, 0, header.height, header.width):
        return values
    whole = np.zeros((header.height, header.width), values.dtype)
    rows, columns = (
        begin + np.arange(size) for begin, size in zip((header.top, header.left), values.shape, strict=True)
    )
    row_is_in, column_is_in = (rows >= 0) & (rows < header.height), (columns >= 0) & (columns < header.width)
    whole[np.ix_(rows[row_is_in], columns[column_is_in])] = values[np.ix_(row_is_in, column_is_in)]
    return whole


def write_exr(
    path: Path | str,
    channels: Mapping[str, Array],
    *,
    attributes: Mapping[str, str] | None = None,
    compression: ExrCompression = ExrCompression.NONE,
) -> None:
    """Write (h, w) channels, float16 or float32, under their names, with text attributes; atomically."""
    import OpenEXR

    first = next(iter(channels.values()))
    for name, values in channels.items():
        require_shape(values, first.shape, f"EXR channel {name}")
        if values.dtype not in (np.float16, np.float32):
            raise BadInput(f"EXR channel {name}: expected float16 or float32, got {values.dtype}")
    header: dict[str, Any] = dict(attributes or {})
    header["compression"] = getattr(OpenEXR, f"{compression.name}_COMPRESSION", OpenEXR.NO_COMPRESSION)
    header["type"] = OpenEXR.scanlineimage
    stream = io.BytesIO()
    contiguous = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    OpenEXR.File(header, contiguous).write(stream)
    memory = aligned_memory(len(stream.getbuffer()))
    memory[:] = np.frombuffer(stream.getbuffer(), np.uint8)
    write_large(path, memory.data)

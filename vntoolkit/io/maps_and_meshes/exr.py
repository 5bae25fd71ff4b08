"""OpenEXR images: float channels by name, size checked from the header, uncompressed ones written fast."""

from __future__ import annotations

import contextlib
import io
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.checks import require_shape
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.files import read_bytes
from vntoolkit.io.limits import require_pixels
from vntoolkit.native import silenced_native_output

MAGIC = b"\x76\x2f\x31\x01"
_TILED_OR_DEEP_OR_MULTIPART = 0x200 | 0x800 | 0x1000
_ROWS_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}


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
    """What the header says: size in pixels, channel names and the text attributes."""

    width: int
    height: int
    channels: tuple[str, ...]
    texts: Mapping[str, str]
    truncated: bool


def read_exr_header(data: bytes, name: str, error: type[BadInput] = BadInput) -> ExrHeader:
    """Parse the header of a single-part EXR without decoding any pixel."""
    attributes: dict[str, tuple[str, bytes]] = {}
    try:
        flags = struct.unpack_from("<I", data, 4)[0]
        at = 8
        while data[at] != 0:
            key, kind, value, at = _attribute(data, at)
            attributes[key] = (kind, value)
        x0, y0, x1, y1 = struct.unpack("<4i", attributes["dataWindow"][1])
        channels = _channel_names(attributes["channels"][1])
        compression = attributes["compression"][1][0]
    except (KeyError, IndexError, ValueError, struct.error, UnicodeDecodeError) as problem:
        raise error(f"{name}: the EXR header is damaged or cut off") from problem
    width, height = x1 - x0 + 1, y1 - y0 + 1
    if width < 1 or height < 1:
        raise error(f"{name}: the EXR header gives an impossible size, {width}×{height}")
    plain = not flags & _TILED_OR_DEEP_OR_MULTIPART
    return ExrHeader(
        width=width,
        height=height,
        channels=channels,
        texts={k: v.decode("utf-8", "replace") for k, (kind, v) in attributes.items() if kind == "string"},
        truncated=plain and _is_cut_off(data, at + 1, -(-height // _ROWS_PER_CHUNK.get(compression, 1))),
    )


def read_exr(
    path: Path | str, *, max_megapixels: float | None = None, error: type[BadInput] = BadCapture
) -> tuple[dict[str, npt.NDArray[Any]], Mapping[str, str]]:
    """Read all channels as (h, w) arrays of their own type, and the text attributes of the header.

    Values are returned as stored: NaN is the caller's business. Raises `error` with one line.
    """
    import OpenEXR

    data = read_bytes(path, error)
    if data[:4] != MAGIC:
        raise error(f"{path}: is not an OpenEXR file")
    header = read_exr_header(data, str(path), error)
    require_pixels(header.width, header.height, max_megapixels, str(path), error)
    if header.truncated:
        raise error(f"{path}: the file is cut off; copy or write it again")
    said = io.StringIO()
    try:
        with (
            silenced_native_output(),
            contextlib.redirect_stdout(said),  # where the module prints that it leaves pixels out
            OpenEXR.File(io.BytesIO(data), separate_channels=True) as image,
        ):
            channels = {name: np.array(channel.pixels) for name, channel in image.channels().items()}
    except (RuntimeError, ValueError, TypeError) as problem:
        raise error(f"{path}: the EXR file is damaged ({_one_line(problem)})") from problem
    if "Exception" in said.getvalue():
        raise error(f"{path}: the EXR file is damaged ({' '.join(said.getvalue().split())})")
    for name, values in channels.items():
        require_shape(values, (header.height, header.width), f"{path}: channel {name}", error)
        if values.dtype == np.object_:
            raise error(f"{path}: channel {name} is deep; expected one value a pixel: flatten it first")
    return channels, header.texts


def write_exr(
    path: Path | str,
    channels: Mapping[str, npt.NDArray[Any]],
    *,
    attributes: Mapping[str, str] | None = None,
    compression: ExrCompression = ExrCompression.NONE,
) -> None:
    """Write (h, w) channels, float16 or float32, under their names, with text attributes; atomically."""
    first = next(iter(channels.values()))
    for name, values in channels.items():
        require_shape(values, first.shape, f"EXR channel {name}")
        if values.dtype not in (np.float16, np.float32):
            raise BadInput(f"EXR channel {name}: expected float16 or float32, got {values.dtype}")
    texts = tuple(sorted((attributes or {}).items()))
    if compression is not ExrCompression.NONE:
        write_bytes(path, _encode(channels, texts, compression))
        return
    kinds = tuple((name, values.dtype.char) for name, values in sorted(channels.items()))
    template, start = _uncompressed_template(first.shape, kinds, texts)
    content = bytearray(template)
    rows = np.frombuffer(content, dtype=_row_type(first.shape[1], kinds), offset=start)
    for name, _ in kinds:
        rows[name] = channels[name]
    write_bytes(path, memoryview(content))


def _row_type(width: int, kinds: tuple[tuple[str, str], ...]) -> np.dtype[Any]:
    """One scanline as the file stores it: y, byte count, then each channel's row, names sorted."""
    return np.dtype([("\0y", "<i4"), ("\0bytes", "<i4"), *((n, "<" + k, (width,)) for n, k in kinds)])


@lru_cache(maxsize=8)
def _uncompressed_template(
    shape: tuple[int, int], kinds: tuple[tuple[str, str], ...], texts: tuple[tuple[str, str], ...]
) -> tuple[bytes, int]:
    """Let OpenEXR write a black image once; later frames of this kind only replace its pixels.

    Without compression the layout is fixed, so this is an exact EXR file at the price of a copy (9 ms
    instead of 19 for normals and depth at 1280×720).
    """
    blank = {name: np.zeros(shape, dtype=kind) for name, kind in kinds}
    content = _encode(blank, texts, ExrCompression.NONE)
    return content, len(content) - shape[0] * _row_type(shape[1], kinds).itemsize


def _encode(
    channels: Mapping[str, npt.NDArray[Any]], texts: tuple[tuple[str, str], ...], compression: ExrCompression
) -> bytes:
    import OpenEXR

    header: dict[str, Any] = dict(texts)
    header["compression"] = getattr(OpenEXR, f"{compression.name}_COMPRESSION", OpenEXR.NO_COMPRESSION)
    header["type"] = OpenEXR.scanlineimage
    stream = io.BytesIO()
    contiguous = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    OpenEXR.File(header, contiguous).write(stream)
    return stream.getvalue()


def _attribute(data: bytes, at: int) -> tuple[str, str, bytes, int]:
    end = data.index(0, at)
    kind_end = data.index(0, end + 1)
    size = struct.unpack_from("<i", data, kind_end + 1)[0]
    start = kind_end + 5
    if size < 0 or start + size > len(data):
        raise ValueError("attribute beyond the end of the file")
    return (
        data[at:end].decode(),
        data[end + 1 : kind_end].decode(),
        data[start : start + size],
        start + size,
    )


def _channel_names(value: bytes) -> tuple[str, ...]:
    names, at = [], 0
    while value[at] != 0:
        end = value.index(0, at)
        names.append(value[at:end].decode())
        at = end + 1 + 16  # type, linearity, reserved, two samplings
    return tuple(names)


def _is_cut_off(data: bytes, table: int, chunks: int) -> bool:
    """True if a chunk that the offset table names does not fit in the file."""
    if table + 8 * chunks > len(data):
        return True
    offsets = np.frombuffer(data, "<u8", chunks, table)
    last = int(offsets.max())
    if int(offsets.min()) == 0 or last + 8 > len(data):
        return True
    return last + 8 + struct.unpack_from("<i", data, last + 4)[0] > len(data)


def _one_line(problem: Exception) -> str:
    return " ".join(str(problem).split())

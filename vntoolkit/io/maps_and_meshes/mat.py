"""Arrays of MATLAB's files of version 5. SciPy's reader ends the process on some damaged ones.

A file is a header of 128 bytes, then elements: kind, size and content. An array is an element of elements:
flags, shape, name, numbers column by column. It may be packed by zlib.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.errors import BadInput
from vntoolkit.io.files import reading_limits, require_size

_HEADER_BYTES = 128
_ORDERS = {b"IM": "<", b"MI": ">"}  # the header's last two bytes
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_ARRAY, _PACKED = 14, 15
_OF_NUMBERS = range(6, 16)  # classes of arrays: double, single, integers of 8 to 64 bits
_COMPLEX = 0x800
_BYTES_PER_PIXEL = 24  # of a normal in double precision


def read_mat(path: Path | str) -> dict[str, Array]:
    """Return the arrays of real numbers of a .mat file by name, each (shape) of the type that is stored.

    Texts, cells and structures are passed over. Raises `BadInput`.
    """
    most = int(reading_limits().max_megapixels * 1e6 * _BYTES_PER_PIXEL)
    path = require_size(path, most, "a normal map; raise --max-megapixels if that is meant")
    found: dict[str, Array] = {}
    try:
        data = np.memmap(path, np.uint8, "r").data
        order = _ORDERS[bytes(data[_HEADER_BYTES - 2 : _HEADER_BYTES])]
        for content in _arrays(data[_HEADER_BYTES:], order, most):
            found |= _numbers(content, order)
    except (OSError, KeyError, ValueError, StopIteration, struct.error, zlib.error) as problem:
        raise BadInput(
            f"{path}: is no whole .mat file of version 5; copy it again, or save the array as .npz"
        ) from problem
    return found


def _arrays(data: memoryview, order: str, most: int) -> Iterator[memoryview]:
    """Yield the content of each array; they unpack to so many bytes at most in all."""
    left = most
    for kind, content in _elements(data, order):
        if kind == _PACKED:
            unpacked = zlib.decompressobj().decompress(content, max(left, 1))
            left -= len(unpacked)
            yield from _arrays(memoryview(unpacked), order, 0)
        elif kind == _ARRAY:
            yield content
        else:
            raise ValueError("expected arrays")


def _elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield kind and content of each element; one of 4 bytes at most has these where others have a size."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        is_small = kind > 0xFFFF
        begin = at + (4 if is_small else 8)
        if is_small:
            kind, size = kind & 0xFFFF, kind >> 16
        if begin + size > len(data) or (is_small and size > 4):
            raise ValueError("an element is cut off")
        yield kind, data[begin : begin + size]
        at = begin + size if kind == _PACKED else begin + size + -(begin + size) % 8


def _numbers(content: memoryview, order: str) -> dict[str, Array]:
    """Return an array under its name, nothing for what holds no real numbers."""
    parts = _elements(content, order)
    flags = struct.unpack_from(f"{order}I", next(parts)[1])[0]
    if flags & 0xFF not in _OF_NUMBERS or flags & _COMPLEX:
        return {}
    shape = np.frombuffer(next(parts)[1], f"{order}i4").tolist()
    name = bytes(next(parts)[1]).decode("ascii")
    kind, stored = next(parts)
    numbers = np.frombuffer(stored, f"{order}{_KINDS[kind]}")
    if min(shape, default=0) < 0 or math.prod(shape) != len(numbers):
        raise ValueError("an array has other numbers than its shape says")
    return {name: numbers.astype(numbers.dtype.newbyteorder("=")).reshape(shape, order="F")}

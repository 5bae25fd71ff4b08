""".npy and .npz files, mapped, read or streamed, without pickles; every failure is one line."""

import math
import tokenize
import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.files import reading_limits, require_file

_LONGEST_REASON = 200
_BYTES_PER_PIXEL = 8  # a depth in double precision
_DAMAGES = (
    ValueError, OSError, EOFError, SyntaxError, OverflowError, tokenize.TokenError, zipfile.BadZipFile,
    MemoryError, NotImplementedError, RuntimeError,
)  # fmt: skip
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the least that a ZIP can state: the same arrays give the same bytes


def map_npy(path: Path | str, error: type[BadInput] = BadInput) -> Any:
    """Return the array of a .npy file as a read-only memory map; raise `error`."""
    path = require_file(path, error)
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except _DAMAGES as problem:
        raise error(f"{path}: is not a whole .npy array ({_reason(problem)})") from problem


def read_npz(path: Path | str, key: str) -> npt.NDArray[Any]:
    """Return the array of this name from a .npz file; raise `BadInput`."""
    path = require_file(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            _require_size(archive, key, path)
            return np.asarray(archive[key])
    except KeyError as problem:
        raise BadInput(f"{path}: holds no array '{key}'") from problem
    except (*_DAMAGES, AttributeError, TypeError) as problem:  # of a .npy file that bears this name
        raise BadInput(f"{path}: is not a whole .npz archive ({_reason(problem)})") from problem


def _require_size(archive: Any, key: str, path: Path) -> None:
    """Refuse an array that unpacks to more than an image of four floats a pixel, before it is unpacked."""
    name = next(member for member in (f"{key}.npy", key) if member in archive.zip.namelist() or member == key)
    size, most = archive.zip.getinfo(name).file_size, reading_limits().max_megapixels * 1e6 * _BYTES_PER_PIXEL
    with archive.zip.open(name) as member:
        version = np.lib.format.read_magic(member)
        read = (
            np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read(member)
    promised = math.prod(shape) * dtype.itemsize
    if max(size, promised) > most:
        raise BadInput(
            f"{path}: the array '{key}' unpacks to {max(size, promised) / 1e6:.0f} MB, more than the limit "
            f"of {most / 1e6:.0f}; raise --max-megapixels if that is meant"
        )


def _reason(problem: BaseException) -> str:
    reason = " ".join(str(problem).split())[:_LONGEST_REASON] or type(problem).__name__
    # numpy takes every file without its mark for a pickle, and advises to load it unsafely
    return "it has no mark of a NumPy file" if "pickle.load" in reason else reason


@dataclass(frozen=True, kw_only=True, eq=False)
class StreamedArray:
    """An array that is never whole in memory. shape: of all; rows: yields shape[0] arrays of shape[1:]."""

    shape: tuple[int, ...]
    dtype: npt.DTypeLike
    rows: Iterator[npt.NDArray[Any]]


def write_npz(path: Path | str, arrays: Mapping[str, npt.ArrayLike | StreamedArray]) -> None:
    """Write an uncompressed .npz that `numpy.load` opens without pickles, atomically."""
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
        for name, values in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=_EPOCH)
            with archive.open(entry, "w", force_zip64=True) as member:
                if isinstance(values, StreamedArray):
                    _stream(member, values, name)
                else:
                    np.lib.format.write_array(member, np.asarray(values), allow_pickle=False)


def _stream(member: Any, array: StreamedArray, name: str) -> None:
    dtype = np.dtype(array.dtype)
    header = {
        "descr": np.lib.format.dtype_to_descr(dtype),
        "fortran_order": False,
        "shape": array.shape,
    }
    np.lib.format.write_array_header_2_0(member, header)
    count = 0
    for row in array.rows:
        require_shape(row, array.shape[1:], f"{name}, row {count}")
        member.write(np.ascontiguousarray(row, dtype=dtype).tobytes())
        count += 1
    if count != array.shape[0]:
        raise ValueError(f"{name}: {count} rows came, {array.shape[0]} were promised")

""".npy and .npz files, mapped, read or streamed, without pickles; every failure is one line."""

import contextlib
import math
import tokenize
import zipfile
import zlib
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
    MemoryError, NotImplementedError, RuntimeError, zlib.error,
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
    with _opened_npz(path) as archive:
        _require_size(archive, key, path)
        return np.asarray(archive[key])


def shapes_in_npz(path: Path | str) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a .npz file's arrays by name; none is unpacked. Raises `BadInput`."""
    with _opened_npz(path) as archive:
        return {name: _header_of(archive, name)[0] for name in archive.files}


@contextlib.contextmanager
def _opened_npz(path: Path | str) -> Iterator[Any]:
    path = require_file(path)
    try:
        with np.load(path, allow_pickle=False) as archive:
            yield archive
    except KeyError as problem:
        raise BadInput(f"{path}: holds no array {problem}") from problem
    except (*_DAMAGES, AttributeError, TypeError) as problem:  # of a .npy file that bears this name
        raise BadInput(f"{path}: is not a whole .npz archive ({_reason(problem)})") from problem


def _header_of(archive: Any, key: str) -> tuple[tuple[int, ...], int]:
    """Return an array's shape, and the bytes that it unpacks to or says that it does."""
    if key not in archive.files:
        raise KeyError(key)
    name = f"{key}.npy" if f"{key}.npy" in archive.zip.namelist() else key
    with archive.zip.open(name) as member:
        is_first = np.lib.format.read_magic(member) == (1, 0)
        form = np.lib.format
        shape, _, dtype = (form.read_array_header_1_0 if is_first else form.read_array_header_2_0)(member)
    return shape, max(archive.zip.getinfo(name).file_size, math.prod(shape) * dtype.itemsize)


def _require_size(archive: Any, key: str, path: Path | str) -> None:
    """Refuse an array that unpacks to more than an image of doubles, before it is unpacked."""
    _, size = _header_of(archive, key)
    most = reading_limits().max_megapixels * 1e6 * _BYTES_PER_PIXEL
    if size > most:
        raise BadInput(
            f"{path}: the array '{key}' unpacks to {size / 1e6:.0f} MB, more than the limit of "
            f"{most / 1e6:.0f}; raise --max-megapixels if that is meant"
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

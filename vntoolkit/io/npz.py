"""Arrays by name in one .npz file, large ones streamed row by row."""

from __future__ import annotations

import zipfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.checks import require_shape
from vntoolkit.io.atomic import atomic_path

_EPOCH = (1980, 1, 1, 0, 0, 0)  # the least that a ZIP can state: the same arrays give the same bytes


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

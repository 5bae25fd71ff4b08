"""Arrays of numpy's own files, mapped or read, without pickles and with every failure on one line."""

from __future__ import annotations

import tokenize
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import BadInput
from vntoolkit.io.files import require_file

_LONGEST_REASON = 200
_DAMAGES = (
    ValueError, OSError, EOFError, SyntaxError, OverflowError, tokenize.TokenError, zipfile.BadZipFile,
    MemoryError, NotImplementedError, RuntimeError,
)  # fmt: skip


def map_npy(path: Path | str, error: type[BadInput] = BadInput) -> Any:
    """Return the array of a .npy file as a read-only memory map; raise `error`."""
    path = require_file(path, error)
    try:
        return np.load(path, mmap_mode="r", allow_pickle=False)
    except _DAMAGES as problem:
        raise error(f"{path}: is not a whole .npy array ({_reason(problem)})") from problem


def read_npz(path: Path | str, key: str, error: type[BadInput] = BadInput) -> npt.NDArray[Any]:
    """Return the array of this name from a .npz file; raise `error`."""
    path = require_file(path, error)
    try:
        with np.load(path, allow_pickle=False) as archive:
            return np.asarray(archive[key])
    except KeyError as problem:
        raise error(f"{path}: holds no array '{key}'") from problem
    except (*_DAMAGES, AttributeError, TypeError) as problem:  # of a .npy file that bears this name
        raise error(f"{path}: is not a whole .npz archive ({_reason(problem)})") from problem


def _reason(problem: BaseException) -> str:
    return " ".join(str(problem).split())[:_LONGEST_REASON] or type(problem).__name__

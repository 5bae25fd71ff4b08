"""Large files of a frame: memory for them, and writing that leaves nothing in the system's file cache."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.io.atomic import atomic_path

_BLOCK = 4096  # bytes; what disks write at once, and where in memory they want it to begin
_LARGE = 1 << 20  # bytes; below it the wait for the disk costs more than the cache


def aligned_memory(size: int) -> npt.NDArray[np.uint8]:
    """Return (size,) bytes, not set, that begin where a disk can take them from."""
    memory = np.empty(size + _BLOCK, np.uint8)
    return memory[-memory.ctypes.data % _BLOCK :][:size]


def write_large(path: Path | str, content: memoryview) -> None:
    """Write a whole file atomically; a large one past the system's file cache, where the system can.

    A capture is larger than the memory. In the cache each frame takes fresh pages, whose making can cost as
    much processor time as the frame itself, and pushes out what other programs need. content: of
    `aligned_memory`; other memory goes through the cache.
    """
    with atomic_path(path) as temporary, temporary.open("wb", buffering=0) as file:
        if len(content) >= _LARGE and hasattr(os, "O_DIRECT"):
            _write_past_cache(file, content[: len(content) // _BLOCK * _BLOCK])
        _write_all(file, content)


def _write_past_cache(file: Any, blocks: memoryview) -> None:
    """Write what the file system takes of whole blocks; it may take none."""
    import fcntl

    flags = fcntl.fcntl(file, fcntl.F_GETFL)
    try:
        fcntl.fcntl(file, fcntl.F_SETFL, flags | os.O_DIRECT)
        _write_all(file, blocks)
    except OSError as error:
        if error.errno != errno.EINVAL:
            raise
    finally:
        fcntl.fcntl(file, fcntl.F_SETFL, flags)


def _write_all(file: Any, content: memoryview) -> None:
    """Write the content from the file's position to its end."""
    while file.tell() < len(content):
        file.write(content[file.tell() :])

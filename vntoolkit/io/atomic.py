"""Atomic writing: a temporary name, then a rename."""

import contextlib
import errno
import hashlib
import os
import re
import tempfile
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import ByteArray
from vntoolkit.errors import BadInput, CannotWrite

_TEMPORARY = re.compile(r"\..*\.([0-9]{1,9})\.part(?:\..*)?")
_LONGEST_NAME = 255  # bytes, of every common file system


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; move it to `path` on success, remove it on error.

    Missing folders are made. The temporary keeps the suffix of `path`, which many writers choose the format
    by. Raises `CannotWrite` for every error of the file system. There is no fsync: a crash of the program
    cannot leave half a file, a power cut may.
    """
    path = Path(path)
    temporary = path.parent / _temporary_name(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.is_dir():
            raise CannotWrite(f"{path}: is a folder, expected the name of a file to write")
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise cannot_write(path, error) from error
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


def _temporary_name(path: Path) -> str:
    """Return `.STEM.PROCESS.part.SUFFIX`; a digest stands for a stem that would make the name too long."""
    ending = f".{os.getpid()}.part{path.suffix}"
    stem = path.stem
    if len(os.fsencode(f".{stem}{ending}")) > _LONGEST_NAME:
        stem = hashlib.sha256(os.fsencode(stem)).hexdigest()[:16]
    return f".{stem}{ending}"


def write_bytes(path: Path | str, content: bytes | memoryview) -> None:
    """Write a whole file atomically."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(content)


def write_text(path: Path | str, content: str) -> None:
    """Write a whole UTF-8 file atomically.

    A byte of a file's name that is no UTF-8 goes in as `\\udcXX`, which JSON reads back as it was.
    """
    write_bytes(path, content.encode("utf-8", "backslashreplace"))


def require_writable_folder(folder: Path | str) -> Path:
    """Create `folder` and check that a file can be written into it, before a long run begins.

    What a run that was killed left half-written there, or one folder below, is removed.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"0")
    except OSError as error:
        raise cannot_write(folder, error) from error
    remove_leftovers(folder, _has_ended)
    return folder


def remove_leftovers(folder: Path, is_left_by: Callable[[int], bool]) -> None:
    """Remove the temporary files of processes that `is_left_by` names, in `folder` and one folder below.

    Raises `CannotWrite`.
    """
    try:
        for pattern in (".*", "*/.*"):
            for path in folder.glob(pattern):
                match = _TEMPORARY.fullmatch(path.name)
                if match and is_left_by(int(match[1])):
                    path.unlink(missing_ok=True)
    except OSError as error:
        raise cannot_write(folder, error) from error


def _has_ended(process: int) -> bool:
    try:
        os.kill(process, 0)
    except OSError as error:  # another's process, which may not be asked, is running
        return isinstance(error, ProcessLookupError)
    return False


def cannot_write(path: Path | str, error: OSError) -> CannotWrite:
    """Return the error for a failed write, as one line."""
    reason = error.strerror or str(error)
    match error.errno:
        case errno.ENOSPC | errno.EDQUOT:
            advice = "free some space or choose another --out"
        case errno.EACCES | errno.EPERM | errno.EROFS:
            advice = "choose a folder that you may write to"
        case errno.ENOTDIR | errno.EEXIST:
            advice = "a file stands where a folder is needed; choose another name"
        case _:
            advice = "choose another place to write to"
    return CannotWrite(f"cannot write {path}: {reason.lower()}; {advice}")


# What a run must not write over or remove: what it reads.


def require_apart(inputs: Iterable[Path | str | None], written: Iterable[Path]) -> None:
    """Raise `BadInput` where an input is one of the files or lies in one of the folders that are written."""
    places = [Path(os.path.realpath(place)) for place in written]  # `resolve` raises for a loop of links
    for path in (Path(each) for each in inputs if each):
        for place in places:
            if Path(os.path.realpath(path)).is_relative_to(place):
                raise BadInput(
                    f"{path}: is an input, and {place} is what would be written; choose another --out"
                )


# Large files of a frame: memory for them, and writing that leaves nothing in the system's file cache.


_BLOCK = 4096  # bytes; what disks write at once, and where in memory they want it to begin
_LARGE = 1 << 20  # bytes; below it the wait for the disk costs more than the cache


def aligned_memory(size: int) -> ByteArray:
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

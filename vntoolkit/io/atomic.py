"""Atomic writing: a temporary name, then a rename; and a lock, so that one run at a time writes a folder."""

import contextlib
import errno
import hashlib
import logging
import os
import re
import socket
import sys
from collections.abc import Callable, Container, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import ByteArray
from vntoolkit.errors import BadInput, CannotWrite

LOCK_NAME = ".vntoolkit.lock"
_TEMPORARY = re.compile(r"\..*\.([0-9]{1,9})\.part(?:\..*)?|\.probe\.([0-9]{1,9})")
_LONGEST_NAME = 255  # bytes, of every common file system
_LOGGER = logging.getLogger(__name__)


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
    probe = folder / f".probe.{os.getpid()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            probe.write_bytes(b"0")
        finally:
            probe.unlink(missing_ok=True)
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
                if match and is_left_by(int(match[1] or match[2])):
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


# One run at a time: a lock that the system takes back from a process that has ended, however it ended.


@contextlib.contextmanager
def sole_writer(folder: Path | str) -> Iterator[Path]:
    """Make `folder`, prove that it can be written to, and keep other runs out of it while the block runs.

    Raises `CannotWrite` that names the process at work there. The lock of a run that was killed is taken over
    and said so. Folders that the block leaves empty are removed again, if they were made here.
    """
    folder = Path(folder)
    made = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    try:
        with _locked(require_writable_folder(folder), exclusive=True):
            yield folder
    finally:
        with contextlib.suppress(OSError):
            for each in made:
                each.rmdir()


@contextlib.contextmanager
def undisturbed(folder: Path | str) -> Iterator[None]:
    """Keep runs from writing into a folder while the block reads it; any number may read.

    A folder that this process may not write to is not locked. Raises `CannotWrite` as `sole_writer` does.
    """
    folder = Path(folder)
    if not folder.is_dir() or not os.access(folder, os.W_OK | os.X_OK):
        yield
        return
    with _locked(folder, exclusive=False):
        yield


@contextlib.contextmanager
def _locked(folder: Path, *, exclusive: bool) -> Iterator[None]:
    if sys.platform == "win32":  # no flock
        yield
        return
    import fcntl

    kind = (fcntl.LOCK_EX if exclusive else fcntl.LOCK_SH) | fcntl.LOCK_NB
    path = folder / LOCK_NAME
    while True:
        try:
            lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW, 0o666)
        except OSError as error:
            raise cannot_write(folder, error) from error
        try:
            fcntl.flock(lock, kind)
        except BlockingIOError as error:
            holder = _holder(lock)
            os.close(lock)
            raise CannotWrite(
                f"{folder}: process {holder or 'of another run'} is at work there; wait until it has ended, "
                "or choose another folder"
            ) from error
        except OSError as error:  # a network folder without locks
            _LOGGER.warning(
                "%s: cannot be locked (%s): start no second run there", folder, (error.strerror or "").lower()
            )
        with contextlib.suppress(OSError):
            if os.path.samestat(os.fstat(lock), path.stat()):
                break
        os.close(lock)  # the run before removed it between the two calls
    try:
        earlier = _holder(lock)
        if earlier and exclusive:
            _LOGGER.warning("%s: process %s was ended before it was done there; taken over", folder, earlier)
        with contextlib.suppress(OSError):  # of a full disk: what is written there will tell
            os.ftruncate(lock, 0)
            os.pwrite(lock, f"{os.getpid()} on {socket.gethostname()}".encode(), 0)
        yield
    finally:
        with contextlib.suppress(OSError):  # other readers keep it
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
        os.close(lock)


def _holder(lock: int) -> str:
    with contextlib.suppress(OSError):
        return os.pread(lock, 200, 0).decode("utf-8", "replace").strip()
    return ""


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


def remove_numbered(folder: Path, suffix: str, numbers: Container[int]) -> None:
    """Remove the files `000012.exr` of a folder that have these numbers, and the folder once it is empty."""
    if not folder.is_dir():
        return
    for path in folder.glob(f"[0-9][0-9][0-9][0-9][0-9][0-9]*{suffix}"):
        if path.stem.isdigit() and path.name == f"{int(path.stem):06d}{suffix}" and int(path.stem) in numbers:
            path.unlink()
    with contextlib.suppress(OSError):  # something of the user's is left
        folder.rmdir()


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

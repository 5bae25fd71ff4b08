"""Atomic writing: a file is written under a temporary name, then renamed; no partial file appears."""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path

from vntoolkit.errors import CannotWrite

_TEMPORARY = re.compile(r"\..*\.([0-9]{1,9})\.part(?:\..*)?|\.probe\.([0-9]{1,9})")


@contextlib.contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; move it to `path` on success, remove it on error.

    Missing folders are made. The temporary keeps the suffix of `path`, which many writers choose the format
    by. Raises `CannotWrite` for every error of the file system. There is no fsync: a crash of the program
    cannot leave half a file, a power cut may.
    """
    path = Path(path)
    temporary = path.parent / f".{path.stem}.{os.getpid()}.part{path.suffix}"
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
        probe.write_bytes(b"0")
        probe.unlink()
        _remove_leftovers(folder)
    except OSError as error:
        raise cannot_write(folder, error) from error
    return folder


def _remove_leftovers(folder: Path) -> None:
    """Remove the temporary files of `atomic_path` and `require_writable_folder` whose process has ended."""
    for pattern in (".*", "*/.*"):
        for path in folder.glob(pattern):
            match = _TEMPORARY.fullmatch(path.name)
            if match and not _is_running(int(match[1] or match[2])):
                path.unlink(missing_ok=True)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


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

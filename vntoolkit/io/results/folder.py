"""A folder of results: one run at a time, one request, a run that goes on, and removal of what it wrote.

Reconstructions, tracks, simulated captures and exports are such folders. Each holds a record, a JSON file of
what was asked for. The same request goes on where it stopped; another one is refused, or with `overwrite`
takes the folder after what the earlier one wrote is removed.
"""

import contextlib
import json
import logging
import os
import socket
import sys
from collections.abc import Callable, Collection, Container, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from vntoolkit.errors import BadInput, CannotWrite
from vntoolkit.io.atomic import cannot_write, require_writable_folder, write_text
from vntoolkit.io.files import read_json
from vntoolkit.io.results.numbered_files import remove_if_empty, remove_numbered

LOCK_NAME = ".vntoolkit.lock"
MOST_FRAMES = 10**6  # the names of their files have six digits
_LOGGER = logging.getLogger(__name__)


def _text_of_record(record: Any) -> str:
    return json.dumps(record, indent=2) + "\n"


def option_values(options: Any, prefix: str = "", without: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the JSON values of an option dataclass and of those within, but for some, by dotted names."""
    return flat({name: value for name, value in asdict(options).items() if name not in without}, prefix)


def flat(record: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return a JSON object's values by dotted names."""
    values: dict[str, Any] = {}
    for name, value in record.items():
        if isinstance(value, Mapping):
            values |= flat(value, f"{prefix}{name}.")
        else:
            values[prefix + name] = value.value if isinstance(value, Enum) else value
    return values


@dataclass(frozen=True, kw_only=True)
class FolderKind:
    """What one verb writes into a folder.

    verb: of `vntoolkit`. holds: its results in a word, for messages. record: name of the file that says what
    was asked for. files: its other files, by their names in the folder. frames: folder of files that have a
    frame's number → their suffixes; "." for the folder itself. clear_frame: empties a folder named by a
    frame's number. foreign: files that without a record are not of this verb. read, text: the record from
    its file and back. request: of a record, what two runs must agree in, by names for messages. grows: of
    these, lists that may become longer. numbers: of a folder, the frames whose files are the verb's.
    """

    verb: str
    holds: str
    record: str
    files: tuple[str, ...] = ()
    frames: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    clear_frame: Callable[[Path], None] | None = None
    foreign: tuple[str, ...] = ()
    read: Callable[[Path], Any] = read_json
    text: Callable[[Any], str] = _text_of_record
    request: Callable[[Any], Mapping[str, Any]] = flat
    grows: tuple[str, ...] = ()
    numbers: Callable[[Path], Container[int]] = lambda folder: range(MOST_FRAMES)


def begin_run(folder: Path, kind: FolderKind, record: Any, *, overwrite: bool = False) -> bool:
    """Write the record of a run into a folder that is locked; return whether an earlier run goes on.

    record: as `kind.read` returns it. With `overwrite`, what an earlier run wrote is removed. Raises
    `BadInput`, before anything there is touched, where the folder holds results of another request, or of
    another program.
    """
    goes_on = require_same_request(folder, kind, record, overwrite=overwrite)
    if overwrite:
        clear_results(folder, kind)
    write_text(folder / kind.record, kind.text(record))
    return goes_on


def require_same_request(folder: Path, kind: FolderKind, record: Any, *, overwrite: bool = False) -> bool:
    """Return whether a folder holds a run of the same request; raise `BadInput` as `begin_run` does."""
    if not (folder / kind.record).exists():
        for name in kind.foreign:
            if (folder / name).exists():
                raise BadInput(
                    f"{folder}: holds {name}, which `vntoolkit {kind.verb}` did not write; choose another "
                    "folder"
                )
        return False
    if overwrite:
        return False
    before = kind.request(kind.read(folder / kind.record))
    changes = changes_between(before, kind.request(record), kind.grows)
    if changes:
        raise BadInput(
            f"{folder}: holds {kind.holds} made differently: {'; '.join(changes)}; add --overwrite to "
            "replace what it holds, or choose another --out"
        )
    return True


def changes_between(
    before: Mapping[str, Any], now: Mapping[str, Any], grows: Collection[str] = ()
) -> list[str]:
    """Return the differences of two requests, one phrase each. grows: lists that may become longer."""
    changes = []
    now = json.loads(json.dumps(now))
    for name in dict.fromkeys((*before, *now)):
        old, new = before.get(name), now.get(name)
        if name in grows and isinstance(old, list) and isinstance(new, list):
            new = new[: len(old)]
        if old != new:
            plain = all(isinstance(value, bool | int | float | str | None) for value in (old, new))
            is_hash = any(isinstance(value, str) and len(value) == 64 for value in (old, new))
            changes.append(f"{name} ({old} → {new})" if plain and not is_hash else name)
    return changes


def clear_results(folder: Path, kind: FolderKind) -> None:
    """Remove what a run wrote into a folder that holds its record, and nothing else; the record last."""
    if not (folder / kind.record).exists():
        return
    numbers = kind.numbers(folder)
    for name, suffixes in kind.frames.items():
        for suffix in suffixes:
            remove_numbered(folder / name, suffix, numbers)
    if kind.clear_frame is not None:
        for path in folder.glob("[0-9][0-9][0-9][0-9][0-9][0-9]"):
            kind.clear_frame(path)
    for name in (*kind.files, kind.record):
        (folder / name).unlink(missing_ok=True)
        if "/" in name:
            remove_if_empty((folder / name).parent)


# One run at a time: a lock that the system takes back from a process that has ended, however it ended.


@contextlib.contextmanager
def write_lock(folder: Path | str) -> Iterator[Path]:
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
def read_lock(folder: Path | str) -> Iterator[None]:
    """Keep runs from writing into a folder while the block reads it; any number may read.

    A folder that this process may not write to is not locked. Raises `CannotWrite` as `write_lock` does.
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

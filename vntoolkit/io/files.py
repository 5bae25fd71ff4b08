"""Reading whole files: checks, hashes, JSON, and how much a file may ask for; every failure is one line.

The limits guard against headers that declare more than there is memory for. They hold for every reader of
this process; the command line sets them by `--max-megapixels` and `--max-vertices`.
"""

import contextlib
import hashlib
import json
import os
import stat
import threading
from collections.abc import Iterator
from io import BufferedReader
from pathlib import Path
from typing import Any

from vntoolkit.errors import BadCapture, BadInput, BadMesh
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.photometry.rig import SourceFile

_MOST_BYTES = 16 << 20  # of a text or JSON; the longest, a manifest of 100,000 images, has 12 MB
_LONGEST_LINE = 1 << 20  # bytes
_LONGEST_NAME = 255
_silence = threading.Lock()


def require_file(path: Path | str, error: type[BadInput] = BadInput) -> Path:
    """Return `path`, or raise `error` with one line: missing, a folder, empty or not readable."""
    path = Path(path)
    try:
        found = path.stat()  # `Path.exists` would take what the system refuses for missing
    except (FileNotFoundError, NotADirectoryError) as problem:
        raise error(f"{path}: no such file") from problem
    except ValueError as problem:  # a null byte
        raise error(f"{path}: no such file ({problem})") from problem
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from problem
    if stat.S_ISDIR(found.st_mode):
        raise error(f"{path}: is a folder, expected a file")
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{path}: is a pipe or a device, expected a file")
    if found.st_size == 0:
        raise error(f"{path}: the file is empty")
    return path


@contextlib.contextmanager
def opened(path: Path | str, error: type[BadInput] = BadInput) -> Iterator[BufferedReader]:
    """Open a file to read its bytes; raise `error` with one line, also for what fails while it is read."""
    path = require_file(path, error)
    try:
        with path.open("rb") as stream:
            yield stream
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror or problem})") from problem


def require_size(path: Path | str, most: float, what: str, error: type[BadInput] = BadInput) -> Path:
    """Return the path of a file of so many bytes at most, or raise `error` before any is read.

    what: what the file should be, and what to do where it is longer.
    """
    path = require_file(path, error)
    size = path.stat().st_size
    if size > most:
        raise error(f"{path}: has {size / 1e6:.2f} MB, expected {most / 1e6:.2f} at most of {what}")
    return path


def read_bytes(path: Path | str, error: type[BadInput] = BadInput) -> bytes:
    """Read a whole file of 16 MB at most, or raise `error` with one line before it is read."""
    with opened(require_size(path, _MOST_BYTES, "such a file; is it the right one?", error), error) as stream:
        return stream.read()


def read_text(path: Path | str, error: type[BadInput] = BadInput, expected: str = "text in UTF-8") -> str:
    """Read a UTF-8 file of 16 MB at most, or raise `error` with one line that says what was expected."""
    try:
        return read_bytes(path, error).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: expected {expected}; byte {problem.start} is no text in UTF-8") from problem


def text_lines(path: Path | str, error: type[BadInput] = BadInput) -> Iterator[str]:
    """Yield the lines of a long text one by one; raise `error` for one that no program would write."""
    with opened(path, error) as stream:
        number = 0
        while line := stream.readline(_LONGEST_LINE):
            number += 1
            if len(line) == _LONGEST_LINE or b"\0" in line:
                raise error(f"{path}: line {number} is no line of text")
            yield line.decode("utf-8-sig" if number == 1 else "utf-8", "replace").rstrip("\r\n")


def require_name(name: str, source: Path | str) -> str:
    """Return a name that is to be a file's or a folder's, or raise where it would be none or lead elsewhere.

    source: what the name was taken from, for the message.
    """
    if name.strip(". ") == "" or set(name) & {"/", "\\", "\0"} or len(os.fsencode(name)) > _LONGEST_NAME:
        raise BadInput(f"{source}: gives the name {name[:80]!r}, which is not allowed for a file; rename it")
    return name


def require_inside(folder: Path, name: str, source: Path | str) -> Path:
    """Return the path of a file that another file names; raise if it lies outside `folder`."""
    if len(name) > _LONGEST_NAME:
        raise BadInput(f"{source}: names a file by {len(name)} characters")
    try:
        path = folder / name
        if path.resolve().is_relative_to(folder.resolve()):
            return path
    except (OSError, ValueError, RuntimeError) as problem:  # a NUL in the name, a symlink loop
        raise BadInput(f"{source}: names a file that cannot be: {name[:80]!r}") from problem
    raise BadInput(f"{source}: names '{name[:80]}', outside its folder; put that file beside it")


def sha256_of_file(path: Path | str) -> str:
    """Return the SHA-256 of a file's bytes in hexadecimal."""
    with opened(path) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def source_file(path: Path | str) -> SourceFile:
    """Return the record of a source: its name and its hash."""
    return SourceFile(file=Path(path).name, sha256=sha256_of_file(path))


def read_json(path: Path | str, error: type[BadInput] = BadInput, expected: str = "a JSON file") -> Any:
    """Read a JSON file; raise `error` as `read_text` and `parse_json` do."""
    return parse_json(read_text(path, error, expected), str(path), error, expected)


def parse_json(text: str, name: str, error: type[BadInput] = BadInput, expected: str = "a JSON file") -> Any:
    """Return the content of a JSON text; raise `error` if it is invalid or nested too deeply.

    NaN and infinity pass, as Python has it: the schema, which can name the key, refuses them.
    """
    try:
        return json.loads(text, object_pairs_hook=_without_duplicates)
    except json.JSONDecodeError as problem:
        raise error(
            f"{name}: expected {expected}, but this is not JSON: {problem.msg} at line {problem.lineno}, "
            f"column {problem.colno}"
        ) from problem
    except RecursionError as problem:
        raise error(f"{name}: its brackets are nested too deeply for any file of this program") from problem
    except KeyError as problem:
        raise error(f"{name}: the key {problem.args[0][:80]!r} stands there twice; keep one") from problem
    except ValueError as problem:  # an integer of thousands of digits
        raise error(
            f"{name}: expected {expected}, but this is not JSON: {str(problem).split(';')[0][:200]}"
        ) from problem


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) != len(pairs):
        keys = [key for key, _ in pairs]
        raise KeyError(next(key for key in keys if keys.count(key) > 1))
    return found


_BYTES_PER_VERTEX = 256  # with its faces, normal, colour and texture coordinates, as text of full precision
_BYTES_BESIDE = 1 << 20
_current = [ReadingLimits()]


def reading_limits() -> ReadingLimits:
    """Return the limits that hold now."""
    return _current[-1]


@contextlib.contextmanager
def limited_to(limits: ReadingLimits) -> Iterator[None]:
    """Read within other limits in this block, on all threads of this process."""
    _current.append(limits)
    try:
        yield
    finally:
        _current.pop()


def require_pixels(width: int, height: int, max_megapixels: float | None, name: str) -> None:
    """Refuse a size that a damaged or hostile header claims, before memory is asked for.

    max_megapixels: None for the limit that holds. Raises `BadCapture`.
    """
    if min(width, height) < 1:
        raise BadCapture(
            f"{name}: states a size of {width}×{height}, expected pixels; it is damaged: copy it again"
        )
    most = reading_limits().max_megapixels if max_megapixels is None else max_megapixels
    megapixels = width * height / 1e6
    if megapixels > most:
        size = f"{width}×{height} is {megapixels:.{0 if megapixels >= 10 else 3}f} megapixels"
        raise BadCapture(
            f"{name}: {size}, more than the limit of {most:g}; raise --max-megapixels if that is meant"
        )


def require_vertices(count: int, name: str) -> None:
    """Refuse a mesh or point cloud of more vertices than the limit that holds."""
    most = reading_limits().max_vertices
    if count > most:
        raise BadMesh(
            f"{name}: {count} vertices are more than the limit of {most}; raise --max-vertices if that is "
            "meant"
        )


def require_mesh_file(path: Path | str) -> Path:
    """Return the path of a file that holds no more than the limit's vertices can take, or raise `BadMesh`."""
    most = reading_limits().max_vertices
    what = f"a mesh of {most} vertices, the limit; raise --max-vertices if that is meant"
    return require_size(path, most * _BYTES_PER_VERTEX + _BYTES_BESIDE, what, BadMesh)


@contextlib.contextmanager
def silenced_native_output() -> Iterator[None]:
    """Discard what libpng, libtiff and OpenEXR write to standard error while the block runs.

    Takes 20 µs. Descriptors belong to the whole process, so a line that another thread writes in the meantime
    is lost too: keep the body short.
    """
    with _silence:
        saved = nowhere = None
        with contextlib.suppress(OSError):  # no descriptor left, or none open: then nothing is kept quiet
            saved = os.dup(2)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 2)
        try:
            yield
        finally:
            if saved is not None:
                os.dup2(saved, 2)
                os.close(saved)
            if nowhere is not None:
                os.close(nowhere)

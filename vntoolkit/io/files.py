"""Reading whole files: checks, hashes, JSON; every failure is one line."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from vntoolkit.errors import BadInput
from vntoolkit.photometry.rig import SourceFile

_CHUNK_BYTES = 1 << 20
_LONGEST_NAME = 255


def require_file(path: Path | str, error: type[BadInput] = BadInput) -> Path:
    """Return `path`, or raise `error` with one line: missing, a folder, empty or not readable."""
    path = Path(path)
    try:
        if path.is_dir():
            raise error(f"{path}: is a folder, expected a file")
        if not path.exists():
            raise error(f"{path}: no such file")
        if not path.is_file():
            raise error(f"{path}: is a pipe or a device, expected a file")
        if path.stat().st_size == 0:
            raise error(f"{path}: the file is empty")
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from problem
    return path


def read_bytes(path: Path | str, error: type[BadInput] = BadInput) -> bytes:
    """Read a whole file, or raise `error` with one line."""
    path = require_file(path, error)
    try:
        return path.read_bytes()
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from problem


def read_text(path: Path | str, error: type[BadInput] = BadInput, expected: str = "text in UTF-8") -> str:
    """Read a whole UTF-8 file, or raise `error` with one line that says what was expected there."""
    try:
        return read_bytes(path, error).decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error(f"{path}: expected {expected}; byte {problem.start} is no text in UTF-8") from problem


def require_inside(folder: Path, name: str, source: Path | str, error: type[BadInput] = BadInput) -> Path:
    """Return the path of a file that another file names; raise if it lies outside `folder`."""
    if len(name) > _LONGEST_NAME:
        raise error(f"{source}: names a file by {len(name)} characters")
    try:
        path = folder / name
        if path.resolve().is_relative_to(folder.resolve()):
            return path
    except (OSError, ValueError, RuntimeError) as problem:  # a NUL in the name, a symlink loop
        raise error(f"{source}: names a file that cannot be: {name[:80]!r}") from problem
    raise error(f"{source}: names '{name[:80]}', outside its folder; put that file beside it")


def sha256_of_file(path: Path | str, error: type[BadInput] = BadInput) -> str:
    """Return the SHA-256 of a file's bytes in hexadecimal."""
    path = require_file(path, error)
    digest = hashlib.sha256()
    try:
        with path.open("rb") as stream:
            while chunk := stream.read(_CHUNK_BYTES):
                digest.update(chunk)
    except OSError as problem:
        raise error(f"{path}: cannot be read ({problem.strerror})") from problem
    return digest.hexdigest()


def source_file(path: Path | str) -> SourceFile:
    """Return the record of a source: its name and its hash."""
    return SourceFile(file=Path(path).name, sha256=sha256_of_file(path))


def parse_json(text: str, name: str, error: type[BadInput] = BadInput, expected: str = "a JSON file") -> Any:
    """Return the content of a JSON text; raise `error` if it is invalid or nested too deeply.

    NaN and infinity pass, as Python has it: the schema, which can name the key, refuses them.
    """
    try:
        return json.loads(text)
    except json.JSONDecodeError as problem:
        raise error(
            f"{name}: expected {expected}, but this is not JSON: {problem.msg} at line {problem.lineno}, "
            f"column {problem.colno}"
        ) from problem
    except RecursionError as problem:
        raise error(f"{name}: its brackets are nested too deeply for any file of this program") from problem
    except ValueError as problem:  # an integer of thousands of digits
        raise error(
            f"{name}: expected {expected}, but this is not JSON: {str(problem).split(';')[0][:200]}"
        ) from problem

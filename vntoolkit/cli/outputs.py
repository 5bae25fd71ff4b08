"""Where a verb will write: refused before minutes of work, not after."""

from __future__ import annotations

import errno
import os
from pathlib import Path

from vntoolkit.errors import BadInput, CannotWrite
from vntoolkit.io.atomic import cannot_write

JSON, PAGE, PICTURE, MESH = (".json",), (".html",), (".png", ".svg"), (".ply", ".obj")


def require_output(path: Path | None, suffixes: tuple[str, ...] = ()) -> None:
    """Raise unless a file of that name can be written; None passes. Nothing is made.

    suffixes: one of which the name must end in, or none for any.
    """
    if path is None:
        return
    if suffixes and path.suffix.lower() not in suffixes:
        raise BadInput(f"{path}: expected a name that ends in {' or '.join(suffixes)}")
    try:
        if path.is_dir():
            raise CannotWrite(f"{path}: is a folder, expected the name of a file to write")
        nearest = next(folder for folder in path.absolute().parents if folder.exists())
        fault = 0 if os.access(nearest, os.W_OK | os.X_OK) else errno.EACCES
        fault = fault if nearest.is_dir() else errno.ENOTDIR
        if fault:
            raise OSError(fault, os.strerror(fault))
    except OSError as error:
        raise cannot_write(path, error) from error

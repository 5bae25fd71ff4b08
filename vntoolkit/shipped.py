"""Files that the package ships: those of data/, beside the package in a checkout and in it once installed."""

from pathlib import Path

from vntoolkit.errors import BadInput

_PACKAGE = Path(__file__).parent
_FOLDERS = (_PACKAGE.parent / "data", _PACKAGE / "data")


def shipped_files() -> dict[str, Path]:
    """Return the files for users by name, such as walk.bvh."""
    found: dict[str, Path] = {}
    for folder in _FOLDERS:
        found |= {path.name: path for path in sorted(folder.glob("*.*")) if path.suffix != ".md"}
    return found


def shipped_file(name: str) -> Path:
    """Return one file by its path in data/. Raises `BadInput` where it is missing."""
    for folder in _FOLDERS:
        if (folder / name).is_file():
            return folder / name
    raise BadInput(f"data/{name}: expected the file in {_FOLDERS[-1]}, found none; install the package again")

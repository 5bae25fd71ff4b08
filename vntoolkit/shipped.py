"""Files that the package ships: data/ and the guide's page of findings, in a checkout beside the package."""

import re
from pathlib import Path

from vntoolkit.errors import BadInput

_PACKAGE = Path(__file__).parent
_FOLDERS = (_PACKAGE.parent / "data", _PACKAGE / "data")
_GUIDE = "docs/wrong.md"


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


def guide_page() -> Path:
    """Return the page that messages name as docs/wrong.md: relative to where one is, if it lies there."""
    found = next((each for each in (_PACKAGE.parent, _PACKAGE) if (each / _GUIDE).is_file()), Path())
    return Path(_GUIDE) if found == Path.cwd() else found / _GUIDE


def guide_section(name: str) -> list[str]:
    """Return the paragraphs of a section of that page, as plain text; none where it has no such section."""
    _, _, rest = guide_page().read_text(encoding="utf-8").partition(f"## `{name}`\n")
    plain = (
        re.sub(r"\[([^]]+)\]\([^)]*\)", r"\1", rest.partition("\n## ")[0]).replace("**", "").replace("`", "")
    )
    return [" ".join(paragraph.split()) for paragraph in plain.split("\n\n") if paragraph.strip()]


def with_guide(message: str) -> str:
    """Return a message with the path of that page as it is on this machine."""
    return message.replace(f"see {_GUIDE}#", f"see {guide_page()}#")

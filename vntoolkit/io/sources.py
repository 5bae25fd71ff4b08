"""From what a person typed to the files of a capture, in the order of their numbers."""

from __future__ import annotations

import glob
import re
from enum import Enum
from pathlib import Path

from vntoolkit.errors import BadCapture
from vntoolkit.io.files import require_file
from vntoolkit.io.images import SUFFIXES

_VIDEO_SUFFIXES = (".mkv", ".mp4", ".mov", ".avi", ".webm", ".mxf", ".m4v")
_EXPECTED = "expected a video, an image, a folder of images, or a pattern such as frame_%04d.png"
_PRINTF = re.compile(r"%(0?)(\d*)d")


class CaptureKind(Enum):
    """What a capture consists of."""

    VIDEO = "video"
    IMAGE = "image"
    SEQUENCE = "image sequence"


def find_capture_files(source: Path | str) -> tuple[CaptureKind, tuple[Path, ...]]:
    """Return the kind and the files of a video, an image, a folder of images or a pattern.

    A name that exists is taken as it is, even if it holds `%` or `*`. Raises `BadCapture`.
    """
    try:
        return _find(str(source))
    except OSError as problem:  # of a name that is too long, or a folder that may not be looked into
        raise BadCapture(f"{source}: cannot be read ({problem.strerror})") from problem


def _find(text: str) -> tuple[CaptureKind, tuple[Path, ...]]:
    path = Path(text)
    if path.is_dir():
        return CaptureKind.SEQUENCE, _in_folder(path)
    if not path.exists() and _PRINTF.search(path.name):
        return CaptureKind.SEQUENCE, _by_printf(path)
    if not path.exists() and glob.has_magic(text):
        found = tuple(sorted(map(Path, glob.glob(text)), key=natural_key))  # noqa: PTH207
        if not found:
            raise BadCapture(f"{text}: no file matches this pattern; is the folder right?")
        return CaptureKind.SEQUENCE, found
    require_file(path, BadCapture)
    if path.suffix.lower() in SUFFIXES:
        return CaptureKind.IMAGE, (path,)
    return CaptureKind.VIDEO, (path,)


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Sort key by which `f2.png` comes before `f10.png`."""
    parts = re.split(r"(\d+)", path.name)
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part.lower()) for part in parts if part)


def _in_folder(folder: Path) -> tuple[Path, ...]:
    files = [
        path
        for path in folder.iterdir()
        if path.suffix.lower() in SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]
    if not files:
        videos = [path.name for path in sorted(folder.iterdir()) if path.suffix.lower() in _VIDEO_SUFFIXES]
        instead = f"name the video, {folder / videos[0]}" if videos else _EXPECTED
        raise BadCapture(f"{folder}: holds no image ({', '.join(SUFFIXES)}); {instead}")
    return tuple(sorted(files, key=natural_key))


def _by_printf(pattern: Path) -> tuple[Path, ...]:
    match = _PRINTF.search(pattern.name)
    assert match is not None
    before, after = pattern.name[: match.start()], pattern.name[match.end() :]
    width = int(match[2] or 1)
    wanted = re.compile(re.escape(before) + r"(\d+)" + re.escape(after))
    found = []
    for path in pattern.parent.iterdir() if pattern.parent.is_dir() else ():
        hit = wanted.fullmatch(path.name)
        if hit and len(hit[1]) == max(width, len(str(int(hit[1])))):
            found.append((int(hit[1]), path))
    if not found:
        raise BadCapture(f"{pattern}: no file matches this pattern; is the folder right?")
    return tuple(path for _, path in sorted(found))

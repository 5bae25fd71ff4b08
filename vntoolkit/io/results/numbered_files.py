"""Files that have a frame's number for a name, `000012.exr`, and frames in words."""

import contextlib
from collections.abc import Container, Iterable, Iterator
from pathlib import Path


def numbers_on_disk(folder: Path, suffix: str) -> list[int]:
    """Return the numbers of the files `000012.exr` of a folder, in order."""
    return sorted(number for number, _ in _numbered(folder, suffix))


def numbers_in_words(numbers: Iterable[int]) -> str:
    """Return frames in words: "frame 3", "frames 3 to 5, 9"."""
    runs: list[list[int]] = []
    for number in sorted(numbers):
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    words = [str(run[0]) if len(run) == 1 else f"{run[0]} to {run[-1]}" for run in runs]
    shown = words if len(words) <= 4 else [*words[:3], f"and {len(words) - 3} more places"]
    return f"frame{'' if len(runs) == 1 and len(runs[0]) == 1 else 's'} {', '.join(shown)}"


def remove_numbered(folder: Path, suffix: str, numbers: Container[int]) -> None:
    """Remove the files `000012.exr` of a folder that have these numbers, and the folder once it is empty."""
    if not folder.is_dir():
        return
    for number, path in _numbered(folder, suffix):
        if number in numbers:
            path.unlink()
    remove_if_empty(folder)


def remove_if_empty(folder: Path) -> None:
    """Remove a folder in which nothing of the user's is left."""
    with contextlib.suppress(OSError):
        folder.rmdir()


def _numbered(folder: Path, suffix: str) -> Iterator[tuple[int, Path]]:
    for path in folder.glob(f"[0-9][0-9][0-9][0-9][0-9][0-9]*{suffix}"):
        if path.stem.isdigit() and path.name == f"{int(path.stem):06d}{suffix}":
            yield int(path.stem), path

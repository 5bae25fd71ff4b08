"""Which files are the frames of a capture, and which number each has."""

import glob
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from itertools import pairwise
from pathlib import Path

import numpy as np

from vntoolkit.errors import BadCapture
from vntoolkit.io.files import require_file
from vntoolkit.io.footage.stated import IMAGE_SUFFIXES, RAW_SUFFIXES

_IMAGES = (*IMAGE_SUFFIXES, *RAW_SUFFIXES)
_VIDEO_SUFFIXES = (".mkv", ".mp4", ".mov", ".avi", ".webm", ".mxf", ".m4v")
_EXPECTED = "expected a video, an image, a folder of images, or a pattern such as frame_%04d.png"
_PRINTF = re.compile(r"%(0?)(\d*)d")
_LARGEST_NUMBER = 10**6  # a number beyond is a moment or a serial number, not a count of frames
_PERIODS = (0, 24, 60, 99, 100, 999, 1000, 9999, 10000)  # of one count; of clocks; of counters from 1 or 0
_NAMED = 5  # files named in one message


class CaptureKind(Enum):
    """What a capture consists of."""

    VIDEO = "video"
    IMAGE = "image"
    SEQUENCE = "image sequence"


@dataclass(frozen=True, kw_only=True)
class CaptureFiles:
    """The files of a capture, in order.

    numbers: of the frame that each image is, from 0; one that is missing leaves its number free. missing:
    name of the missing file by frame number. left_out: images of a folder whose names do not follow the
    frames' pattern. stated: the number in each file's name, where it counts frames; else empty. topic: of an
    MCAP recording, empty for its only one; None for other footage.
    """

    kind: CaptureKind
    files: tuple[Path, ...]
    numbers: tuple[int, ...] = ()
    missing: Mapping[int, str] = field(default_factory=dict)
    left_out: tuple[Path, ...] = ()
    stated: tuple[int, ...] = ()
    topic: str | None = None


def find_capture_files(source: Path | str) -> CaptureFiles:
    """Return the files of a video, an image, a folder of images or a pattern.

    A name that exists is taken as it is, even if it holds `%` or `*`. The frames of a folder are the images
    whose names differ by their numbers only, where there are such. Raises `BadCapture`.
    """
    try:
        return _find(str(source))
    except OSError as problem:  # of a name that is too long, or a folder that may not be looked into
        raise BadCapture(f"{source}: cannot be read ({problem.strerror})") from problem


def text_of_names(names: list[str]) -> str:
    """Return names as a phrase; of many, the first few and how many more."""
    text = ", ".join(names[:_NAMED])
    return text if len(names) <= _NAMED else f"{text} and {len(names) - _NAMED} more"


def _find(text: str) -> CaptureFiles:
    path = Path(text)
    file, dot, topic = text.rpartition(".mcap:")
    if (dot or path.suffix.lower() == ".mcap") and not (dot and path.exists()):
        path = require_file(Path(file + dot[:-1]) if dot else path, BadCapture)
        return CaptureFiles(kind=CaptureKind.VIDEO, files=(path,), topic=topic if dot else "")
    if path.is_dir():
        files, left_out = _in_folder(path)
        return _sequence(files, left_out)
    if not path.exists() and _PRINTF.search(path.name):
        return _sequence(_by_printf(path))
    if not path.exists() and glob.has_magic(text):
        found = tuple(map(Path, glob.glob(text)))  # noqa: PTH207
        if not found:
            raise BadCapture(f"{text}: no file matches this pattern; is the folder right?")
        return _sequence(found)
    require_file(path, BadCapture)
    if path.suffix.lower() in _IMAGES:
        return CaptureFiles(kind=CaptureKind.IMAGE, files=(path,), numbers=(0,))
    return CaptureFiles(kind=CaptureKind.VIDEO, files=(path,))


def _sequence(files: tuple[Path, ...], left_out: tuple[Path, ...] = ()) -> CaptureFiles:
    files = tuple(sorted(files, key=natural_key))
    stated = stated_numbers(files)
    numbers = tuple(range(len(files)))
    missing: dict[int, str] = {}
    steps = {after - before for before, after in pairwise(stated)}
    # numbers without a common step, such as the milliseconds of a clock, count no frames
    counts = bool(steps) and all(step % min(steps) == 0 for step in steps)
    if counts:
        numbers = tuple((number - stated[0]) // min(steps) for number in stated)
        if numbers[-1] > _LARGEST_NUMBER:
            raise BadCapture(
                f"{files[-1]}: is number {numbers[-1]} of its sequence, expected at most {_LARGEST_NUMBER}; "
                "number the frames one after the other"
            )
        for k, (before, after) in enumerate(pairwise(numbers)):
            for number in range(before + 1, after):
                missing[number] = _name_with_number(files[k].name, stated, stated[0] + number * min(steps), k)
    return CaptureFiles(
        kind=CaptureKind.SEQUENCE,
        files=files,
        numbers=numbers,
        missing=missing,
        left_out=left_out,
        stated=stated if counts else (),
    )


def stated_numbers(files: tuple[Path, ...]) -> tuple[int, ...]:
    """Return the number in each name, ascending, if the names differ in one number alone; else nothing."""
    if len({pattern_of(path) for path in files}) > 1:
        return ()
    parts = [re.findall(r"\d+", path.name) for path in files]
    changing = [column for column in zip(*parts, strict=True) if len(set(map(int, column))) > 1]
    numbers = tuple(map(int, changing[0])) if len(changing) == 1 else ()
    return numbers if len(set(numbers)) == len(numbers) else ()


def _name_with_number(name: str, stated: tuple[int, ...], number: int, place: int) -> str:
    """Return the name with its counting number replaced, as wide as it was."""
    pieces = re.split(r"(\d+)", name)
    for k in range(1, len(pieces), 2):
        if int(pieces[k]) == stated[place]:
            pieces[k] = str(number).zfill(len(pieces[k]))
            break
    return "".join(pieces)


def pattern_of(path: Path) -> str:
    """Return a file's name with `#` for each number in it: frames of one sequence have one pattern."""
    return re.sub(r"\d+", "#", path.name.lower())


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Sort key by which `f2.png` comes before `f10.png`."""
    parts = re.split(r"(\d+)", path.name)
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part.lower()) for part in parts if part)


def _in_folder(folder: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Return the frames of a folder, and the images in it that are none."""
    there = sorted((path for path in folder.iterdir() if path.is_file()), key=natural_key)
    files = [path for path in there if path.suffix.lower() in _IMAGES and not path.name.startswith(".")]
    videos = [path.name for path in there if path.suffix.lower() in _VIDEO_SUFFIXES]
    if not files:
        instead = f"name the video, {folder / videos[0]}" if videos else _EXPECTED
        raise BadCapture(f"{folder}: holds no image ({', '.join(_IMAGES[:9])}, …); {instead}")
    by_pattern: dict[str, list[Path]] = defaultdict(list)
    for path in files:
        by_pattern[pattern_of(path)].append(path)
    groups = sorted(by_pattern.values(), key=len, reverse=True)
    series = [one for group in groups if len(group) > 1 for one in _takes(group)]
    if len(series) > 1:
        ways = " or ".join(f"'{folder / _glob_of(one)}'" for one in series[:2])
        raise BadCapture(
            f"{folder}: holds {len(series)} series of images, such as {series[0][0].name} and "
            f"{series[1][0].name}; name the one that is meant: {ways}; or all of one pattern of names, as "
            f"'{folder / _glob_of(groups[0])}'"
        )
    if videos:
        raise BadCapture(
            f"{folder}: holds the video {videos[0]} and images, such as {files[0].name}; name the video, "
            f"{folder / videos[0]}, or the images, '{folder / _glob_of(groups[0])}'"
        )
    if not series:  # stills that are each named on their own
        return tuple(files), ()
    return tuple(groups[0]), tuple(path for group in groups[1:] for path in group)


def _takes(files: list[Path]) -> list[list[Path]]:
    """Return the files of one pattern apart, where each take or camera counts for itself.

    Numbers that do not count, such as those of a clock, part nothing, nor does a count that goes on from one
    number before it to the next, or begins anew there as clocks and cameras do.
    """
    numbers = np.array([[int(number) for number in re.findall(r"\d+", path.name)] for path in files])
    changing = np.flatnonzero((numbers != numbers[0]).any(axis=0))
    if len(changing) < 2:
        return [files]
    takes: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for k, row in enumerate(numbers[:, changing].tolist()):
        takes[tuple(row[:-1])].append(k)
    counts = [np.sort(numbers[take, changing[-1]]) for take in takes.values()]
    steps = np.concatenate([np.diff(count) for count in counts])
    if not len(steps) or not steps.min() or (steps % steps.min()).any():
        return [files]
    begin_alike = len({int(count[0]) for count in counts}) == 1
    gaps = [int(before[-1] + steps.min() - after[0]) for before, after in pairwise(counts)]
    if not begin_alike and not set(gaps).difference(_PERIODS):
        return [files]
    return [[files[k] for k in take] for take in takes.values()]


def _glob_of(files: list[Path]) -> str:
    """Return the pattern of a series: `*` for each number that is not the same in all of them."""
    parts = zip(*(re.split(r"(\d+)", path.name) for path in files), strict=True)
    return "".join(part[0] if len(set(part)) == 1 else "*" for part in parts)


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
            found.append(path)
    if not found:
        raise BadCapture(f"{pattern}: no file matches this pattern; is the folder right?")
    return tuple(found)

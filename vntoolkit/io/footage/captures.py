"""Captures: a video, an image, a folder of images or a pattern, read as linear colour frames."""

from __future__ import annotations

import glob
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import LinearImage
from vntoolkit.checks import require_in_range, require_positive, require_shape
from vntoolkit.errors import BadCapture
from vntoolkit.io.files import opened, require_file
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.images import SUFFIXES, header_of_stream, read_image
from vntoolkit.io.footage.video import VideoReader
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.transfer import Transfer

_VIDEO_SUFFIXES = (".mkv", ".mp4", ".mov", ".avi", ".webm", ".mxf", ".m4v")
_EXPECTED = "expected a video, an image, a folder of images, or a pattern such as frame_%04d.png"
_PRINTF = re.compile(r"%(0?)(\d*)d")


@dataclass(frozen=True, kw_only=True, eq=False)
class CaptureOptions:
    """How the footage is read.

    transfer: curve and levels of the stored values. background: an image of the scene under ambient light
    only (path, or linear (h, w, 3) array), subtracted from every frame; None for none. max_megapixels: refuse
    larger frames before memory is asked for; None for the limit of `reading_limits`. bits: significant bits
    of an integer sample where the file does not tell (12 for 12-bit values stored in 16-bit PNG); None for
    all. frame_rate_hz: rate of an image sequence, frames per second (a video brings its own). threads:
    decoding threads.
    """

    transfer: Transfer = field(default_factory=Transfer)
    background: Path | str | LinearImage | None = None
    max_megapixels: float | None = None
    bits: int | None = None
    frame_rate_hz: float = 30.0
    threads: int = 2

    def __post_init__(self) -> None:
        require_positive(self.frame_rate_hz, "capture: frame rate")
        require_positive(self.threads, "capture: threads")
        if self.max_megapixels is not None:
            require_positive(self.max_megapixels, "capture: max_megapixels")
        if self.bits is not None:
            require_in_range(self.bits, 1, 16, "capture: bits")


@dataclass(frozen=True, kw_only=True)
class CaptureInfo:
    """What a capture holds.

    width, height: pixels. frame_count: frames that can be read. frame_rate_hz: per second. pixel_format:
    FFmpeg's name, or such as `PNG 16-bit`. bits: significant bits of an integer sample (32: float). codec:
    of the video, or the image format. chroma: `4:4:4`, `4:2:2`, `4:2:0`, `grey`. files: what it consists of.
    promised_frame_count: what the header promises; more than frame_count means that the video is cut off.
    stated_transfer: the transfer curve that a video states, empty for none.
    """

    kind: CaptureKind
    width: int
    height: int
    frame_count: int
    frame_rate_hz: float
    pixel_format: str
    bits: int
    codec: str
    chroma: str
    files: tuple[Path, ...]
    promised_frame_count: int
    stated_transfer: str = ""


class Capture:
    """An opened capture. Frames are decoded one at a time, from any frame on."""

    def __init__(
        self, info: CaptureInfo, options: CaptureOptions, reader: VideoReader | None, name: str
    ) -> None:
        self.info = info
        self.options = options
        self.name = name
        self._reader = reader
        self._background = self._read_background()

    def __len__(self) -> int:
        return self.info.frame_count

    @property
    def background(self) -> LinearImage | None:
        """The linear background that `frames` subtracts, (h, w, 3), or None."""
        return self._background

    def frames(self, start: int = 0, stop: int | None = None, step: int = 1) -> Iterator[LinearFrame]:
        """Yield the linear frames start, start + step, … below stop; raise `BadCapture` on a bad one."""
        for frame in self.encoded_frames(start, stop, step):
            yield linear_frame_from_encoded(frame, self.options.transfer, self._background)

    def frame(self, number: int) -> LinearFrame:
        """Return one linear frame."""
        return next(self.frames(number, number + 1))

    def encoded_frames(
        self, start: int = 0, stop: int | None = None, step: int = 1
    ) -> Iterator[EncodedFrame]:
        """Yield the frames as stored, background included, for a kernel that decodes them itself."""
        FrameRange(start=start, stop=stop, step=step).numbers(self.info.frame_count)
        if self._reader is None:
            yield from self._images(start, stop, step)
            return
        for number, values in self._reader.frames(start, stop, step):
            yield EncodedFrame(
                values=values, bits=self.info.bits, number=number, name=f"{self.name}, frame {number}"
            )

    def readable_alone(self, number: int, within: int) -> int:
        """Return the nearest frame, at most `within` away, that needs no other to be decoded, or `number`."""
        if self._reader is None:
            return number
        nearest = self._reader.index.nearest_key_frame(number)
        return nearest if abs(nearest - number) <= within else number

    def _images(self, start: int, stop: int | None, step: int) -> Iterator[EncodedFrame]:
        for number in range(len(self.info.files))[start:stop:step]:
            path = self.info.files[number]
            values = read_image(path, max_megapixels=self.options.max_megapixels)
            height, width = values.shape[:2]
            if (width, height) != (self.info.width, self.info.height):
                raise BadCapture(
                    f"{path}: frame {number} is {width}×{height}, the first one {self.info.width}×"
                    f"{self.info.height}: a capture has one size"
                )
            bits = _bits(values, self.options, path)
            yield EncodedFrame(values=values, bits=bits, number=number, name=str(path))

    def _read_background(self) -> LinearImage | None:
        background = self.options.background
        if background is None:
            return None
        name = "background"
        if isinstance(background, (str, Path)):
            name = str(background)
            values = read_image(background, max_megapixels=self.options.max_megapixels)
            bits = _bits(values, self.options, background)
            encoded = EncodedFrame(values=values, bits=bits, number=0, name=name)
            background = linear_frame_from_encoded(encoded, self.options.transfer).rgb
        require_shape(background, (None, None, 3), name, BadCapture)
        height, width = background.shape[:2]
        if (width, height) != (self.info.width, self.info.height):
            raise BadCapture(
                f"{name}: the background is {width}×{height}, the footage {self.info.width}×"
                f"{self.info.height}: film both with the same settings"
            )
        return np.asarray(background, dtype=np.float32)


def open_capture(source: Path | str, options: CaptureOptions | None = None) -> Capture:
    """Open a video, an image, a folder of images, or a printf (`f_%04d.png`) or glob (`f_*.png`) pattern.

    Images are ordered by the numbers in their names. Raises `BadCapture` with one line.
    """
    options = options or CaptureOptions()
    kind, files = find_capture_files(source)
    if kind is CaptureKind.VIDEO:
        reader = VideoReader(files[0], max_megapixels=options.max_megapixels, threads=options.threads)
        return Capture(_info_of_video(reader), options, reader, str(source))
    return Capture(_info_of_images(kind, files, options), options, None, str(source))


def _info_of_video(reader: VideoReader) -> CaptureInfo:
    return CaptureInfo(
        kind=CaptureKind.VIDEO,
        width=reader.width,
        height=reader.height,
        frame_count=len(reader.index.times),
        frame_rate_hz=reader.frame_rate_hz,
        pixel_format=reader.pixel_format.name,
        bits=reader.bits,
        codec=reader.codec,
        chroma=reader.pixel_format.chroma,
        files=(reader.path,),
        promised_frame_count=reader.index.promised,
        stated_transfer=reader.stated_transfer,
    )


def _info_of_images(kind: CaptureKind, files: tuple[Path, ...], options: CaptureOptions) -> CaptureInfo:
    first = read_image(files[0], max_megapixels=options.max_megapixels)
    with opened(files[0], BadCapture) as stream:
        header = header_of_stream(stream, str(files[0]))
    return CaptureInfo(
        kind=kind,
        width=first.shape[1],
        height=first.shape[0],
        frame_count=len(files),
        frame_rate_hz=options.frame_rate_hz,
        pixel_format=f"{header.format} {header.bits}-bit{' float' if header.floating else ''}",
        bits=_bits(first, options, files[0]),
        codec=header.format,
        chroma="grey" if header.channels < 3 else header.chroma,
        files=files,
        promised_frame_count=len(files),
    )


def _bits(values: npt.NDArray[Any], options: CaptureOptions, path: Path | str) -> int:
    if values.dtype == np.float32:
        return 32
    stored = values.dtype.itemsize * 8
    if options.bits is not None and options.bits > stored:
        raise BadCapture(
            f"{path}: samples of {stored} bits cannot hold {options.bits}; give bits up to {stored}"
        )
    return options.bits or stored


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

"""Captures: a video, an image, a folder of images or a pattern, read as linear colour frames."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from vntoolkit.arrays import LinearImage
from vntoolkit.checks import require_positive, require_shape
from vntoolkit.display import Displayed, Facts, Picture
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.footage.decoding import EncodedFrame, linear_frame_from_encoded
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.sequence import (
    CaptureFiles,
    CaptureKind,
    find_capture_files,
    text_of_names,
)
from vntoolkit.options.footage import Gaps, SensorOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer

if TYPE_CHECKING:
    from vntoolkit.io.recordings.recorded import Stamp


@dataclass(frozen=True, kw_only=True, eq=False)
class CaptureOptions:
    """How the footage is read.

    transfer: curve and levels of the stored values; None for the curve that the file states, else linear.
    background: the scene under ambient light only (path of an image, or of footage whose first frame counts,
    or a linear (h, w, 3) array), subtracted from every frame; None for none. max_megapixels: refuse larger
    frames before memory is asked for; None for the limit of `reading_limits`. sensor: how samples of the
    sensor itself are read. response: of the scene's lights; with it, and the transfer, fine detail of video
    with subsampled chroma is taken from its luma. frame_rate_hz: at which it was filmed, whatever
    a video states; None for what it states. gaps: what to do where numbers of an image sequence are missing;
    frames after a gap keep their numbers. threads: for decoding.
    """

    transfer: Transfer | None = None
    background: Path | str | LinearImage | None = None
    max_megapixels: float | None = None
    sensor: SensorOptions = field(default_factory=SensorOptions)
    response: LightResponse | None = None
    frame_rate_hz: float | None = None
    gaps: Gaps = Gaps.REFUSE
    threads: int = 2

    def __post_init__(self) -> None:
        if self.frame_rate_hz is not None:
            require_positive(self.frame_rate_hz, "capture: frame rate")
        require_positive(self.threads, "capture: threads")
        if self.max_megapixels is not None:
            require_positive(self.max_megapixels, "capture: max_megapixels")


@dataclass(frozen=True, kw_only=True)
class CaptureInfo(CaptureFiles):
    """What a capture holds, beside its files.

    width, height: pixels. frame_count: frames that can be read, and gaps in an image sequence. frame_rate_hz:
    per second, None for stills. pixel_format: FFmpeg's name, or such as `PNG 16-bit`. bits: significant bits
    of an integer sample (32: float). codec: of the video, or the image format. chroma: `4:4:4`, `4:2:2`,
    `4:2:0`, `grey`, `Bayer`. promised_frame_count: what the header declares; more than frame_count means that
    the video is cut off. stated_transfer: the curve that the file states, as `Transfer` reads it where it can
    be undone; empty for none. stated_yuv, taken_yuv: matrix and range, as the file states them and as they
    are taken; empty for no YUV. orientation: what was done to turn the frames upright, empty for nothing;
    width and height are those of the upright picture. times_s: when each frame of a video of varying rate is
    shown, seconds from the first; empty for an even rate. unusable_times: what is wrong with the times that a
    video states, empty for nothing. stated_focal_px: focal length that a photograph states, as that of a
    picture of 24×36 mm with the same diagonal; None for none.
    """

    width: int
    height: int
    frame_count: int
    frame_rate_hz: float | None
    pixel_format: str
    bits: int
    codec: str
    chroma: str
    promised_frame_count: int
    stated_transfer: str = ""
    stated_yuv: str = ""
    taken_yuv: str = ""
    orientation: str = ""
    times_s: tuple[float, ...] = ()
    unusable_times: str = ""
    stated_focal_px: float | None = None


class FrameReader(Protocol):
    """Reads the frames of a video, of images or of a recording by their numbers."""

    @property
    def info(self) -> CaptureInfo:
        """What they hold."""
        ...

    def frames(self, start: int = 0, stop: int | None = None, step: int = 1) -> Iterator[EncodedFrame]:
        """Yield those that are there."""
        ...

    def nearest_key_frame(self, number: int) -> int:
        """Return the nearest frame that is there and needs no other to be decoded."""
        ...


class Capture(Displayed):
    """An opened capture. Frames are decoded one at a time, from any frame on.

    transfer: curve and levels that its stored values are read with. background: the linear background that
    `frames` subtracts, (h, w, 3), or None.
    """

    def __init__(self, reader: FrameReader, options: CaptureOptions, name: str) -> None:
        self.info = reader.info
        self.options = options
        self.transfer = options.transfer or _stated_transfer(self.info, name)
        self.name = name
        self._reader = reader
        self.background = self._read_background()

    def __len__(self) -> int:
        return self.info.frame_count

    def __iter__(self) -> Iterator[LinearFrame]:
        return self.frames()

    def _facts(self) -> Facts:
        rate = self.info.frame_rate_hz
        return {
            "name": self.name,
            "size": f"{self.info.width}×{self.info.height}",
            "frames": str(len(self)) + ("" if rate is None else f" at {rate:g} Hz"),
            "stored as": f"{self.info.codec} {self.info.chroma} {self.info.bits} bits",
            "transfer": self.transfer.to_text(),
        }

    def _picture(self) -> Picture | None:
        return self.frame(self.present[0])._picture() if len(self.present) else None

    def frames(self, start: int = 0, stop: int | None = None, step: int = 1) -> Iterator[LinearFrame]:
        """Yield the linear frames start, start + step, … below stop; raise `BadCapture` on a bad one."""
        for frame in self.encoded_frames(start, stop, step):
            yield linear_frame_from_encoded(frame, self.transfer, self.background)

    def frame(self, number: int) -> LinearFrame:
        """Return one linear frame; raise `BadCapture` where its file is missing."""
        return linear_frame_from_encoded(self.encoded(number), self.transfer, self.background)

    def encoded(self, number: int) -> EncodedFrame:
        """Return one frame as stored; raise `BadCapture` where its file is missing."""
        if number in self.info.missing:
            raise BadCapture(f"{self.name}: frame {number} is missing: no file {self.info.missing[number]}")
        (frame,) = self.encoded_frames(number, number + 1)  # to the end, so that decoding can go on from here
        return frame

    @property
    def present(self) -> Sequence[int]:
        """Numbers of the frames that are there, ascending."""
        return self.info.numbers or range(len(self))

    def encoded_frames(
        self, start: int = 0, stop: int | None = None, step: int = 1
    ) -> Iterator[EncodedFrame]:
        """Yield the frames as stored, background included, for a kernel that decodes them itself.

        A frame whose file is missing is left out.
        """
        FrameRange(start=start, stop=stop, step=step).numbers(self.info.frame_count)
        return self._reader.frames(start, stop, step)

    def readable_alone(self, number: int, within: int) -> int:
        """Return the nearest frame, at most `within` away, that needs no other to be decoded, or `number`.

        For a frame whose file is missing, the nearest one that is there.
        """
        nearest = self._reader.nearest_key_frame(number)
        return nearest if abs(nearest - number) <= within or number in self.info.missing else number

    @property
    def stamps(self) -> "tuple[Stamp, ...]":
        """When each picture of an MCAP recording was filmed; empty for other footage."""
        return getattr(self._reader, "stamps", ())

    def _read_background(self) -> LinearImage | None:
        background = self.options.background
        if background is None:
            return None
        name = "background"
        if isinstance(background, (str, Path)):
            name = str(background)
            how = replace(self.options, background=None, transfer=self.transfer, gaps=Gaps.SKIP)
            footage = open_capture(background, how)
            curves = {footage.info.stated_transfer, self.info.stated_transfer} - {""}
            if len(curves) > 1:
                raise BadCapture(
                    f"{name}: states the transfer curve {footage.info.stated_transfer}, the footage "
                    f"{self.info.stated_transfer}: film both with the same settings"
                )
            background = footage.frame(0).rgb
        require_shape(background, (None, None, 3), name, BadCapture)
        require_size_of(self.info, (background.shape[1], background.shape[0]), name)
        return np.asarray(background, dtype=np.float32)


def require_size_of(footage: CaptureInfo, size: tuple[int, int], background: str) -> None:
    """Raise `BadCapture` where a background's width and height are not the footage's."""
    if size != (footage.width, footage.height):
        raise BadCapture(
            f"{background}: the background is {size[0]}×{size[1]}, the footage {footage.width}×"
            f"{footage.height}: film both with the same settings"
        )


def open_capture(source: Path | str, options: CaptureOptions | None = None) -> Capture:
    """Open a video, an image, a folder of images, or a printf (`f_%04d.png`) or glob (`f_*.png`) pattern.

    Images are ordered by the numbers in their names. Of an MCAP recording, `touch.mcap:/camera/image_raw`
    names the topic where it holds pictures on several. Raises `BadCapture` with one line.
    """
    options = options or CaptureOptions()
    found = find_capture_files(source)
    if found.missing and options.gaps is Gaps.REFUSE:
        raise BadCapture(
            f"{source}: {len(found.missing)} of {found.numbers[-1] + 1} files of the sequence are missing: "
            f"{text_of_names(list(found.missing.values()))}; copy them too; `reconstruct` and `session` go "
            "on without them by --gaps skip, and the other frames keep their numbers"
        )
    return Capture(_reader(found, options), options, str(source))


def _reader(found: CaptureFiles, options: CaptureOptions) -> FrameReader:
    if found.topic is not None:
        from vntoolkit.io.recordings.mcap_footage import RecordingReader

        return RecordingReader(found.files[0], found.topic, options)
    if found.kind is CaptureKind.VIDEO:
        from vntoolkit.io.footage.video import VideoReader

        return VideoReader(found.files[0], options)
    from vntoolkit.io.footage.image_sequence import ImageReader

    return ImageReader(found, options)


def _stated_transfer(info: CaptureInfo, name: str) -> Transfer:
    stated = info.stated_transfer
    try:
        transfer = Transfer.from_text(stated or "linear")
    except BadInput as problem:
        raise BadCapture(
            f"{name}: states the transfer curve {stated}, which is not read; convert the "
            "footage, or give --transfer with the curve that is meant"
        ) from problem
    if info.bits == 32 and transfer != Transfer():
        raise BadCapture(
            f"{name}: states the transfer curve {stated} of floating-point samples, which are read as "
            "linear; save linear ones, or 16 bits"
        )
    return transfer

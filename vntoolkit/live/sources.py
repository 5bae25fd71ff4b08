"""Live sources: a camera, or a file played at its frame rate."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.decoding import EncodedFrame

_MOST_CAMERAS = 100  # OpenCV reads the hundreds of a number as the driver to take; a negative one crashes it
_FAILED_READS = 30  # in a row: the camera is gone
_LATEST_FRAMES = 3  # a file's frame that is later than so many is skipped


@dataclass(frozen=True, kw_only=True, eq=False)
class TimedFrame:
    """A frame and when it was there, in seconds of `time.perf_counter`."""

    frame: EncodedFrame
    arrived_s: float


class LiveSource(Protocol):
    """What delivers frames at its own pace."""

    name: str
    width: int
    height: int
    frame_rate_hz: float
    skipped: int  # frames that the source itself could not give in time

    def frames(self) -> Iterator[TimedFrame]:
        """Yield frames as they come, until the source ends."""
        ...


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """What is asked of a camera, which gives the nearest that it can.

    width: width in pixels of the picture that the camera is asked for; after crop and rectification it must
    be the rig's. Not for a video, which has its own. height: the same for the height. rate: frames a second
    that the camera is asked for; a video plays at its own with --realtime, else as fast as it can be read.
    """

    width: int = 1280
    height: int = 720
    rate: float = 30.0

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1 or not 0 < self.rate < math.inf:
            raise BadInput(
                "camera: expected a positive width, height and rate, got "
                f"{self.width}×{self.height} pixels and {self.rate:g} a second"
            )


class CameraSource:
    """A camera of this computer, by number, through OpenCV (Video4Linux on Linux)."""

    def __init__(self, number: int, options: CameraOptions | None = None) -> None:
        import cv2

        if not 0 <= number < _MOST_CAMERAS:
            raise BadInput(
                f"camera: expected a number from 0, the first camera, to {_MOST_CAMERAS - 1}, got {number}"
            )
        options = options or CameraOptions()
        self.skipped = 0  # a driver does not tell
        self.name = f"camera {number}"
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)  # the one line below tells
        self._camera = cv2.VideoCapture(number)
        if not self._camera.isOpened():
            raise BadCapture(f"camera {number}: cannot be opened; is it plugged in, free, and yours to read?")
        self._camera.set(cv2.CAP_PROP_FRAME_WIDTH, options.width)
        self._camera.set(cv2.CAP_PROP_FRAME_HEIGHT, options.height)
        self._camera.set(cv2.CAP_PROP_FPS, options.rate)
        self._camera.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # a longer queue is latency
        self.width = int(self._camera.get(cv2.CAP_PROP_FRAME_WIDTH))
        self.height = int(self._camera.get(cv2.CAP_PROP_FRAME_HEIGHT))
        self.frame_rate_hz = float(self._camera.get(cv2.CAP_PROP_FPS)) or options.rate

    def frames(self) -> Iterator[TimedFrame]:
        """Yield frames until the camera stops giving any."""
        number, failed = 0, 0
        try:
            while failed < _FAILED_READS:
                read, bgr = self._camera.read()
                arrived_s = time.perf_counter()
                if not read:
                    failed += 1
                    continue
                failed = 0
                values = np.ascontiguousarray(np.asarray(bgr)[..., ::-1])
                frame = EncodedFrame(
                    values=values, bits=8, number=number, name=f"{self.name}, frame {number}"
                )
                yield TimedFrame(frame=frame, arrived_s=arrived_s)
                number += 1
        finally:
            self._camera.release()
        raise BadCapture(f"{self.name}: gives no frames any more")


class FileSource:
    """A capture played as if it were filmed now: frame n is there n / rate seconds after the start.

    A frame that could not be decoded in time arrives late, and counts from when it was due; where decoding
    falls further behind, frames are skipped, and counted, as a camera would. realtime: False gives frames as
    fast as they can be read.
    """

    def __init__(self, capture: Capture, *, realtime: bool = True) -> None:
        info = capture.info
        self.name = capture.name
        self.width, self.height = info.width, info.height
        self.frame_rate_hz = info.frame_rate_hz
        self.realtime = realtime
        self.skipped = 0
        self._capture = capture

    def frames(self) -> Iterator[TimedFrame]:
        """Yield the frames of the capture, in time."""
        start: float | None = None
        number: int | None = 0
        while number is not None:
            late_at = None
            for frame in self._capture.encoded_frames(number):
                now = time.perf_counter()
                start = now if start is None else start
                due = start + frame.number / self.frame_rate_hz
                if self.realtime and now - due > _LATEST_FRAMES / self.frame_rate_hz:
                    late_at = frame.number
                    break
                if self.realtime:
                    time.sleep(max(0.0, due - now))
                yield TimedFrame(frame=frame, arrived_s=due if self.realtime else now)
            number = None if start is None or late_at is None else self._skip_from(late_at, start)

    def _skip_from(self, number: int, start_s: float) -> int | None:
        """Return the first frame that is not due yet, or None past the end; count those left out."""
        following = int((time.perf_counter() - start_s) * self.frame_rate_hz) + 1
        following = min(max(following, number + 1), len(self._capture))
        self.skipped += following - number
        return following if following < len(self._capture) else None

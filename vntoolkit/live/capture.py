"""The camera's frames while filming: sources, watching them, recording them.

One thread takes frames, one works on them, or two under shadow, and what comes too fast is dropped. Between
them stands a slot for the newest frames. A frame that finds it full pushes the oldest out, which is counted;
so the picture on the screen is never more than a few frames old.
"""

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Protocol

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.errors import BadCapture, BadInput, VntError
from vntoolkit.io.atomic import require_writable_folder
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.video import write_video
from vntoolkit.live.frames import LiveProcessor, LiveResult
from vntoolkit.options.pages import CameraOptions
from vntoolkit.pipeline.threads import side_by_side

_MOST_CAMERAS = 100  # OpenCV reads the hundreds of a number as the driver to take; a negative one crashes it
_FAILED_READS = 30  # in a row: the camera is gone
_STILLS_RATE_HZ = 30.0  # what a sequence of stills is played at
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
        self.frame_rate_hz = info.frame_rate_hz or _STILLS_RATE_HZ
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


_SLOTS = 2  # frames that wait; at 30 a second two are 67 ms
_RECENT = 60  # frames that the shown rate and latency are taken over


@dataclass(frozen=True, kw_only=True)
class LiveFigures:
    """How it goes: frames so far, frames a second and seconds of latency lately.

    arrived, processed, dropped, failed: frames. arrival_hz: of frames as the camera gives them, which may be
    fewer than it states. rate_hz: of frames processed. latency_s: from a frame's arrival to its result,
    median and 95th percentile.
    """

    arrived: int
    processed: int
    dropped: int
    failed: int
    arrival_hz: float
    rate_hz: float
    latency_s: tuple[float, float]

    def line(self) -> str:
        """One line for people."""
        median, high = (1000 * seconds for seconds in self.latency_s)
        lost = f", {self.failed} failed" if self.failed else ""
        return (
            f"{self.rate_hz:.1f} of {self.arrival_hz:.1f} frames/s, "
            f"latency {median:.0f} ms (95 %: {high:.0f} ms), "
            f"{self.dropped} of {self.arrived} dropped{lost}"
        )


class LatencyMeter:
    """Rate and latency of frames that got somewhere; safe between threads."""

    def __init__(self, keep: int | None = _RECENT) -> None:
        self._seen: deque[tuple[float, float]] = deque(maxlen=keep)
        self._lock = threading.Lock()
        self.count = 0

    def reached(self, arrived_s: float, there_s: float | None = None) -> None:
        """Note that a frame which arrived then is there now, or was at another time."""
        with self._lock:
            self._seen.append((arrived_s, time.perf_counter() if there_s is None else there_s))
            self.count += 1

    def figures(self) -> tuple[float, tuple[float, float]]:
        """Frames a second, and latency in seconds: median and 95th percentile."""
        with self._lock:
            seen = np.array(self._seen)
        if len(seen) < 2:
            return 0.0, (0.0, 0.0)
        span = seen[-1, 1] - seen[0, 1]
        median, high = np.percentile(seen[:, 1] - seen[:, 0], [50, 95])
        return float((len(seen) - 1) / max(span, 1e-9)), (float(median), float(high))


class LiveRun:
    """A source being watched. `run` returns when it ends, or after `stop`."""

    def __init__(
        self,
        source: LiveSource,
        processor: LiveProcessor,
        on_result: Callable[[LiveResult, TimedFrame], None],
        on_arrival: Callable[[TimedFrame], None] = lambda frame: None,
        *,
        on_failure: Callable[[VntError, TimedFrame], None] = lambda problem, frame: None,
        wait_for_all: bool = False,
    ) -> None:
        """on_result: called in the thread of `run`. on_arrival: in the one that takes frames, for every one.

        on_failure: called in the thread of `run` for a frame without normals, such as a dark one.
        wait_for_all: never drop a frame but let the source wait, for a file that is not played in real time.
        """
        self._source, self._processor = source, processor
        self._on_result, self._on_arrival = on_result, on_arrival
        self._on_failure, self._wait_for_all = on_failure, wait_for_all
        self._waiting: deque[TimedFrame] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self._stopped = threading.Event()
        self._problem: BaseException | None = None
        self._arrivals, self._meter = LatencyMeter(), LatencyMeter()
        self._dropped = self._failed = 0

    def run(self) -> LiveFigures:
        """Watch until the source ends; raise what it raised, once all that arrived is done.

        A frame that fails is counted and the next one is watched; where none succeeds, its error is raised.
        """
        failure: VntError | None = None
        taker = threading.Thread(target=self._take, name="live-source", daemon=True)
        taker.start()
        try:
            arriving, lanes = iter(self._next, None), self._processor.lanes
            for timed, begun in side_by_side(
                arriving, lambda timed: self._processor.begin(timed.frame), lanes
            ):
                try:
                    result = self._processor.finish(begun.result())
                except VntError as problem:  # mostly that nothing lit is in view: watch on
                    self._failed += 1
                    failure = problem
                    self._on_failure(problem, timed)
                    continue
                self._on_result(result, timed)
                self._meter.reached(timed.arrived_s)
        finally:
            self.stop()
            taker.join()
        if isinstance(self._problem, VntError) and self._arrivals.count:
            return self.figures()  # a camera that was unplugged ends the run like a file that ends
        if self._problem is not None:
            raise self._problem
        if failure is not None and not self._meter.count:
            raise failure
        return self.figures()

    def stop(self) -> None:
        """Take no more frames."""
        self._stopped.set()
        with self._changed:
            self._changed.notify_all()

    def figures(self) -> LiveFigures:
        """How it goes now."""
        rate, latency = self._meter.figures()
        return LiveFigures(
            arrived=self._arrivals.count + self._source.skipped,
            processed=self._meter.count,
            dropped=self._dropped + self._source.skipped,
            failed=self._failed,
            arrival_hz=self._arrivals.figures()[0],
            rate_hz=rate,
            latency_s=latency,
        )

    def _take(self) -> None:
        try:
            for timed in self._source.frames():
                if self._stopped.is_set():
                    break
                self._on_arrival(timed)
                self._put(timed)
        except BaseException as problem:
            self._problem = problem
        finally:
            with self._changed:
                self._ended = True
                self._changed.notify_all()

    def _put(self, timed: TimedFrame) -> None:
        with self._changed:
            self._arrivals.reached(timed.arrived_s, timed.arrived_s)
            while len(self._waiting) >= _SLOTS and not self._stopped.is_set():
                if self._wait_for_all:
                    self._changed.wait(0.1)
                else:
                    self._waiting.popleft()
                    self._dropped += 1
            self._waiting.append(timed)
            self._changed.notify_all()

    def _next(self) -> TimedFrame | None:
        with self._changed:
            while not self._waiting:
                if self._ended or self._stopped.is_set():
                    return None
                self._changed.wait(0.5)
            timed = self._waiting.popleft()
            self._changed.notify_all()
            return timed


_BUFFERED = 90  # frames; 3 seconds at 30 a second ride out a slow disk


class LiveRecorder:
    """Writes frames as FFV1 in Matroska, one file a recording; frames as the camera gave them, uncropped.

    A frame that finds the buffer full is lost to the recording, and counted in `lost`. A recording that fails
    is over; `problem` says why, until the next one begins.
    """

    def __init__(self, folder: Path, frame_rate_hz: float) -> None:
        self._folder, self._frame_rate_hz = folder, frame_rate_hz
        self._queue: queue.Queue[Array | None] | None = None
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()
        self.files: list[Path] = []
        self.lost = 0
        self.problem = ""

    @property
    def is_recording(self) -> bool:
        """True between start and stop."""
        return self._queue is not None

    def toggle(self) -> bool:
        """Start or stop; return whether it records now."""
        (self.stop if self.is_recording else self.start)()
        return self.is_recording

    def start(self) -> None:
        """Begin a new file; the folder is made where it is missing."""
        with self._lock:
            if self._queue is not None:
                return
            folder = require_writable_folder(self._folder)
            stem = f"live-{datetime.now():%Y%m%d-%H%M%S}"
            path = folder / f"{stem}.mkv"
            count = 1
            while path.exists() or path in self.files:
                count += 1
                path = folder / f"{stem}-{count}.mkv"
            self.files.append(path)
            self.problem = ""
            frames: queue.Queue[Array | None] = queue.Queue(_BUFFERED)
            self._queue = frames
            self._thread = threading.Thread(target=self._write, args=(path, frames), name="recorder")
            self._thread.start()

    def take(self, timed: TimedFrame) -> None:
        """Record a frame, where recording is on."""
        with self._lock:
            if self._queue is not None and timed.frame.values.dtype in (np.uint8, np.uint16):
                try:
                    self._queue.put_nowait(timed.frame.values)
                except queue.Full:
                    self.lost += 1

    def stop(self) -> None:
        """End the file and wait until it is whole."""
        with self._lock:
            frames, thread = self._queue, self._thread
            self._queue = self._thread = None
        if frames is not None and thread is not None:
            while thread.is_alive():
                try:
                    frames.put(None, timeout=0.5)
                    break
                except queue.Full:
                    continue
            thread.join()

    def _write(self, path: Path, frames: queue.Queue[Array | None]) -> None:
        def taken() -> Iterator[Array]:
            values = first
            while values is not None:
                yield values
                values = frames.get()

        first, problem = frames.get(), ""
        if first is not None:
            try:
                write_video(path, taken(), self._frame_rate_hz)
                return
            except VntError as error:  # a full disk must not end the show
                problem = str(error)
        with self._lock:
            self.files.remove(path)
            self.problem = problem
            if self._queue is frames:
                self._queue = self._thread = None

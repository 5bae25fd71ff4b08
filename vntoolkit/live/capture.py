"""The live run: one thread takes frames, one processes them; frames that come too fast are dropped.

Between the two stands a slot for the newest frames. A frame that finds it full pushes the oldest out, which
is counted; so the picture on the screen is never more than a few frames old.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vntoolkit.errors import VntError
from vntoolkit.live.frames import LiveProcessor, LiveResult
from vntoolkit.live.sources import LiveSource, TimedFrame

_SLOTS = 2  # frames that wait; at 30 a second two are 67 ms
_RECENT = 60  # frames that the shown rate and latency are taken over


@dataclass(frozen=True, kw_only=True)
class LiveFigures:
    """How it goes: frames so far, frames a second and seconds of latency lately.

    arrived, processed, dropped, failed: frames. rate_hz: of frames processed. latency_s: from a frame's
    arrival to its result, median and 95th percentile.
    """

    arrived: int
    processed: int
    dropped: int
    failed: int
    rate_hz: float
    latency_s: tuple[float, float]

    def line(self) -> str:
        """One line for people."""
        median, high = (1000 * seconds for seconds in self.latency_s)
        lost = f", {self.failed} failed" if self.failed else ""
        return (
            f"{self.rate_hz:.1f} frames/s, latency {median:.0f} ms (95 %: {high:.0f} ms), "
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
        self._meter = LatencyMeter()
        self._arrived = self._dropped = self._failed = 0

    def run(self) -> LiveFigures:
        """Watch until the source ends; raise what it raised, once all that arrived is done.

        A frame that fails is counted and the next one is watched; where none succeeds, its error is raised.
        """
        failure: VntError | None = None
        taker = threading.Thread(target=self._take, name="live-source", daemon=True)
        taker.start()
        try:
            while (timed := self._next()) is not None:
                try:
                    result = self._processor.process(timed.frame)
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
        if isinstance(self._problem, VntError) and self._arrived:
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
            arrived=self._arrived + self._source.skipped,
            processed=self._meter.count,
            dropped=self._dropped + self._source.skipped,
            failed=self._failed,
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
            self._arrived += 1
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

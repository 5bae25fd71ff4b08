"""Lossless recording of a live source, started and stopped at will, beside everything else."""

from __future__ import annotations

import queue
import threading
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import VntError
from vntoolkit.io.atomic import require_writable_folder
from vntoolkit.io.footage.video import write_video
from vntoolkit.live.sources import TimedFrame

_BUFFERED = 90  # frames; 3 seconds at 30 a second ride out a slow disk


class LiveRecorder:
    """Writes frames as FFV1 in Matroska, one file a recording; frames as the camera gave them, uncropped.

    A frame that finds the buffer full is lost to the recording, and counted in `lost`. A recording that fails
    is over; `problem` says why, until the next one begins.
    """

    def __init__(self, folder: Path, frame_rate_hz: float) -> None:
        self._folder, self._frame_rate_hz = folder, frame_rate_hz
        self._queue: queue.Queue[npt.NDArray[Any] | None] | None = None
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
            frames: queue.Queue[npt.NDArray[Any] | None] = queue.Queue(_BUFFERED)
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

    def _write(self, path: Path, frames: queue.Queue[npt.NDArray[Any] | None]) -> None:
        def taken() -> Iterator[npt.NDArray[Any]]:
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

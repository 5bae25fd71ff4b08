"""The work on one block of frames, in this process or another: read, process, write, report."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.errors import VntError
from vntoolkit.io.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.decoding import EncodedFrame
from vntoolkit.io.frame_log import FrameEntry
from vntoolkit.io.limits import ReadingLimits, reading_limits
from vntoolkit.io.maps import read_mask
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.visibility import ALL_LIT
from vntoolkit.pipeline.frame_processor import FrameProcessor, FrameResult
from vntoolkit.pipeline.options import DepthOffset, OnError, Product, ReconstructOptions
from vntoolkit.pipeline.outputs import ReconstructionFolder
from vntoolkit.pipeline.overlap import WriteBehind, read_ahead
from vntoolkit.pipeline.temporal import smoothed_frames
from vntoolkit.shadows.detector import ShadowMethod

_WAITING = 2  # frames read before the one at work, and results not yet written


@dataclass(frozen=True, kw_only=True, eq=False)
class ReconstructionJob:
    """Everything that a worker needs, small enough to send to another process or machine.

    source: as for `open_capture`. mask, background: files or None. threads: for decoding; with 1, reading,
    processing and writing take turns, so that a worker is one core's. limits: on what any process reads.
    """

    source: str
    rig: Rig
    options: ReconstructOptions
    folder: ReconstructionFolder
    mask: Path | None = None
    background: Path | None = None
    threads: int = 2
    limits: ReadingLimits = field(default_factory=reading_limits)

    @property
    def has_labels(self) -> bool:
        """True where visibility labels are written beside the normals."""
        return self.options.shadows is not ShadowMethod.NONE

    @property
    def ties_depth(self) -> bool:
        """True where depth is made and tied to a reference frame."""
        return self.options.depth_offset is DepthOffset.REFERENCE and self.options.to is not Product.NORMALS

    def open_capture(self) -> Capture:
        """Open the capture with the rig's transfer curve."""
        options = CaptureOptions(
            transfer=self.rig.transfer,
            background=self.background,
            max_megapixels=self.limits.max_megapixels,
            threads=self.threads,
        )
        return open_capture(self.source, options)

    def read_mask(self, capture: Capture) -> Mask | None:
        """Read the mask, of the capture's size, or None."""
        if self.mask is None:
            return None
        size = (capture.info.width, capture.info.height)
        return read_mask(self.mask, size=size, max_megapixels=self.limits.max_megapixels)


class BlockWorker:
    """Processes blocks of one capture; opens it once."""

    def __init__(self, job: ReconstructionJob) -> None:
        self._job = job
        self._capture = job.open_capture()
        mask = job.read_mask(self._capture)
        self._processor = FrameProcessor(job.rig, job.options, mask, self._capture.background)
        reference = job.options.reference_frame
        if job.ties_depth and reference is not None:
            with contextlib.suppress(VntError):  # where it is met as a frame, it is reported
                frame = next(
                    smoothed_frames(self._capture, range(reference, reference + 1), job.options.smoothing)
                )
                self._processor.anchor_to(frame)

    def run(self, block: range, already_done: frozenset[int] = frozenset()) -> Iterator[FrameEntry]:
        """Process a block and write its frames, but for those already on disk; yield a record per new frame.

        All frames are computed, since a frame may start from the one before it. A record is yielded once the
        frame's files are in place.
        """
        self._processor.forget()
        frames = smoothed_frames(self._capture, block, self._job.options.smoothing)
        written: list[FrameEntry] = []

        def write(done: tuple[FrameEntry, FrameResult | None]) -> None:
            written.append(self._write(*done))

        waiting = _WAITING if self._job.threads > 1 else 0
        with WriteBehind(write, waiting) as writer:
            for frame in read_ahead(frames, waiting):
                done = self._process(frame)
                if frame.number not in already_done:
                    writer.put(done)
                while written:
                    yield written.pop(0)
        yield from written

    def _process(self, frame: EncodedFrame) -> tuple[FrameEntry, FrameResult | None]:
        started = time.perf_counter()
        try:
            result = self._processor.process(frame)
        except VntError as error:
            if self._job.options.on_error is OnError.STOP:
                raise
            seconds = time.perf_counter() - started
            return FrameEntry(number=frame.number, seconds=seconds, failure=str(error)), None
        return record_of(result, time.perf_counter() - started), result

    def _write(self, record: FrameEntry, result: FrameResult | None) -> FrameEntry:
        started = time.perf_counter()
        if result is not None:
            self._job.folder.write(result)
        return replace(record, seconds=record.seconds + time.perf_counter() - started)


def record_of(result: FrameResult, seconds: float) -> FrameEntry:
    """Summarise a result."""
    valid = result.normal_map.mask
    shadowed = 0.0
    if result.labels is not None and valid.any():
        shadowed = float(np.mean(result.labels[valid] != ALL_LIT))
    return FrameEntry(
        number=result.number,
        seconds=seconds,
        valid_share=float(valid.mean()),
        clipped_share=result.clipped_share,
        shadowed_share=shadowed,
    )

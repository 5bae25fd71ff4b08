"""A block of consecutive frames in one process: read, found, integrated and written, each a frame ahead."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vntoolkit.errors import NoSubject, VntError
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.io.results.manifest import Known
from vntoolkit.options.reconstruction import OnError, Product
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.pipeline.frame_processor import Carried, FrameProcessor, PreparedFrame
from vntoolkit.pipeline.outputs import FrameResult, write_frame
from vntoolkit.pipeline.request import Request
from vntoolkit.pipeline.threads import read_ahead, stepped

_WAITING = 1  # frames that lie between one thread and the next
_SAMPLED = 4  # every fourth pixel of every fourth row tells a frame's expected error
Block = tuple[range, frozenset[int]]  # consecutive frames, and those of them that are on disk already


class FrameBlockProcessor:
    """Processes blocks of one capture in this process; opens it once.

    threads: that it may use, None for as many as help. With 1, reading and processing take turns.
    """

    def __init__(self, request: Request, known: Known, threads: int | None) -> None:
        self._request, self._threads = request, 2 if threads is None else min(2, threads)
        self._footage = request.open_footage(self._threads)
        options, mattes = request.options_with(known), self._footage.mattes
        self._options = options
        self._processor = FrameProcessor(
            known.with_rig(request.rig),
            options,
            mattes.still,
            self._footage.capture.background,
            materials=known.materials,
            blur_px=known.blur_px,
        )
        self._carried = Carried(albedo=None if request.is_of_gel else known.relative_albedo)
        if options.to is not Product.NORMALS or known.materials:
            at = known.reference_frame
            with contextlib.suppress(VntError):  # where it is met as a frame, it is reported
                frame = next(self._frames(range(at, at + 1)))
                self._processor.set_reference(self._carried, frame, mattes.of(frame))

    def __call__(self, item: Block) -> Iterator[FrameEntry]:
        """Process a block and write its frames, but for those already on disk; yield a record per new frame.

        All frames are computed, since a frame may start from the one before it. A record is yielded once the
        frame's files are in place.
        """
        block, on_disk = item
        self._carried.reset()
        waiting = _WAITING if self._threads > 1 else 0
        frames = read_ahead(self._frames(block), waiting)
        there = (frame for frame in frames if not self._footage.mattes.missing([frame.number]))
        found = stepped(map(self._with_light, there), self._with_normals, self._threads)
        whole = stepped(found, self._with_surface, waiting=waiting)
        wanted = (work for work in whole if work.frame.number not in on_disk)
        yield from stepped(wanted, self._written, waiting=_WAITING)

    def _frames(self, block: range) -> Iterator[EncodedFrame]:
        capture, sameness = self._footage.capture, self._options.smoothing
        if not sameness > 0:
            return capture.encoded_frames(block.start, block.stop, block.step)
        from vntoolkit.pipeline.smoothing import smoothed_frames

        return smoothed_frames(capture, block, sameness)

    # The steps of a frame, each in its own thread; frames come to each in order.

    def _with_light(self, frame: EncodedFrame) -> _FrameAtWork:
        mattes, work = self._footage.mattes, _FrameAtWork(frame=frame)
        with self._tried(work):
            matte = mattes.of(frame) if mattes.changes else None
            work.prepared = self._processor.prepared(frame, matte, self._carried)
        return work

    def _with_normals(self, work: _FrameAtWork) -> _FrameAtWork:
        if work.prepared is not None:
            with self._tried(work):
                work.result = self._processor.normals(work.prepared)
            work.prepared = None
        return work

    def _with_surface(self, work: _FrameAtWork) -> _FrameAtWork:
        if work.result is not None:
            with self._tried(work):
                result = self._processor.with_depth(work.result, self._carried)
                work.result = self._processor.with_mesh(result, work.frame)
        return work

    @contextlib.contextmanager
    def _tried(self, work: _FrameAtWork) -> Iterator[None]:
        """Count the seconds that a step takes, and let what it raises stop the run or leave the frame out."""
        started = time.perf_counter()
        try:
            yield
        except VntError as error:
            if self._options.on_error is OnError.STOP and not isinstance(error, NoSubject):
                raise
            work.result, work.failure = None, str(error)
            work.shows_nothing = isinstance(error, NoSubject)
        work.seconds += time.perf_counter() - started

    def _written(self, done: _FrameAtWork) -> FrameEntry:
        started = time.perf_counter()
        if done.result is None:
            return FrameEntry(
                number=done.frame.number,
                seconds=done.seconds,
                failure=done.failure,
                shows_nothing=done.shows_nothing,
            )
        write_frame(self._request.folder, done.result)
        return record_of(done.result, done.seconds + time.perf_counter() - started)


@dataclass(kw_only=True, eq=False)
class _FrameAtWork:
    """What a frame became so far, None for what failed; the seconds spent on it; and why it failed.

    shows_nothing: it failed because no subject is in sight.
    """

    frame: EncodedFrame
    prepared: PreparedFrame | None = None
    result: FrameResult | None = None
    seconds: float = 0.0
    failure: str = ""
    shows_nothing: bool = False


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
        error_deg=_median_error(result.normal_map),
        contact_mm2=None if result.contact is None else result.contact.area_mm2,
        contact_depth_mm=None if result.contact is None else result.contact.depth_mm,
    )


def _median_error(normal_map: NormalMap) -> float | None:
    if normal_map.error_deg is None:
        return None
    sampled = (slice(None, None, _SAMPLED), slice(None, None, _SAMPLED))
    errors = normal_map.error_deg[sampled][normal_map.mask[sampled]]
    return float(np.median(errors)) if errors.size else None

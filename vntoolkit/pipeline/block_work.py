"""Work on a block of frames in one process: four threads, each a frame ahead of the next; smoothing."""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Generic, TypeVar

import numpy as np

from vntoolkit.arrays import Array, UInt16Array
from vntoolkit.checks import require_positive
from vntoolkit.errors import VntError
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.files import reading_limits
from vntoolkit.io.footage.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.mattes import Mattes, open_mattes
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.native import loops_may_overlap, njit
from vntoolkit.options.footage import Gaps, MatteOptions, ReadingLimits, SensorOptions
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import DepthOffset, OnError, Product, ReconstructOptions
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.pipeline.frame_processor import FrameProcessor, SeenFrame
from vntoolkit.pipeline.outputs import FrameResult, ReconstructionFolder

_WAITING = 1  # frames that lie between one thread and the next
Item = TypeVar("Item")
Result = TypeVar("Result")
Block = tuple[range, frozenset[int]]  # consecutive frames, and those of them that are on disk already
_SAMPLED = 4  # every fourth pixel of every fourth row tells a frame's expected error
_END = object()
_FULL = 65535


@dataclass(frozen=True, kw_only=True, eq=False)
class ReconstructionJob:
    """A reconstruction as sent to workers: source, rig, options and folder.

    source, gaps: as for `open_capture`. rig: its transfer is the footage's. calibrated: the curve that the
    rig was calibrated with, None for the same. allow: checks whose fatal findings do not stop the run. mask:
    image, or video, folder or pattern of mattes, or None. matting: how these become masks. background: file
    or None. sensor: how samples of the sensor itself are read. reflectances: (m, 3), of materials relative
    to the rig's; empty for the rig's alone. pigments: (m, 3), along which log reflectances change, 0 for
    none. errors_deg: (m,), root mean square angles by which the materials' errors turn normals.
    lamp_doubts_deg: of the directions of lamps that were looked for in shadows, infinite for unknown.
    nearness: of the lamps, by which the rig's M was made to change over the picture; 0 for not at all.
    blur_px: standard deviation of the picture's blur, which expected errors count; 0 for unknown. threads:
    for decoding; with 1, reading and processing take turns, so that a worker is one core's. limits: on what
    any process reads.
    """

    source: str
    rig: Rig
    options: ReconstructOptions
    folder: ReconstructionFolder
    mask: Path | None = None
    matting: MatteOptions = field(default_factory=MatteOptions)
    background: Path | None = None
    gaps: Gaps = Gaps.REFUSE
    calibrated: Transfer | None = None
    allow: tuple[str, ...] = ()
    sensor: SensorOptions = field(default_factory=SensorOptions)
    reflectances: tuple[tuple[float, float, float], ...] = ()
    pigments: tuple[tuple[float, float, float], ...] = ()
    errors_deg: tuple[float, ...] = ()
    lamp_doubts_deg: tuple[float, ...] = ()
    nearness: float = 0.0
    blur_px: float = 0.0
    threads: int = 2
    limits: ReadingLimits = field(default_factory=reading_limits)

    @property
    def folders(self) -> list[str]:
        """The folders that hold a file of every finished frame."""
        has_depth = self.options.to is not Product.NORMALS
        written = {
            "normals": True,
            "depth": has_depth,
            "mesh": self.options.to is Product.MESH,
            "shadows": self.options.shadows is not ShadowMethod.NONE,
            "contact": has_depth and self.rig.gel is not None,
            "materials": bool(self.reflectances),
        }
        return [kind for kind, is_written in written.items() if is_written]

    @property
    def ties_depth(self) -> bool:
        """True if depth is computed and its free constant is fixed by a reference frame."""
        return self.options.depth_offset is DepthOffset.REFERENCE and self.options.to is not Product.NORMALS

    def open_capture(self) -> Capture:
        """Open the capture with the rig's transfer curve."""
        options = CaptureOptions(
            transfer=self.rig.transfer,
            response=self.rig.response,
            background=None if self.matting.key is not None else self.background,
            max_megapixels=self.limits.max_megapixels,
            gaps=self.gaps,
            sensor=self.sensor,
            threads=self.threads,
        )
        return open_capture(self.source, options)

    def open_mattes(self, capture: Capture) -> Mattes:
        """Open the mattes, of the capture's size."""
        return open_mattes(capture, self.mask, self.matting, self.background)


class BlockWorker:
    """Processes blocks of one capture; opens it once."""

    def __init__(self, job: ReconstructionJob) -> None:
        self._job = job
        self._capture = job.open_capture()
        self._mattes = job.open_mattes(self._capture)
        self._processor = self._new_processor()
        self._lanes = [self._processor]  # each finds the normals of one frame at a time
        if self._processor.finds_shadows and job.threads > 1 and loops_may_overlap():
            self._lanes.append(self._new_processor())
        reference = job.options.reference_frame
        if reference is not None and (job.ties_depth or job.reflectances):
            with contextlib.suppress(VntError):  # where it is met as a frame, it is reported
                frame = next(
                    smoothed_frames(self._capture, range(reference, reference + 1), job.options.smoothing)
                )
                self._processor.refer_to(frame, self._mattes.of(frame), ties_depth=job.ties_depth)

    def _new_processor(self) -> FrameProcessor:
        job = self._job
        return FrameProcessor(
            job.rig,
            job.options,
            self._mattes.still,
            self._capture.background,
            reflectances=job.reflectances,
            pigments=job.pigments,
            errors_deg=job.errors_deg,
            blur_px=job.blur_px,
        )

    def run(self, block: range, already_done: frozenset[int] = frozenset()) -> Iterator[FrameEntry]:
        """Process a block and write its frames, but for those already on disk; yield a record per new frame.

        All frames are computed, since a frame may start from the one before it. A record is yielded once the
        frame's files are in place.
        """
        self._processor.forget()
        frames = smoothed_frames(self._capture, block, self._job.options.smoothing)
        written: list[FrameEntry] = []

        def write(done: _FrameAtWork) -> None:
            if done.frame.number not in already_done:
                written.append(self._written(done))

        waiting = _WAITING if self._job.threads > 1 else 0
        meanwhile = waiting if loops_may_overlap() else 0
        with (
            WriteBehind(write, _WAITING) as writer,
            WriteBehind[_FrameAtWork](
                lambda begun: writer.put(self._with_surface(begun)), meanwhile
            ) as second,
        ):
            shown = (
                self._with_light(frame)
                for frame in read_ahead(frames, waiting)
                if not self._mattes.missing([frame.number])
            )
            finders = [partial(self._with_normals, lane) for lane in self._lanes]
            for _, begun in side_by_side(shown, finders):
                second.put(begun.result())
                while written:
                    yield written.pop(0)
        yield from written

    def _with_light(self, frame: EncodedFrame) -> _FrameAtWork:
        def seen(begun: _FrameAtWork) -> _FrameAtWork:
            matte = self._mattes.of(frame) if self._mattes.changes else None
            return replace(begun, seen=self._processor.seen(frame, matte))

        return self._tried(seen, _FrameAtWork(frame=frame))

    def _with_normals(self, processor: FrameProcessor, begun: _FrameAtWork) -> _FrameAtWork:
        seen = begun.seen
        if seen is None:
            return begun
        return self._tried(lambda to: replace(to, seen=None, result=processor.normals_of(seen)), begun)

    def _with_surface(self, begun: _FrameAtWork) -> _FrameAtWork:
        result = begun.result
        if result is None:
            return begun
        return self._tried(
            lambda to: replace(to, result=self._processor.with_surface(result, to.frame)), begun
        )

    def _tried(self, work: Callable[[_FrameAtWork], _FrameAtWork], before: _FrameAtWork) -> _FrameAtWork:
        started = time.perf_counter()
        try:
            done = work(before)
        except VntError as error:
            if self._job.options.on_error is OnError.STOP:
                raise
            done = replace(before, seen=None, result=None, failure=str(error))
        return replace(done, seconds=before.seconds + time.perf_counter() - started)

    def _written(self, done: _FrameAtWork) -> FrameEntry:
        started = time.perf_counter()
        if done.result is None:
            return FrameEntry(number=done.frame.number, seconds=done.seconds, failure=done.failure)
        self._job.folder.write(done.result)
        return record_of(done.result, done.seconds + time.perf_counter() - started)


@dataclass(frozen=True, kw_only=True, eq=False)
class _FrameAtWork:
    """What a frame became so far, None for what failed; the seconds spent on it; and why it failed."""

    frame: EncodedFrame
    seen: SeenFrame | None = None
    result: FrameResult | None = None
    seconds: float = 0.0
    failure: str = ""


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


# Reading, normals, surfaces and writing run in a thread each, with bounded queues between them, since few of
# the steps keep two cores busy. Materials go on from the frame before. Normals under shadow owe it nothing:
# two frames are at work at once, while the materials of the next are found.


def side_by_side(
    items: Iterable[Item], lanes: Sequence[Callable[[Item], Result]]
) -> Iterator[tuple[Item, Future[Result]]]:
    """Yield `items` in order with what becomes of them, as many at work at a time as there are `lanes`.

    Each lane works on one item at a time in a thread of its own, where compiled loops take one core. One lane
    alone has no thread. The caller asks for a result before it asks for the next item.
    """
    if len(lanes) == 1:
        for item in items:
            done: Future[Result] = Future()
            try:
                done.set_result(lanes[0](item))
            except VntError as error:
                done.set_exception(error)
            yield item, done
        return
    import numba

    at_work: deque[tuple[Item, Future[Result]]] = deque()
    with ThreadPoolExecutor(len(lanes), "lane", numba.set_num_threads, (1,)) as pool:
        for number, item in enumerate(items):
            at_work.append((item, pool.submit(lanes[number % len(lanes)], item)))
            if len(at_work) == len(lanes):
                yield at_work.popleft()
        yield from at_work


def read_ahead(items: Iterable[Item], depth: int = 2) -> Iterator[Item]:
    """Yield `items` in order while a thread fetches the next `depth`; an error surfaces in its place.

    With a depth of 0 there is no thread: each item is fetched when it is asked for.
    """
    if depth == 0:
        yield from items
        return
    fetched: queue.Queue[object] = queue.Queue(maxsize=depth)
    stopped = threading.Event()

    def put(item: object) -> bool:
        while not stopped.is_set():
            try:
                fetched.put(item, timeout=0.1)
                return True
            except queue.Full:
                continue
        return False

    def fetch() -> None:
        try:
            for item in items:
                if not put(item):
                    return
            put(_END)
        except BaseException as error:
            put(_Failure(error))

    thread = threading.Thread(target=fetch, name="read-ahead", daemon=True)
    thread.start()
    try:
        while (item := fetched.get()) is not _END:
            if isinstance(item, _Failure):
                raise item.error
            yield item  # type: ignore[misc]
    finally:
        stopped.set()
        thread.join()


class WriteBehind(Generic[Item]):
    """Hands items to `write` in another thread, in order, at most `depth` of them waiting.

    With a depth of 0 there is no thread: `put` writes. A failed write is raised by the next `put` or on
    leaving the context.
    """

    def __init__(self, write: Callable[[Item], None], depth: int = 2) -> None:
        self._write = write
        self._depth = depth
        self._pending: deque[Future[None]] = deque()
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="write-behind")

    def put(self, item: Item) -> None:
        """Queue an item; wait while the queue is full."""
        if self._depth == 0:
            self._write(item)
            return
        while len(self._pending) >= self._depth:
            self._pending.popleft().result()
        self._pending.append(self._pool.submit(self._write, item))

    def __enter__(self) -> WriteBehind[Item]:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            while self._pending and error is None:
                self._pending.popleft().result()
        finally:
            self._pool.shutdown(wait=True, cancel_futures=True)


class _Failure:
    def __init__(self, error: BaseException) -> None:
        self.error = error


# Smoothing over time: each frame is blended with the captured frames before and after it.


def smoothed_frames(capture: Capture, block: range, sameness: float) -> Iterator[EncodedFrame]:
    """Yield a block's frames; with sameness > 0, each blended with the captured frames before and after it.

    The neighbours are those in the capture, not in the block: results do not depend on how frames are shared
    out. The first and the last frame of the capture have one neighbour; frames of floats are not blended.
    """
    if not sameness > 0:
        yield from capture.encoded_frames(block.start, block.stop, block.step)
        return
    last = capture.info.frame_count - 1
    if block.step == 1 and not capture.info.missing:
        start, stop = max(0, block.start - 1), min(last + 1, block.stop + 1)
        window: list[EncodedFrame] = []
        for frame in capture.encoded_frames(start, stop):
            window.append(frame)
            if len(window) == 3:
                yield _blended(window[0], window[1], window[2], sameness)
                window.pop(0)
            elif len(window) == 2 and start == block.start:
                yield _blended(window[0], window[0], window[1], sameness)
        if stop == block.stop:
            yield _blended(window[-2] if len(window) > 1 else window[-1], window[-1], window[-1], sameness)
        return
    for number in block:
        if number in capture.info.missing:
            continue
        frames = list(capture.encoded_frames(max(0, number - 1), min(last, number + 1) + 1))
        here = [frame.number for frame in frames].index(number)
        yield _blended(
            frames[max(0, here - 1)], frames[here], frames[min(here + 1, len(frames) - 1)], sameness
        )


def _blended(before: EncodedFrame, now: EncodedFrame, after: EncodedFrame, sameness: float) -> EncodedFrame:
    if now.values.dtype not in (np.uint8, np.uint16):
        return now
    values = smoothed_over_time(before.values, now.values, after.values, now.bits, sameness)
    return replace(now, values=values, bits=16)


def smoothed_over_time(before: Array, now: Array, after: Array, bits: int, sameness: float) -> UInt16Array:
    """Blend stored integers (h, w, 3) of three frames; the result has 16 significant bits.

    sameness: s, as a share of full scale (stored values). A value at full scale stays there, so that clipped
    pixels are still known. Raises `BadInput` where sameness is not positive.
    """
    require_positive(sameness, "sameness")
    out = np.empty(now.shape, np.uint16)
    top = 2**bits - 1
    _blend(before, now, after, np.float32(_FULL / top), np.float32(0.5 / (sameness * top) ** 2), top, out)
    return out


@njit(cache=True)
def _blend(before, now, after, scale, sharpness, top, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    height, width = now.shape[:2]
    for v in range(height):
        for u in range(width):
            d_before, d_after = np.float32(0), np.float32(0)
            for c in range(3):
                own = np.float32(now[v, u, c])
                d_before += (np.float32(before[v, u, c]) - own) ** 2
                d_after += (np.float32(after[v, u, c]) - own) ** 2
            w_before, w_after = np.exp(-d_before * sharpness), np.exp(-d_after * sharpness)
            inverse = scale / (np.float32(1) + w_before + w_after)
            for c in range(3):
                own = now[v, u, c]
                if own >= top:
                    out[v, u, c] = np.uint16(65535)
                    continue
                total = np.float32(own) + w_before * before[v, u, c] + w_after * after[v, u, c]
                out[v, u, c] = np.uint16(total * inverse + np.float32(0.5))

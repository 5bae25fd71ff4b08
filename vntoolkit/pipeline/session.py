"""Reconstruction and tracking of many captures with one rig.

Frames of a capture are independent, so its blocks go to all workers; tracking goes from frame to frame, so a
sequence is one worker's. While one capture is tracked the next is reconstructed. A capture that fails does
not stop the others.
"""

import contextlib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.files import limited_to, require_name
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.native import keep_freed_memory, limit_threads
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.tracking import TrackArguments, TrackingOptions
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.cluster import connected, result_of
from vntoolkit.pipeline.reconstruct import ReconstructionSummary, reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.pipeline.texture import write_texture
from vntoolkit.pipeline.track import TrackSummary, track

Result = Callable[[], TrackSummary]  # waits for a sequence that is being tracked
Submit = Callable[[TrackArguments], Result]


@dataclass(frozen=True, kw_only=True)
class CaptureOutcome:
    """Result of one capture. tracks: None if not requested. failure: "" or one line."""

    name: str
    reconstruction: ReconstructionSummary | None
    tracks: TrackSummary | None = None
    failure: str = ""


def names_from_sources(sources: tuple[str, ...]) -> dict[str, str]:
    """Return source by name: a video's name without its ending, or a folder's.

    Raises `BadInput` for a pattern, which has no name, and for two captures of one name.
    """
    named: dict[str, str] = {}
    for source in sources:
        path = Path(source)
        if not path.exists():
            raise BadInput(
                f"{source}: no such video or folder of images; a session takes these, not patterns"
            )
        name = path.absolute().name if path.is_dir() else path.stem
        require_name(name, source)
        if name in named:
            raise BadInput(
                f"{source} and {named[name]}: both would be written into '{name}'; give one another name"
            )
        named[name] = source
    return named


def run_session(
    captures: Mapping[str, Request],
    *,
    tracking: TrackingOptions | None = None,
    frames: FrameRange | None = None,
    workers: int = 1,
    scheduler: str | None = None,
    overwrite: bool = False,
) -> list[CaptureOutcome]:
    """Reconstruct captures, by name, and track each into its folder's `track`; go on where a run stopped.

    tracking: None for no tracks. workers: processes of this machine. scheduler: as for `reconstruct`; then
    sequences are tracked by its workers, one each. Raises what `reconstruct` raises of a scheduler; what a
    capture's own failure is, its outcome tells.
    """
    outcomes: list[CaptureOutcome] = []
    waiting: list[tuple[ReconstructionSummary, str, Result]] = []
    with _tracker(scheduler, workers) as (address, submit):
        for name, job in captures.items():
            try:
                done = reconstruct(job, frames=frames, jobs=workers, scheduler=address, overwrite=overwrite)
            except VntError as error:
                outcomes.append(CaptureOutcome(name=name, reconstruction=None, failure=str(error)))
                continue
            if tracking is None:
                outcomes.append(CaptureOutcome(name=name, reconstruction=done))
            else:
                sequence = TrackArguments(
                    done.folder.absolute(), **vars(tracking), **vars(job.limits), overwrite=overwrite
                )
                waiting.append((done, name, submit(sequence)))
        outcomes += [_tracked(*sequence) for sequence in waiting]
    order = list(captures)
    return sorted(outcomes, key=lambda outcome: order.index(outcome.name))


def _tracked(done: ReconstructionSummary, name: str, result: Result) -> CaptureOutcome:
    try:
        return CaptureOutcome(name=name, reconstruction=done, tracks=result())
    except VntError as error:
        return CaptureOutcome(name=name, reconstruction=done, failure=f"tracking: {error}")


@contextlib.contextmanager
def _tracker(scheduler: str | None, workers: int) -> Iterator[tuple[str | None, Submit]]:
    """Yield the scheduler's address, None without one, and what begins to track a sequence there or here."""
    if scheduler is None:
        yield None, lambda asked: lambda: _track(asked)
        return
    with connected(scheduler, workers) as client:
        futures: list[Any] = []

        def submit(asked: TrackArguments) -> Result:
            futures.append(client.submit(_track_alone, asked, pure=False))
            return lambda future=futures[-1]: result_of(future, "it")  # type: ignore[misc]

        try:
            yield client.scheduler.address, submit
        finally:
            client.cancel(futures, force=True)


def _track_alone(asked: TrackArguments) -> TrackSummary:
    """Run on the cluster: track a sequence with one thread."""
    limit_threads(1)
    keep_freed_memory()
    return _track(asked)


def _track(asked: TrackArguments) -> TrackSummary:
    with limited_to(asked.part(ReadingLimits)):
        done = track(asked)
        write_checkerboard(Path(asked.folder), asked.target)
        write_texture(Path(asked.folder), asked.target)
    return done

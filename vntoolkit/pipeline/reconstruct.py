"""Footage and a rig in; normals, depth and meshes on disk, frame by frame, resumable."""

from __future__ import annotations

import logging
import shutil
import time
from collections.abc import Callable, Generator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.atomic import require_writable_folder
from vntoolkit.io.captures import Capture
from vntoolkit.io.frame_log import FRAMES_NAME, FrameEntry, FrameLog
from vntoolkit.io.frame_range import FrameRange
from vntoolkit.io.manifest import (
    MANIFEST_NAME,
    Manifest,
    has_manifest,
    now_utc,
    read_manifest,
    require_resumable,
    write_manifest,
)
from vntoolkit.io.plausibility import findings_from_capture
from vntoolkit.pipeline.block_work import ReconstructionJob
from vntoolkit.pipeline.blocks import blocks_of
from vntoolkit.pipeline.cluster import require_scheduler, run_blocks_on_cluster
from vntoolkit.pipeline.run_blocks import DoneFrames, run_blocks
from vntoolkit.pipeline.settled_job import manifest_of_run, settled_job

logger = logging.getLogger(__name__)

Started = Callable[[int, int], None]
Finished = Callable[[FrameEntry], None]
Workers = Callable[[ReconstructionJob, list[range], DoneFrames], Generator[FrameEntry]]


@dataclass(frozen=True, kw_only=True)
class ReconstructionSummary:
    """What a run did: frames asked for, found on disk already, newly done, and skipped with their reasons."""

    folder: Path
    frames: int
    resumed: int
    done: int
    skipped: tuple[FrameEntry, ...]
    seconds: float


def reconstruct(
    job: ReconstructionJob,
    *,
    frames: FrameRange | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    overwrite: bool = False,
    on_start: Started = lambda total, done: None,
    on_frame: Finished = lambda record: None,
) -> ReconstructionSummary:
    """Reconstruct the chosen frames of a capture into `job.folder`; go on where an earlier run stopped.

    jobs: worker processes on this machine. scheduler: address of a Dask scheduler whose workers do the work
    instead, or "local" for `jobs` workers of one that is started here; the output is the same to the byte.
    on_start is called once with the number of frames and how many are on disk already, on_frame after each
    further one. Raises the kinds of `VntError` that bad input deserves, before anything is written where
    that can be known.
    """
    frames, root = frames or FrameRange(), job.folder.root
    if jobs < 1:
        raise BadInput(f"jobs: expected 1 or more, got {jobs}")
    started = time.perf_counter()
    capture = job.open_capture()
    job.rig.require_size(capture.info.width, capture.info.height, job.source)
    numbers = frames.numbers(capture.info.frame_count)
    resumes = has_manifest(root) and not overwrite
    job = settled_job(job, capture, numbers, read_manifest(root).options if resumes else {})
    manifest = manifest_of_run(job, capture, frames)
    if resumes:
        require_resumable(root, manifest)
    if scheduler is not None:
        require_scheduler(scheduler)
    require_writable_folder(root)
    if overwrite:
        clear(root)
    log = FrameLog(root)
    on_disk = _frames_on_disk(job, log)
    write_manifest(root, manifest)
    _warn_of_the_implausible(job, capture, numbers)
    on_start(len(numbers), len(on_disk & set(numbers)))
    records = _run(job, numbers, on_disk, _workers(jobs, scheduler), log, on_frame)
    seconds = time.perf_counter() - started
    _finish(root, manifest, log, numbers, seconds)
    skipped = tuple(record for record in records if record.failure)
    return ReconstructionSummary(
        folder=root,
        frames=len(numbers),
        resumed=len(on_disk & set(numbers)),
        done=len(records) - len(skipped),
        skipped=skipped,
        seconds=seconds,
    )


def clear(root: Path) -> None:
    """Remove what `reconstruct` wrote into a folder, and nothing else."""
    if not has_manifest(root):
        return
    for name in ("normals", "depth", "shadows", "mesh"):
        shutil.rmtree(root / name, ignore_errors=True)
    (root / FRAMES_NAME).unlink(missing_ok=True)
    (root / MANIFEST_NAME).unlink()


def _workers(jobs: int, scheduler: str | None) -> Workers:
    if scheduler is None:
        return partial(run_blocks, jobs=jobs)
    return partial(run_blocks_on_cluster, scheduler=scheduler, workers=jobs)


def _run(
    job: ReconstructionJob,
    numbers: range,
    on_disk: set[int],
    workers: Workers,
    log: FrameLog,
    on_frame: Finished,
) -> list[FrameEntry]:
    open_blocks = [block for block in blocks_of(numbers) if not on_disk.issuperset(block)]
    records: list[FrameEntry] = []
    if not open_blocks:
        return records
    running = workers(job, open_blocks, lambda block: frozenset(on_disk.intersection(block)))
    try:
        for record in running:
            log.append(record)
            records.append(record)
            on_frame(record)
    except KeyboardInterrupt:
        left = len(numbers) - len(on_disk & set(numbers)) - len(records)
        raise KeyboardInterrupt(
            f"{len(records)} frames were finished and {left} are left in {job.folder.root}; "
            "run the same command again to go on"
        ) from None
    finally:
        running.close()
        log.close()
    return records


def _frames_on_disk(job: ReconstructionJob, log: FrameLog) -> set[int]:
    """Frames that the log calls finished and whose files are all there."""
    return {
        number
        for number in log.done()
        if all(path.exists() for path in job.folder.files(number, job.options.to, job.has_labels))
    }


def _warn_of_the_implausible(job: ReconstructionJob, capture: Capture, numbers: range) -> None:
    """Log what the footage tells of mistakes that ruin normals without failing."""
    try:
        findings = findings_from_capture(capture, job.rig, job.read_mask(capture), numbers)
    except VntError as problem:  # a bad frame is reported when its turn comes
        logger.debug("plausibility not checked: %s", problem)
        return
    for finding in findings:
        logger.warning("%s", finding)


def _finish(root: Path, manifest: Manifest, log: FrameLog, numbers: range, seconds: float) -> None:
    done = log.done()
    spent = [done[number] for number in numbers if number in done]
    timings = {"frame_s": float(np.median(spent)) if spent else 0.0, "wall_s": round(seconds, 3)}
    write_manifest(root, manifest.model_copy(update={"finished": now_utc(), "timings": timings}))

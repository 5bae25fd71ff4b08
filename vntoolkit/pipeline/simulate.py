"""Synthetic captures: render in one process or several, write the truth, then the video.

Frames are independent of each other and of who renders them: the noise of a frame comes from a generator
of its own, its mesh from the file that the parent wrote. So neither jobs nor an interruption changes a byte.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.atomic import require_writable_folder, write_text
from vntoolkit.io.images import read_image, write_png
from vntoolkit.io.label_images import read_labels
from vntoolkit.io.maps import read_normal_map
from vntoolkit.io.video import write_video
from vntoolkit.native import limit_threads
from vntoolkit.photometry.transfer import TransferCurve
from vntoolkit.pipeline.simulation_job import SimulationFolder, SimulationJob, require_free
from vntoolkit.pipeline.simulation_truth import write_fixed_truth, write_frame, write_moving_mesh
from vntoolkit.simulation.contact_sheet import contact_row, contact_sheet
from vntoolkit.simulation.render import Renderer, frame_generator

_SHEET_FRAMES, _SHEET_WIDTH = 8, 320
_worker: FrameWorker | None = None  # one per worker process


@dataclass(frozen=True, kw_only=True)
class SimulationSummary:
    """What a run made. rendered: frames rendered now; frames: of the capture."""

    folder: Path
    frames: int
    rendered: int


def simulate(
    job: SimulationJob,
    *,
    jobs: int = 1,
    overwrite: bool = False,
    on_start: Callable[[int, int], None] = lambda total, done: None,
    on_frame: Callable[[int], None] = lambda place: None,
) -> SimulationSummary:
    """Film a scene into a folder: capture.mkv, truth/, contact_sheet.png, simulation.json.

    A run that was interrupted goes on where it stopped. jobs: worker processes. on_start is told how many
    frames there are and how many are there already; on_frame every finished one. Raises `BadInput` where
    the folder holds another capture.
    """
    if jobs < 1:
        raise BadInput(f"jobs: expected at least 1 process, got {jobs}")
    folder, count = job.folder, len(job.numbers)
    resume = require_free(folder, job.description(), overwrite)
    if resume and folder.video.exists():
        return SimulationSummary(folder=folder.root, frames=count, rendered=0)
    require_writable_folder(folder.root)
    if not resume:
        if folder.description.exists():
            _clear(folder)
        write_text(folder.description, job.description())
    write_fixed_truth(job)
    write_moving_mesh(job, resume)
    missing = [place for place in range(count) if not folder.staged(place).exists()]
    on_start(count, count - len(missing))
    for place in _rendered(job, missing, jobs):
        on_frame(place)
    _write_contact_sheet(job)
    write_video(folder.video, _staged_frames(folder, count), job.built.frame_rate_hz / job.numbers.step)
    shutil.rmtree(folder.staged(0).parent, ignore_errors=True)
    return SimulationSummary(folder=folder.root, frames=count, rendered=len(missing))


class FrameWorker:
    """Renders and writes frames of one capture by their place in it."""

    def __init__(self, job: SimulationJob) -> None:
        self._job = job
        self._renderer = Renderer(job.built, job.nuisances, job.rendering)
        self._vertices_file = job.folder.truth / "vertices.npy"

    def render(self, place: int) -> int:
        """Render and write one frame; return its place."""
        number = self._job.numbers[place]
        # Mapped anew for every frame: a map kept open holds on to every page it ever showed.
        vertices = np.load(self._vertices_file, mmap_mode="r", allow_pickle=False)
        following = vertices[place + 1] if place + 1 < len(self._job.numbers) else None
        generator = frame_generator(self._job.options.seed, number)
        frame = self._renderer.render(vertices[place], following, generator, number)
        write_frame(self._job.folder, place, frame)
        return place


def _rendered(job: SimulationJob, places: list[int], jobs: int) -> Iterator[int]:
    """Yield each place once its files are written."""
    if jobs == 1 or len(places) < 2:
        worker = FrameWorker(job) if places else None
        for place in places:
            assert worker is not None
            yield worker.render(place)
        return
    workers = min(jobs, len(places))
    threads = max(1, (os.cpu_count() or 1) // workers)
    job = replace(job, rendering=replace(job.rendering, threads=threads))
    context = multiprocessing.get_context("spawn")  # a fork would copy threads that hold locks
    pool = ProcessPoolExecutor(workers, context, initializer=_start_worker, initargs=(job,))
    try:
        yield from _collect(pool, places, 2 * workers)
    except BrokenProcessPool as error:
        raise VntError(
            "a worker process ended abruptly (out of memory?); what is finished is on disk: run the same "
            "command again, with fewer --jobs, to go on"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _collect(pool: ProcessPoolExecutor, places: list[int], ahead: int) -> Iterator[int]:
    """Keep `ahead` frames submitted and hand on their places as they finish."""
    waiting = iter(places)
    running: set[Future[int]] = set()
    while True:
        while len(running) < ahead and (place := next(waiting, None)) is not None:
            running.add(pool.submit(_render_in_worker, place))
        if not running:
            return
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        for future in finished:
            yield future.result()


def _start_worker(job: SimulationJob) -> None:
    """Build the scene in a new process; Ctrl-C is the parent's to handle."""
    global _worker  # noqa: PLW0603 - a worker process has exactly one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    limit_threads(job.rendering.threads)
    _worker = FrameWorker(job)


def _render_in_worker(place: int) -> int:
    assert _worker is not None
    return _worker.render(place)


def _staged_frames(folder: SimulationFolder, count: int) -> Iterator[npt.NDArray[Any]]:
    return (read_image(folder.staged(place)) for place in range(count))


def _write_contact_sheet(job: SimulationJob) -> None:
    count = len(job.numbers)
    linear = job.nuisances.file_transfer.curve is TransferCurve.LINEAR
    rows = []
    for place in np.unique(np.linspace(0, count - 1, min(count, _SHEET_FRAMES)).round().astype(int)):
        normals = read_normal_map(job.folder.map_file("normals", place, ".exr"))
        labels = read_labels(job.folder.map_file("visibility", place, ".png"))
        film = read_image(job.folder.staged(place))
        rows.append(contact_row(film, normals, labels, linear, _SHEET_WIDTH))
    write_png(job.folder.root / "contact_sheet.png", contact_sheet(rows))


def _clear(folder: SimulationFolder) -> None:
    """Remove an earlier capture's files, and only those."""
    for path in (folder.video, folder.root / "contact_sheet.png", folder.description):
        path.unlink(missing_ok=True)
    shutil.rmtree(folder.truth, ignore_errors=True)
    shutil.rmtree(folder.staged(0).parent, ignore_errors=True)

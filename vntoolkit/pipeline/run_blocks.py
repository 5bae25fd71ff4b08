"""Blocks of frames on one worker in this process, or on several processes."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace

from vntoolkit.errors import VntError
from vntoolkit.io.frame_log import FrameEntry
from vntoolkit.native import limit_threads
from vntoolkit.pipeline.block_work import BlockWorker, ReconstructionJob

DoneFrames = Callable[[range], frozenset[int]]
_worker: BlockWorker | None = None  # one per worker process


def run_blocks(
    job: ReconstructionJob, blocks: list[range], done_frames: DoneFrames, jobs: int = 1
) -> Generator[FrameEntry]:
    """Yield a record per finished frame; frames of one block in order, blocks as they finish.

    done_frames: tells which frames of a block are on disk already. jobs: worker processes; with 1 the work
    is done here. Closing the iterator ends the workers.
    """
    if jobs == 1 or len(blocks) == 1:
        worker = BlockWorker(job)
        for block in blocks:
            yield from worker.run(block, done_frames(block))
        return
    context = multiprocessing.get_context("spawn")  # a fork would copy threads that hold locks
    workers = min(jobs, len(blocks))
    pool = ProcessPoolExecutor(workers, context, initializer=_start_worker, initargs=(job, workers))
    try:
        yield from _collect(pool, blocks, done_frames, workers)
    except BrokenProcessPool as error:
        raise VntError(
            "a worker process ended abruptly (out of memory?); what is finished is on disk: run the same "
            "command again, with fewer --jobs, to go on"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _collect(
    pool: ProcessPoolExecutor, blocks: list[range], done_frames: DoneFrames, workers: int
) -> Generator[FrameEntry]:
    """Keep two blocks per worker submitted, and hand on what they return."""
    waiting = iter(blocks)
    running: set[Future[list[FrameEntry]]] = set()
    while True:
        while len(running) < 2 * workers and (block := next(waiting, None)) is not None:
            running.add(pool.submit(_run_block, block, done_frames(block)))
        if not running:
            return
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        for future in finished:
            yield from future.result()


def _start_worker(job: ReconstructionJob, workers: int) -> None:
    """Open the capture in a new process; Ctrl-C is the parent's to handle."""
    global _worker  # noqa: PLW0603 - a worker process has exactly one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threads = max(1, (os.cpu_count() or 1) // workers)
    limit_threads(threads)
    _worker = BlockWorker(replace(job, threads=min(job.threads, threads)))


def _run_block(block: range, already_done: frozenset[int]) -> list[FrameEntry]:
    assert _worker is not None
    return list(_worker.run(block, already_done))

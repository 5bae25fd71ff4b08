"""Blocks of frames on many machines by Dask; all workers must see the same folders.

A block is one task. Its worker opens the capture once, writes every frame's files itself, atomically, and
returns only the records; so nothing large travels. A worker that dies costs the block it was at: the
scheduler gives that to another, which computes the same bytes. What is finished is in the folder and its log.
"""

import contextlib
import logging
import os
import threading
from collections.abc import Generator, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from vntoolkit.errors import BadInput, MissingDependency, VntError
from vntoolkit.io.atomic import remove_leftovers
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.native import limit_threads
from vntoolkit.pipeline.block_work import Block, BlockWorker, ReconstructionJob
from vntoolkit.pipeline.outputs import ReconstructionFolder

LOCAL = "local"
_BLOCKS_IN_FLIGHT = 2  # per thread of the cluster: one at work, one ready
_SECONDS_TO_CONNECT = 15
_RARE_HOUSEKEEPING: dict[str, Any] = {  # several watches a second would cost two busy cores a twelfth
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.worker.profile.enabled": False,
}
_here = threading.local()  # a worker of many threads has one `BlockWorker` for each


def run_blocks_on_cluster(
    job: ReconstructionJob,
    blocks: list[Block],
    scheduler: str,
    workers: int,
) -> Generator[FrameEntry]:
    """Yield a record per finished frame, as `shared_out` does.

    scheduler: address such as tcp://host:8786, or "local" for `workers` processes of this machine. Raises
    `MissingDependency` without Dask, `BadInput` where no scheduler answers, and what the frames raise.
    """
    with connected(scheduler, workers) as client:
        yield from _collect(client, _for_anywhere(job), blocks)
        # Every block is written, so what is half-written was left by workers that died, here or elsewhere.
        remove_leftovers(job.folder.root, lambda process: process != os.getpid())


def require_scheduler(scheduler: str) -> None:
    """Raise what `connected` would raise, without starting anything, before files are written."""
    if scheduler != LOCAL:
        with connected(scheduler, workers=0):
            return
    _import_distributed()


@contextlib.contextmanager
def connected(scheduler: str, workers: int) -> Iterator[Any]:
    """A Dask client of a scheduler, which is started and ended here if it is to be local."""
    dask, distributed = _import_distributed()
    _let_dask_report_errors_only()
    if scheduler == LOCAL:
        with contextlib.ExitStack() as stack:
            stack.enter_context(dask.config.set(_RARE_HOUSEKEEPING))
            try:
                cluster = distributed.LocalCluster(
                    n_workers=workers, threads_per_worker=1, processes=True, dashboard_address=None,
                    silence_logs=logging.CRITICAL,  # a heartbeat that meets the run's end is called an error
                )  # fmt: skip
                client = distributed.Client(stack.enter_context(cluster))
            except (RuntimeError, OSError) as error:  # a worker that ended as it began, or no port
                raise VntError(
                    f"Dask's workers did not start ({error}); run the same command again, with fewer --jobs"
                ) from error
            yield stack.enter_context(client)
        return
    try:
        client = distributed.Client(scheduler, timeout=_SECONDS_TO_CONNECT)
    except (OSError, ValueError) as error:
        raise BadInput(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
    with client:
        yield client


def _import_distributed() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ImportError as error:
        raise MissingDependency("--scheduler needs Dask: pip install vntoolkit[cluster]") from error
    return dask, distributed


def _let_dask_report_errors_only() -> None:
    """Silence Dask's loggers, which report every connection, but for errors."""
    for name in ("distributed", *logging.root.manager.loggerDict):
        if name.partition(".")[0] == "distributed":
            logger = logging.getLogger(name)
            logger.setLevel(max(logger.level, logging.ERROR))


def _collect(client: Any, job: ReconstructionJob, blocks: list[Block]) -> Generator[FrameEntry]:
    """Keep a bounded number of blocks submitted, and hand on what they return."""
    import distributed

    shared = client.scatter(job, broadcast=True, hash=False)
    waiting = iter(blocks)
    running = distributed.as_completed()
    try:
        while True:
            most = _BLOCKS_IN_FLIGHT * max(1, sum(client.nthreads().values()))
            while running.count() < most and (block := next(waiting, None)) is not None:
                running.add(client.submit(_run_block, shared, block, pure=False))
            if running.count() == 0:
                return
            future = next(running)
            try:
                entries = future.result()
            except distributed.KilledWorker as error:
                raise VntError(
                    "one block of frames ended several workers, one after the other (out of memory?); what "
                    "is finished is on disk: run the same command again to go on"
                ) from error
            yield from entries
    finally:
        client.cancel(list(running.futures), force=True)


def _run_block(job: ReconstructionJob, block: Block) -> list[FrameEntry]:
    """Run on the cluster: process a block with this thread's worker."""
    if getattr(_here, "job", None) is not job:  # one run sends one object: another rig is another object
        limit_threads(1)
        _here.worker, _here.job = BlockWorker(job), job
    return list(_here.worker.run(*block))


def _for_anywhere(job: ReconstructionJob) -> ReconstructionJob:
    """The job for one thread, paths absolute: a worker runs in another folder, but sees the same ones."""

    def absolute(path: Path | None) -> Path | None:
        return None if path is None else Path(path).absolute()

    return replace(
        job,
        source=os.path.abspath(job.source),  # noqa: PTH100 - may be a pattern; Path would keep the dots
        folder=ReconstructionFolder(root=job.folder.root.absolute()),
        mask=absolute(job.mask),
        background=absolute(job.background),
        threads=1,  # as Dask counts: the cluster's processes and threads are the parallelism
    )

"""Work shared out to processes of this machine: the results do not depend on how many there are."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from vntoolkit.errors import VntError
from vntoolkit.native import end_with_parent, limit_threads

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = Callable[[Item], Iterable[Result]]
_AHEAD = 2  # items submitted for each process: one at work, one ready
_work: Work[Any, Any] | None = None  # of this process, where it is a worker


def shared_out(
    begin: Callable[[int | None], Work[Item, Result]], items: Sequence[Item], jobs: int
) -> Generator[Result]:
    """Yield what the work makes of each item; the results of one item in order, items as they finish.

    begin: makes the work, once in each process; it is told how many threads it may use, None for all. jobs:
    processes; with 1 the work is done here. Closing the iterator ends the processes. Raises what the work
    raises, and `VntError` where a process dies.
    """
    if jobs == 1 or len(items) < 2:
        work = begin(None) if items else None
        for item in items:
            assert work is not None
            yield from work(item)
        return
    workers = min(jobs, len(items))
    threads = max(1, (os.cpu_count() or 1) // workers)
    context = multiprocessing.get_context("spawn")  # a fork would copy threads that hold locks
    pool = ProcessPoolExecutor(workers, context, initializer=_start_worker, initargs=(begin, threads))
    try:
        yield from _collect(pool, items, _AHEAD * workers)
    except BrokenProcessPool as error:
        raise VntError(
            "a worker process ended abruptly (out of memory?); what is finished is on disk: run the same "
            "command again, with fewer --jobs, to go on"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _collect(pool: ProcessPoolExecutor, items: Iterable[Item], ahead: int) -> Generator[Any]:
    """Keep `ahead` items submitted and hand on their results as they finish."""
    waiting = iter(items)
    running: set[Future[list[Any]]] = set()
    while True:
        while len(running) < ahead and (item := next(waiting, None)) is not None:
            running.add(pool.submit(_work_on, item))
        if not running:
            return
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        for future in finished:
            yield from future.result()


def _start_worker(begin: Callable[[int | None], Work[Any, Any]], threads: int) -> None:
    """Begin the work in a new process; Ctrl-C is the parent's to handle."""
    global _work  # noqa: PLW0603 - a worker process has exactly one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    limit_threads(threads)
    _work = begin(threads)


def _work_on(item: Any) -> list[Any]:
    assert _work is not None
    return list(_work(item))

"""Work in processes of this machine: the results do not depend on how many there are."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from vntoolkit.errors import VntError
from vntoolkit.native import end_with_parent, limit_threads

Item = TypeVar("Item")
Result = TypeVar("Result")
Work = Callable[[Item], Iterable[Result]]
_AHEAD = 2  # items submitted for each process: one at work, one ready
# Of this process, where it is a worker: how many threads it may use, and the work that it began.
_threads = 1
_begun: Work[Any, Any] | None = None


def map_in_processes(
    begin: Callable[[int | None], Work[Item, Result]], items: Iterable[Item], jobs: int
) -> Generator[Result]:
    """Yield what the work makes of each item; the results of one item in order, items as they finish.

    begin: makes the work, once in each process; it is told how many threads it may use, None for all. items:
    taken from their iterable while earlier ones are worked on. jobs: processes; with 1 the work is done here.
    Closing the iterator ends the processes. Raises what the work raises, and `VntError` where a process dies.
    """
    if jobs == 1:
        work: Work[Item, Result] | None = None
        for item in items:
            work = work or begin(None)
            yield from work(item)
        return
    threads = max(1, (os.cpu_count() or 1) // jobs)
    context = multiprocessing.get_context("spawn")  # a fork would copy threads that hold locks
    pool = ProcessPoolExecutor(jobs, context, initializer=_start_worker, initargs=(threads,))
    try:
        yield from _collect(pool, begin, items, _AHEAD * jobs)
    except BrokenProcessPool as error:
        raise VntError(
            "a worker process ended abruptly (out of memory?); what is finished is on disk: run the same "
            "command again, with fewer --jobs, to go on"
        ) from error
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _collect(
    pool: ProcessPoolExecutor,
    begin: Callable[[int | None], Work[Any, Any]],
    items: Iterable[Item],
    ahead: int,
) -> Generator[Any]:
    """Keep `ahead` items submitted and hand on their results as they finish."""
    waiting = iter(items)
    running: set[Future[list[Any]]] = set()
    while True:
        while len(running) < ahead and (item := next(waiting, None)) is not None:
            running.add(pool.submit(_work_on, begin, item))
        if not running:
            return
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        for future in finished:
            yield from future.result()


def _start_worker(threads: int) -> None:
    """Prepare a new process; Ctrl-C is the parent's to handle."""
    global _threads  # noqa: PLW0603 - a worker process has exactly one
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    limit_threads(threads)
    _threads = threads


def _work_on(begin: Callable[[int | None], Work[Any, Any]], item: Any) -> list[Any]:
    global _begun  # noqa: PLW0603 - a worker process has exactly one
    _begun = _begun or begin(_threads)
    return list(_begun(item))

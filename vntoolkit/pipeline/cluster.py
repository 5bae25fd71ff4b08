"""Work on many machines by Dask; all workers must see the same folders.

What makes an item writes its files itself, atomically, and returns little, so that nothing large travels. A
worker that dies costs the items it was at: the scheduler gives them to another, which makes the same bytes.
"""

import contextlib
import logging
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import Any

from vntoolkit.errors import BadInput, MissingDependency, VntError
from vntoolkit.native import limit_threads
from vntoolkit.pipeline.processes import Item, Result, Work

LOCAL = "local"
_IN_FLIGHT = 2  # items per thread of the cluster: one at work, one ready
_SECONDS_TO_CONNECT = 15
_RARE_HOUSEKEEPING: dict[str, Any] = {  # several watches a second would cost two busy cores a twelfth
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.admin.system-monitor.gil.enabled": False,
    "distributed.worker.memory.monitor-interval": "1s",
    "distributed.worker.profile.enabled": False,
}
_here = threading.local()  # a worker of many threads has what it began once for each


def map_on_cluster(
    begin: Callable[[int | None], Work[Item, Result]], items: Iterable[Item], scheduler: str, workers: int
) -> Generator[Result]:
    """Yield what the work makes of each item, as `map_in_processes` does; each worker has one thread.

    scheduler: address such as tcp://host:8786, or "local" for `workers` processes of this machine. Raises
    `MissingDependency` without Dask, `BadInput` where no scheduler answers, and what the work raises.
    """
    with connected(scheduler, workers) as client:
        yield from _collect(client, begin, items)


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


def _collect(
    client: Any, begin: Callable[[int | None], Work[Item, Result]], items: Iterable[Item]
) -> Generator[Result]:
    """Keep a bounded number of items submitted, and hand on what they return."""
    import distributed

    shared = client.scatter(begin, broadcast=True, hash=False)
    waiting = iter(items)
    running = distributed.as_completed()
    try:
        while True:
            most = _IN_FLIGHT * max(1, sum(client.nthreads().values()))
            while running.count() < most and (item := next(waiting, None)) is not None:
                running.add(client.submit(_work_on, shared, item, pure=False))
            if running.count() == 0:
                return
            future = next(running)
            try:
                results = future.result()
            except distributed.KilledWorker as error:
                raise VntError(
                    "one block of frames ended several workers, one after the other (out of memory?); what "
                    "is finished is on disk: run the same command again to go on"
                ) from error
            yield from results
    finally:
        client.cancel(list(running.futures), force=True)


def _work_on(begin: Callable[[int | None], Work[Any, Any]], item: Any) -> list[Any]:
    """Run on the cluster: do an item by what this thread began."""
    if getattr(_here, "begin", None) is not begin:  # one run sends one object: another run's is another
        limit_threads(1)
        _here.work, _here.begin = begin(1), begin
    return list(_here.work(item))

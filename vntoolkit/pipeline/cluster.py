"""Work on many machines by Dask; all workers must see the same folders.

What makes an item writes its files itself, atomically, and returns little, so that nothing large travels. A
worker that dies costs the items it was at: the scheduler gives them to another, which makes the same bytes.
"""

import contextlib
import logging
import queue
import threading
import time
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import Any

from vntoolkit.errors import BadInput, MissingDependency, VntError
from vntoolkit.native import limit_threads
from vntoolkit.pipeline.processes import Item, Result, Work

LOCAL = "local"
_IN_FLIGHT = 2  # items per thread of the cluster: one at work, one ready
_SECONDS_TO_CONNECT = 15
_SECONDS_BETWEEN_LOOKS = 5
_SECONDS_OF_SILENCE = 30  # workers tell of themselves every few seconds
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
    distributed = _import_distributed()
    _silence_dask()
    if scheduler != LOCAL:
        try:
            client = distributed.Client(scheduler, timeout=_SECONDS_TO_CONNECT)
        except (OSError, ValueError) as error:
            raise BadInput(f"--scheduler {scheduler}: no Dask scheduler answers there ({error})") from error
        with client:
            yield client
        return
    with contextlib.ExitStack() as stack:
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


def _import_distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise MissingDependency("--scheduler needs Dask: pip install vntoolkit[cluster]") from error
    return distributed


def _silence_dask() -> None:
    """Silence what Dask works with: what it meets while it loses a cluster is told in a line of ours."""
    known = ("tornado.application", "asyncio", *logging.root.manager.loggerDict)
    for name in known:
        if name.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


class _Watched:
    """The workers of a cluster as they were when last looked at.

    A worker that is killed leaves the scheduler's list, and the scheduler gives its items to another. One
    that is stopped keeps its place and its items, and is silent.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._heard: dict[str, tuple[float, float]] = {}  # of each: what it said last, when that was new here
        self._last_at_work = time.monotonic()
        self.at_work: dict[str, int] = {}  # threads by address
        self.look()

    def look(self) -> None:
        """Ask the scheduler; raise `VntError` where it is silent, or nobody has been at work for long."""
        try:
            asked = self._client.scheduler.identity
            known = self._client.sync(asked, n_workers=-1, callback_timeout=_SECONDS_TO_CONNECT)["workers"]
        except Exception as error:  # closed, lost, or no answer in time: Dask has many names for it
            raise _gone("the Dask scheduler does not answer any more") from error
        now = time.monotonic()
        for address, worker in known.items():
            said = worker["last_seen"]
            if self._heard.get(address, (None, 0.0))[0] != said:
                self._heard[address] = said, now
        for address in known:
            if now - self._heard[address][1] > _SECONDS_OF_SILENCE:
                raise _gone(f"the Dask worker {address} does not answer any more")
        self.at_work = {
            address: worker["nthreads"] for address, worker in known.items() if worker["status"] == "running"
        }
        if self.at_work:
            self._last_at_work = now
        elif now - self._last_at_work > _SECONDS_OF_SILENCE:
            raise _gone("the Dask scheduler has no running worker any more")


def _gone(what: str) -> VntError:
    return VntError(f"{what}; what is finished is on disk: run the same command again to go on")


def _collect(
    client: Any, begin: Callable[[int | None], Work[Item, Result]], items: Iterable[Item]
) -> Generator[Result]:
    """Keep a bounded number of items submitted, and hand on what they return."""
    import distributed

    watched, waiting, looked_at = _Watched(client), iter(items), time.monotonic()
    running: set[Any] = set()
    finished: queue.SimpleQueue[Any] = queue.SimpleQueue()

    try:
        shared = client.scatter(begin, broadcast=True, hash=False)
        while True:
            most = _IN_FLIGHT * max(1, sum(watched.at_work.values()))
            while len(running) < most and (item := next(waiting, None)) is not None:
                future = client.submit(_work_on, shared, item, pure=False)
                running.add(future)
                future.add_done_callback(finished.put)
            if not running:
                return
            future = None
            with contextlib.suppress(queue.Empty):
                future = finished.get(timeout=_SECONDS_BETWEEN_LOOKS)
            if future in running:
                running.remove(future)
                yield from result_of(future, "one block of frames", _SECONDS_OF_SILENCE)
            if time.monotonic() - looked_at > _SECONDS_BETWEEN_LOOKS:
                watched.look()
                looked_at = time.monotonic()
    except (OSError, TimeoutError, distributed.client.FutureCancelledError) as error:
        watched.look()
        raise _gone("Dask's workers have ended, with what they held for this run") from error
    finally:
        if client.status == "running" and watched.at_work:
            client.cancel(list(running), force=True)


def result_of(future: Any, what: str, seconds: float | None = None) -> Any:
    """Return what was made; raise `VntError` where what was asked for ended several workers.

    Raises `TimeoutError` where the worker that holds it does not send it within so many seconds.
    """
    import distributed

    try:
        return future.result(timeout=seconds)
    except distributed.KilledWorker as error:
        raise VntError(
            f"{what} ended several workers, one after the other (out of memory?); what is finished is on "
            "disk: run the same command again to go on"
        ) from error


def _work_on(begin: Callable[[int | None], Work[Any, Any]], item: Any) -> list[Any]:
    """Run on the cluster: do an item by what this thread began."""
    if getattr(_here, "begin", None) is not begin:  # one run sends one object: another run's is another
        limit_threads(1)
        _here.work, _here.begin = begin(1), begin
    return list(_here.work(item))

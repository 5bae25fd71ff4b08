"""Threads between the steps of a sequence: items stay in order, and few of them wait."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Generic, TypeVar

from vntoolkit.errors import VntError

Item = TypeVar("Item")
Result = TypeVar("Result")


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
    rest, end = iter(items), object()
    pool = ThreadPoolExecutor(1, "read-ahead")
    try:
        fetched = deque(pool.submit(next, rest, end) for _ in range(depth))
        while (item := fetched.popleft().result()) is not end:
            fetched.append(pool.submit(next, rest, end))
            yield item  # type: ignore[misc]
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


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

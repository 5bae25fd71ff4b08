"""Threads between the steps of a sequence: items stay in order, and few of them wait."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from itertools import repeat
from typing import TypeVar

from vntoolkit.errors import VntError

Item = TypeVar("Item")
Result = TypeVar("Result")


def side_by_side(
    items: Iterable[Item], step: Callable[[Item], Result], threads: int = 1, waiting: int = 0
) -> Iterator[tuple[Item, Future[Result]]]:
    """Yield `items` in order with what a step makes of them, while further ones are at work.

    threads: items at work at a time. waiting: so many more items are begun before the first is handed on. One
    thread and none waiting: all is done in the calling thread.
    """
    if threads == 1 and not waiting:
        for item in items:
            done: Future[Result] = Future()
            try:
                done.set_result(step(item))
            except VntError as error:
                done.set_exception(error)
            yield item, done
        return
    at_work: deque[tuple[Item, Future[Result]]] = deque()
    pool = ThreadPoolExecutor(threads, "step")
    try:
        for item in items:
            at_work.append((item, pool.submit(step, item)))
            if len(at_work) == threads + waiting:
                yield at_work.popleft()
        yield from at_work
    finally:
        # Waits for what is at work, which may read the footage, but joins no thread: Python may close an
        # abandoned generator while a thread begins, and joining there never ends.
        pool.shutdown(wait=False, cancel_futures=True)
        wait([done for _, done in at_work if not done.cancelled()])


def stepped(
    items: Iterable[Item], step: Callable[[Item], Result], threads: int = 1, waiting: int = 0
) -> Iterator[Result]:
    """Yield what a step makes of `items`, as `side_by_side` does; an error surfaces in its place."""
    for _, done in side_by_side(items, step, threads, waiting):
        yield done.result()


def read_ahead(items: Iterable[Item], depth: int) -> Iterator[Item]:
    """Yield `items` in order while a thread fetches the next `depth`; of 0 there is no thread."""
    end = object()
    for item in stepped(repeat(iter(items)), lambda rest: next(rest, end), waiting=depth):
        if item is end:
            return
        yield item  # type: ignore[misc]

"""How far a long run is: whoever works tells it, and whoever called may listen, as the command line does.

What is told in a thread beside the caller's is not heard.
"""

import contextlib
from collections.abc import Iterable, Iterator
from contextvars import ContextVar
from typing import TypeVar

Item = TypeVar("Item")


class Listener:
    """Is told what goes on; this one does not care."""

    def begin(self, title: str, total: int | None, done: int) -> None:
        """Hear that a stage begins. total: of its steps, None where unknown. done: of them, from before."""

    def step(self, count: int) -> None:
        """Hear that so many more steps are done."""

    def end(self) -> None:
        """Hear that the stage has ended."""


_LISTENER: ContextVar[Listener] = ContextVar("listener", default=Listener())  # noqa: B039 - it has no state


def begin(title: str, total: int | None = None, done: int = 0) -> None:
    """Tell that a stage begins, and so that the one before it has ended."""
    _LISTENER.get().begin(title, total, done)


def step(count: int = 1) -> None:
    """Tell that so many more steps of it are done."""
    _LISTENER.get().step(count)


def end() -> None:
    """Tell that it has ended."""
    _LISTENER.get().end()


def counted(items: Iterable[Item], title: str, total: int) -> Iterator[Item]:
    """Yield the items of a stage; each is a step."""
    begin(title, total)
    for item in items:
        yield item
        step()


@contextlib.contextmanager
def heard_by(listener: Listener) -> Iterator[None]:
    """Let the block be heard."""
    before = _LISTENER.set(listener)
    try:
        yield
    finally:
        listener.end()
        _LISTENER.reset(before)

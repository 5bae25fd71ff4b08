"""A progress bar with rate and time left, on a terminal; silent elsewhere."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text

Advance = Callable[[int], None]


class _RateColumn(ProgressColumn):
    """Frames per second so far."""

    def render(self, task: Task) -> Text:
        """Show the rate, or nothing before the first frame."""
        return Text(f"{task.speed:.1f}/s" if task.speed else "", style="progress.data.speed")


@contextlib.contextmanager
def progress_bar(title: str, total: int, done: int = 0) -> Iterator[Advance]:
    """Show progress on standard error while the block runs; yield the function that advances it by n."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        _RateColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True)
    with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as progress:
        task = progress.add_task(title, total=total, completed=done)
        yield lambda n: progress.advance(task, n)


class ProgressBars:
    """Bars one after the other, each begun by the work, which knows how much there is. A context manager."""

    def __init__(self) -> None:
        self._stack = contextlib.ExitStack()
        self._advance: Advance = lambda n: None
        self._title, self._done = "", 0

    def __enter__(self) -> ProgressBars:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def begin(self, title: str, total: int, done: int = 0) -> None:
        """Show a new bar instead of the last."""
        self._stack.close()
        self._advance = self._stack.enter_context(progress_bar(title, total, done))
        self._title, self._done = title, done

    def step(self, _finished: object = None) -> None:
        """Show that one more is done."""
        self._done += 1
        self._advance(1)

    def reach(self, title: str, done: int, total: int) -> None:
        """Show how much of a stage is done; a stage of another title begins a bar of its own."""
        if title != self._title:
            self.begin(title, total, done)
        self._advance(done - self._done)
        self._done = done

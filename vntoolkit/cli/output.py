"""Results on the screen and on disk: a table, and the same numbers as JSON."""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

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
from rich.table import Table
from rich.text import Text

from vntoolkit.errors import BadInput, CannotWrite
from vntoolkit.io.atomic import cannot_write, write_text

_WIDE = 200
JSON, PAGE, PICTURE, MESH = (".json",), (".html",), (".png", ".svg"), (".ply", ".obj")
Advance = Callable[[int], None]


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], names: int = 1) -> None:
    """Print a table whose first `names` columns are texts and whose others are numbers."""
    table = Table(title=title, title_justify="left", title_style="bold", box=None, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < names else "right", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    plain_console().print(table)


def plain_console() -> Console:
    """Return a console that prints brackets, colons and numbers in names as they are."""
    plain: dict[str, Any] = {"highlight": False, "markup": False, "emoji": False}
    console = Console(**plain)
    # a pipe or a file has no width to keep to
    return console if console.is_terminal else Console(**plain, width=_WIDE)


def write_json(path: Path, content: Any) -> None:
    """Write dataclasses, or lists and dictionaries of them, as indented JSON."""
    write_text(path, json.dumps(content, indent=1, default=_plain) + "\n")


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, Path):
        return str(value)
    return value.item()  # numpy's numbers


# Where a verb will write: refused before minutes of work, not after.


def require_output(path: Path | None, suffixes: tuple[str, ...] = ()) -> None:
    """Raise unless a file of that name can be written; None passes. Nothing is made.

    suffixes: one of which the name must end in, or none for any.
    """
    if path is None:
        return
    if suffixes and path.suffix.lower() not in suffixes:
        raise BadInput(f"{path}: expected a name that ends in {' or '.join(suffixes)}")
    try:
        if path.is_dir():
            raise CannotWrite(f"{path}: is a folder, expected the name of a file to write")
        nearest = next(folder for folder in path.absolute().parents if folder.exists())
        fault = 0 if os.access(nearest, os.W_OK | os.X_OK) else errno.EACCES
        fault = fault if nearest.is_dir() else errno.ENOTDIR
        if fault:
            raise OSError(fault, os.strerror(fault))
    except OSError as error:
        raise cannot_write(path, error) from error


class _RateColumn(ProgressColumn):
    """Frames per second so far."""

    def render(self, task: Task) -> Text:
        """Show the rate, or nothing before the first frame."""
        return Text(f"{task.speed:.1f}/s" if task.speed else "", style="progress.data.speed")


# A progress bar with rate and time left, on a terminal; silent elsewhere.


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

"""Output of the verbs: tables, JSON, checks of output names, progress bars."""

import contextlib
import dataclasses
import errno
import itertools
import json
import logging
import os
import shlex
import shutil
from collections.abc import Iterable, Iterator, Sequence
from contextvars import ContextVar
from datetime import timedelta
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn
from rich.table import Table
from rich.text import Text

from vntoolkit import progress
from vntoolkit.errors import BadInput, CannotWrite, VntError, escaped
from vntoolkit.io.atomic import cannot_write, write_text
from vntoolkit.io.files import read_json

_WIDE = 200
_SUBJECT = ("measured", "mesh", "reference")  # keys of an evaluation that say of what it is
_LOGGER = logging.getLogger(__name__)
JSON, PAGE, PICTURE, MESH = (".json",), (".html",), (".png", ".svg"), (".ply", ".obj")
_PRINTS = ContextVar("prints", default=True)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[str]], names: int = 1) -> None:
    """Print a table whose first `names` columns are texts and whose others are numbers."""
    if not _PRINTS.get():
        return
    table = Table(title=escaped(title), title_justify="left", title_style="bold", box=None, pad_edge=False)
    for i, column in enumerate(columns):
        table.add_column(column, justify="left" if i < names else "right", no_wrap=True)
    for row in rows:
        table.add_row(*map(escaped, row))
    progress.end()
    plain_console().print(table)


def say(line: object, *, flush: bool = False) -> None:
    """Print one line; names in it may hold what a terminal would obey."""
    if _PRINTS.get():
        progress.end()
        print(escaped(str(line)), flush=flush)


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Let nothing be printed: a verb that is called from Python returns what a command prints."""
    before = _PRINTS.set(False)
    try:
        yield
    finally:
        _PRINTS.reset(before)


def plain_console() -> Console:
    """Return a console without markup: brackets and colons in names are printed unchanged."""
    plain: dict[str, Any] = {"highlight": False, "markup": False, "emoji": False}
    console = Console(**plain)
    # a pipe or a file has no width
    return console if console.is_terminal else Console(**plain, width=_WIDE)


def print_next(*words: str | Path) -> None:
    """Print the command that most often comes next, ready to paste into a shell."""
    say(f"next: {shlex.join(['vntoolkit', *map(str, words)])}")


def unused(name: str) -> str:
    """Return a name for a folder of results that is not there yet: result, result_2, ..."""
    names = itertools.chain([name], (f"{name}_{number}" for number in itertools.count(2)))
    return next(each for each in names if not Path(each).exists())


def print_next_program(written: Path) -> None:
    """Print the command that opens a mesh or an animation in MeshLab or Blender; its name without them."""
    suffix = written.suffix.lower()
    words = ["meshlab", str(written)]
    if suffix not in MESH:
        reader = "import_scene.gltf" if suffix == ".glb" else "wm.usd_import"
        words = ["blender", "--python-expr", f"import bpy; bpy.ops.{reader}(filepath={str(written)!r})"]
    if shutil.which(words[0]):
        say(f"next: {shlex.join(words)}")
    else:
        say(f"next: open {written} in {'MeshLab or ' if suffix in MESH else ''}Blender (File, Import)")


def write_json(path: Path, content: Any) -> None:
    """Write dataclasses, or lists and dictionaries of them, as indented JSON.

    Says so where it takes the place of the evaluation of another subject.
    """
    with contextlib.suppress(OSError, VntError):
        before = read_json(path)
        subjects = [
            " against ".join(str(found[key]) for key in _SUBJECT if found.get(key))
            for found in (before, content)
            if isinstance(found, dict)
        ]
        if len(subjects) == 2 and subjects[0] != subjects[1]:
            _LOGGER.warning("%s: held the evaluation of %s, replaced", path, subjects[0] or "something else")
    write_text(path, json.dumps(content, indent=1, default=_plain) + "\n")


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return dataclasses.asdict(value)
    if isinstance(value, Path):
        return str(value)
    return value.item()  # numpy's numbers


def require_output(path: Path | None, suffixes: tuple[str, ...] = ()) -> None:
    """Raise `BadInput` or `CannotWrite` if a file of that name cannot be written; creates nothing.

    Verbs call it first, so that a bad name is refused before minutes of work. suffixes: allowed endings of
    the name; () allows any. path: None passes.
    """
    if path is None:
        return
    if suffixes and path.suffix.lower() not in suffixes:
        raise BadInput(f"{path}: expected a name that ends in {' or '.join(suffixes)}")
    try:
        if path.is_dir():
            raise CannotWrite(f"{path}: expected the name of a file to write, got a folder")
        nearest = next(folder for folder in path.absolute().parents if folder.exists())
        fault = 0 if os.access(nearest, os.W_OK | os.X_OK) else errno.EACCES
        fault = fault if nearest.is_dir() else errno.ENOTDIR
        if fault:
            raise OSError(fault, os.strerror(fault))
    except OSError as error:
        raise cannot_write(path, error) from error


class _PaceColumn(ProgressColumn):
    """Shows frames per second and the time left; nothing before the first frame of this run.

    Frames come in blocks, so the rate is that since the bar began; frames from before do not count.
    """

    def render(self, task: Task) -> Text:
        """Show both."""
        done, elapsed = task.completed - task.fields["before"], task.elapsed or 0.0
        if done <= 0 or elapsed <= 0 or task.total is None:
            return Text("")
        left = timedelta(seconds=round((task.total - task.completed) * elapsed / done))
        return Text(f"{done / elapsed:.1f}/s {left}", style="progress.data.speed")


class ProgressBars(progress.Listener):
    """Shows one progress bar after another on standard error, if that is a terminal."""

    def __init__(self) -> None:
        self._stack, self._bar = contextlib.ExitStack(), Progress(disable=True)

    def begin(self, title: str, total: int | None, done: int) -> None:
        """Replace the bar by a new one."""
        self.end()
        counted = () if total is None else (MofNCompleteColumn(), _PaceColumn())
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), *counted)
        console = Console(stderr=True)
        hidden = not (console.is_terminal or console.is_jupyter)
        self._bar = Progress(*columns, console=console, disable=hidden, transient=True)
        self._stack.enter_context(self._bar)
        self._bar.add_task(escaped(title), total=total, completed=done, before=done)

    def step(self, count: int) -> None:
        """Advance the bar."""
        for task in self._bar.task_ids:
            self._bar.advance(task, count)

    def end(self) -> None:
        """Remove the bar."""
        self._stack.close()

"""Results on the screen and on disk: a table, and the same numbers as JSON."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from vntoolkit.io.atomic import write_text

_WIDE = 200


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

"""One page of every recipe: in one table the paper's numbers beside ours, then each recipe's figures.

A recipe leaves in its folder numbers.json, a list of {"what", "paper", "ours", "unit"} whose values are
numbers, texts or null, and figures as PNG, JPEG, WebP or SVG.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.errors import BadInput
from vntoolkit.io.files import read_text
from vntoolkit.io.images import read_image, resized_image
from vntoolkit.report.page import (
    PageFigure,
    PageNotice,
    PageSection,
    PageTable,
    figure_from_file,
    figure_from_pixels,
    write_page,
)

NUMBERS_NAME = "numbers.json"
_KEYS = {"what", "paper", "ours", "unit"}
_DRAWN = (".svg",)
_PAINTED = (".png", ".jpg", ".jpeg", ".webp")
_WIDEST_PX = 1800
_LARGEST_PNG = 1_500_000  # bytes; a larger one goes on the page as JPEG
_DIGITS = 4
_NOTHING = "–"


@dataclass(frozen=True, kw_only=True)
class RecipeRun:
    """What running a recipe left. name: as on the command line. summary: one line. folder: its output.

    seconds: it took. failure: one line where it failed, else empty.
    """

    name: str
    summary: str
    folder: Path
    seconds: float = 0.0
    failure: str = ""


@dataclass(frozen=True, kw_only=True)
class RecipeNumber:
    """One number. paper: the published value, None where there is none. ours: ours."""

    what: str
    paper: float | str | None
    ours: float | str | None
    unit: str


def read_numbers(folder: Path) -> list[RecipeNumber]:
    """Read a recipe's numbers.json; without the file there are none. Raises `BadInput`."""
    path = folder / NUMBERS_NAME
    if not path.exists():
        return []
    try:
        rows = json.loads(read_text(path))
    except json.JSONDecodeError as problem:
        raise BadInput(f"{path}: is not JSON: {problem.msg} at line {problem.lineno}") from problem
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadInput(f"{path}: expected a list of objects with the keys {', '.join(sorted(_KEYS))}")
    for row in rows:
        if set(row) != _KEYS:
            raise BadInput(
                f"{path}: expected the keys {', '.join(sorted(_KEYS))}, got {', '.join(sorted(row))}"
            )
    return [
        RecipeNumber(what=str(row["what"]), paper=row["paper"], ours=row["ours"], unit=str(row["unit"] or ""))
        for row in rows
    ]


def write_recipes_page(out: Path, runs: Sequence[RecipeRun]) -> Path:
    """Write the page about recipes that were run, atomically; return its path. Raises `BadInput`."""
    numbers = {run.name: read_numbers(run.folder) for run in runs if not run.failure}
    rows = tuple(
        (run.name, number.what, _shown(number.paper), _shown(number.ours), number.unit)
        for run in runs
        for number in numbers.get(run.name, [])
    )
    failed = [run for run in runs if run.failure]
    table = PageSection(
        title="The paper beside ours",
        paragraphs=(
            "Published values are those of brostow2011, measured on its own footage; ours are measured on "
            "the footage that each recipe names. A dash: the paper gives no number.",
        ),
        notices=tuple(PageNotice(severity="warning", text=f"{run.name}: {run.failure}") for run in failed),
        tables=(PageTable(headings=("recipe", "what", "paper", "ours", "unit"), rows=rows),) if rows else (),
    )
    sections = [table, *(_section(run) for run in runs)]
    minutes = sum(run.seconds for run in runs) / 60
    subtitle = f"{len(runs)} recipes, {len(rows)} numbers, run in {minutes:.1f} minutes"
    write_page(out, "Every figure and table", sections, subtitle=subtitle)
    return out


def _section(run: RecipeRun) -> PageSection:
    took = f" Took {run.seconds:.0f} s." if run.seconds else ""
    notices = (PageNotice(severity="warning", text=run.failure),) if run.failure else ()
    return PageSection(
        title=run.name,
        paragraphs=(run.summary + took,),
        notices=notices,
        figures=tuple(_figure(path) for path in figures_of(run.folder)),
    )


def figures_of(folder: Path) -> list[Path]:
    """Return the figures that lie in a recipe's folder itself, by the numbers in their names."""
    found = [path for path in folder.glob("*") if path.suffix.lower() in (*_DRAWN, *_PAINTED)]
    return sorted(
        found, key=lambda path: [int(w) if w.isdigit() else w for w in re.split(r"(\d+)", path.name)]
    )


def _figure(path: Path) -> PageFigure:
    caption = path.stem.replace("_", " ")
    if path.suffix.lower() in _DRAWN or path.stat().st_size < _LARGEST_PNG:
        return figure_from_file(path, caption, wide=True)
    pixels: Any = read_image(path)
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    return figure_from_pixels(resized_image(pixels, _WIDEST_PX), caption, wide=True)


def _shown(value: float | str | None) -> str:
    if value is None:
        return _NOTHING
    if isinstance(value, str | bool):
        return str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.{_DIGITS}g}"

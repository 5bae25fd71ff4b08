"""One page of every recipe: in one table the paper's numbers beside ours, then each recipe's figures.

A recipe leaves in its folder numbers.json, a list of {"what", "paper", "ours", "unit"} whose values are
numbers, texts or null, and figures as PNG, JPEG, WebP or SVG.
"""

import ast
import dataclasses
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import read_json, read_text
from vntoolkit.io.footage.image_writing import resized_image
from vntoolkit.io.footage.images import read_image
from vntoolkit.report import page

NUMBERS_NAME = "numbers.json"
_DRAWN = (".svg",)
_PAINTED = (".png", ".jpg", ".jpeg", ".webp")
_WIDEST_PX = 1800
_LARGEST_PNG = 1_500_000  # bytes; a larger one goes on the page as JPEG
_DIGITS = 4
_NOTHING = "–"
_HEADINGS = ("what", "paper", "ours", "unit")  # and keys
_MOST_ROWS = 12  # more are folded away
_FIGURE = re.compile(r"^([\w.-]+\.(?:png|jpe?g|webp|svg)): (.+)$")


@dataclass(frozen=True, kw_only=True)
class RecipeRun:
    """What running a recipe left. name: as on the command line. text: what it says of itself.

    folder: its output. seconds: it took. failure: one line where it failed, else empty.
    """

    name: str
    text: "RecipeText"
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
    rows = read_json(path)
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise BadInput(f"{path}: expected a list of objects with the keys {', '.join(_HEADINGS)}")
    for row in rows:
        if set(row) != set(_HEADINGS):
            raise BadInput(f"{path}: expected the keys {', '.join(_HEADINGS)}, got {', '.join(row)}")
    return [
        RecipeNumber(what=str(row["what"]), paper=row["paper"], ours=row["ours"], unit=str(row["unit"] or ""))
        for row in rows
    ]


def write_recipes_page(out: Path, runs: Sequence[RecipeRun]) -> Path:
    """Write the page about recipes that were run, atomically; return its path. Raises `BadInput`."""
    numbers = {run.name: [] if run.failure else read_numbers(run.folder) for run in runs}
    compared = tuple(
        (run.name, *_row(number)) for run in runs for number in numbers[run.name] if number.paper is not None
    )
    table = page.PageSection(
        title="The paper beside ours",
        paragraphs=(
            "Published values are those of brostow2011, measured on its own footage; ours are measured on "
            "the footage that each recipe names. What the paper gives no number for stands further down, "
            "with its recipe.",
        ),
        notices=tuple(_notice(run) for run in runs if run.failure),
        tables=(page.PageTable(headings=("recipe", *_HEADINGS), rows=compared, right=(2, 3)),)
        if compared
        else (),
    )
    sections = [table, *(_section(run, numbers[run.name]) for run in runs)]
    minutes = sum(run.seconds for run in runs) / 60
    count = sum(map(len, numbers.values()))
    subtitle = f"{len(runs)} recipes, {count} numbers, run in {minutes:.1f} minutes"
    page.write_page(out, "Every figure and table", sections, subtitle=subtitle)
    return out


def _section(run: RecipeRun, numbers: Sequence[RecipeNumber]) -> page.PageSection:
    took = f" Took {_duration(run.seconds)}." if run.seconds else ""
    command = f"vntoolkit recipe run {run.name}"
    title = run.text.title
    return page.PageSection(
        title=title if title.startswith("Figure") else run.name.replace("_", " ").capitalize(),
        paragraphs=(run.text.summary, *run.text.paragraphs, f"Made by: {command}.{took}"),
        notices=(_notice(run),) if run.failure else (),
        figures=tuple(_figure(path, run.text) for path in figures_of(run.folder)),
        tables=(_table(numbers),) if numbers else (),
    )


def _table(numbers: Sequence[RecipeNumber]) -> page.PageTable:
    """All numbers of a recipe; without the paper's column where it gives none of them."""
    folded = f"all {len(numbers)} numbers" if len(numbers) > _MOST_ROWS else ""
    rows = tuple(_row(number) for number in numbers)
    if any(number.paper is not None for number in numbers):
        return page.PageTable(headings=_HEADINGS, rows=rows, folded=folded, right=(1, 2))
    without = tuple((what, ours, unit) for what, _, ours, unit in rows)
    return page.PageTable(headings=("what", "ours", "unit"), rows=without, folded=folded, right=(1,))


def _notice(run: RecipeRun) -> page.PageNotice:
    return page.PageNotice(severity="warning", text=f"{run.name}: {run.failure}")


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.1f} min"


def _row(number: RecipeNumber) -> tuple[str, str, str, str]:
    return number.what, _shown(number.paper), _shown(number.ours), number.unit


def figures_of(folder: Path) -> list[Path]:
    """Return the figures that lie in a recipe's folder itself, by the numbers in their names."""
    found = [path for path in folder.glob("*") if path.suffix.lower() in (*_DRAWN, *_PAINTED)]
    return sorted(
        found, key=lambda path: [int(w) if w.isdigit() else w for w in re.split(r"(\d+)", path.name)]
    )


def _figure(path: Path, text: "RecipeText") -> page.PageFigure:
    caption = text.captions.get(path.name, path.stem.replace("_", " "))
    caption = caption[:1].upper() + caption[1:]
    if path.suffix.lower() in _DRAWN or path.stat().st_size < _LARGEST_PNG:
        return page.figure_from_file(path, caption, wide=True)
    pixels: Any = read_image(path)
    if pixels.dtype == np.uint16:
        pixels = (pixels >> 8).astype(np.uint8)
    return page.figure_from_pixels(resized_image(pixels, _WIDEST_PX), caption, wide=True)


def _shown(value: float | str | None) -> str:
    if value is None:
        return _NOTHING
    if isinstance(value, str | bool):
        return str(value)
    return f"{value:,}" if isinstance(value, int) else f"{value:.{_DIGITS}g}"


@dataclass(frozen=True, kw_only=True)
class RecipeText:
    """summary: one line. paragraphs: what it does. captions: of its figures, by the names of their files."""

    summary: str
    paragraphs: tuple[str, ...] = ()
    captions: Mapping[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """What stands before the colon: "Figure 4", or "Table"."""
        return self.summary.partition(":")[0]


# The text of a recipe: the docstring of its script.


def read_recipe_text(script: Path) -> RecipeText:
    """Read a script's docstring, without running it."""
    documentation = ast.get_docstring(ast.parse(read_text(script))) or ""
    summary, _, rest = documentation.partition("\n")
    paragraphs: list[str] = []
    captions: dict[str, str] = {}
    for block in re.split(r"\n\s*\n", rest.strip("\n")):
        lines = block.splitlines()
        if not lines or lines[0].startswith(" "):  # the command
            continue
        found = [_FIGURE.match(line) for line in lines]
        if found[0] is None:
            paragraphs.append(" ".join(lines))
            continue
        name = ""
        for line, figure in zip(lines, found, strict=True):
            if figure is not None:
                name = figure[1]
            captions[name] = figure[2] if figure is not None else f"{captions[name]} {line.strip()}"
    return RecipeText(summary=summary, paragraphs=tuple(paragraphs), captions=captions)


# The numbers of a recipe, ours beside the paper's.


def number(what: str, ours: float | str, unit: str, paper: float | str | None = None) -> RecipeNumber:
    """Return one number; figures beyond the fifth are dropped."""
    rounded = float(f"{ours:.5g}") if isinstance(ours, float) else ours
    return RecipeNumber(what=what, paper=paper, ours=rounded, unit=unit)


def write_numbers(folder: Path, numbers: Sequence[RecipeNumber]) -> str:
    """Write numbers.json into a recipe's folder, and return them as lines to print."""
    rows = [dataclasses.asdict(each) for each in numbers]
    write_text(folder / NUMBERS_NAME, json.dumps(rows, indent=1) + "\n")
    return "\n".join(_line(each) for each in numbers)


def _line(each: RecipeNumber) -> str:
    ours = f"{each.ours:.4g}" if isinstance(each.ours, float) else str(each.ours)
    beside = "" if each.paper is None else f" (in paper: {each.paper})"
    return f"{each.what}: {ours} {each.unit}".rstrip() + beside

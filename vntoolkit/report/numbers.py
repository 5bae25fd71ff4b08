"""The numbers that a recipe ends with, ours beside the paper's: on disk for the page, and as text."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path

from vntoolkit.io.atomic import write_text
from vntoolkit.report.recipes_page import NUMBERS_NAME, RecipeNumber


def number(what: str, ours: float | str, unit: str, paper: float | str | None = None) -> RecipeNumber:
    """Return one number; figures beyond the fifth are dropped."""
    rounded = float(f"{ours:.5g}") if isinstance(ours, float) else ours
    return RecipeNumber(what=what, paper=paper, ours=rounded, unit=unit)


def write_numbers(folder: Path, numbers: Sequence[RecipeNumber]) -> str:
    """Write numbers.json into a recipe's folder, and return them as lines to print."""
    rows = [dataclasses.asdict(each) for each in numbers]
    ordered = [{key: row[key] for key in ("what", "paper", "ours", "unit")} for row in rows]
    write_text(folder / NUMBERS_NAME, json.dumps(ordered, indent=1) + "\n")
    return "\n".join(_line(each) for each in numbers)


def _line(each: RecipeNumber) -> str:
    ours = f"{each.ours:.4g}" if isinstance(each.ours, float) else str(each.ours)
    beside = "" if each.paper is None else f" (in paper: {each.paper})"
    return f"{each.what}: {ours} {each.unit}".rstrip() + beside

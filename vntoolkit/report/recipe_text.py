"""What a recipe says of itself: the docstring of its script, taken apart.

First a line of summary; then, indented, the command that runs it with its time; then paragraphs of what it
does; at the end, a line "FILE: caption" for every figure that it writes.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from vntoolkit.io.files import read_text

_FIGURE = re.compile(r"^([\w.-]+\.(?:png|jpe?g|webp|svg)): (.+)$")


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

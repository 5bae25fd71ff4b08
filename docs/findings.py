"""A hook of the site: writes, under each heading of *When it goes wrong*, what the program prints.

The texts are those of `vntoolkit/diagnosis/table.py`, so that the page cannot go stale. Nothing else of the
package is read: the site is built without it.
"""

from __future__ import annotations

import re
import runpy
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "vntoolkit"
TABLE: dict[str, tuple[str, str, str, str, str]] = runpy.run_path(str(PACKAGE / "diagnosis" / "table.py"))[
    "TABLE"
]
_HEADING = re.compile(r"^## `([\w-]+)`$", re.MULTILINE)
_KINDS = {"note": "note", "warning": "warning", "fatal": "danger"}


def on_page_markdown(markdown: str, page: object, **_: object) -> str:
    """Fill in the page; mkdocs calls it for each."""
    if page.file.src_uri != "wrong.md":  # type: ignore[attr-defined]
        return markdown

    def filled(heading: re.Match[str]) -> str:
        return "\n".join([heading[0], "", *map(_shown, of_check(heading[1]))])

    return _HEADING.sub(filled, markdown)


def of_check(name: str) -> list[tuple[str, str, str, str, str]]:
    """Return the rows of the table that a check has."""
    return [row for key, row in TABLE.items() if key.partition("/")[0] == name]


def headings(markdown: str) -> list[str]:
    """Return the names of the checks that a page has a section for."""
    return _HEADING.findall(markdown)


def _shown(row: tuple[str, str, str, str, str]) -> str:
    """Return a box; … stands for what is measured."""
    level, problem, _, expected, remedy = (re.sub(r"\{[^}]*\}", "…", text) for text in row)
    return (
        f'!!! {_KINDS[level]} "{level}: {problem}"\n\n    Expected: {expected}. Remedy: {remedy}.\n'
    ).replace("?.\n", "?\n")

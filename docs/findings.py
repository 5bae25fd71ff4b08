"""A hook of the site: writes, under each heading of *When it goes wrong*, what the program prints.

The texts are read from the source of `vntoolkit/diagnosis`, so that the page cannot go stale. Nothing of the
package is imported: the site is built without it.
"""

from __future__ import annotations

import ast
import re
from dataclasses import dataclass
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "vntoolkit"
_HEADING = re.compile(r"^## `([\w-]+)`$", re.MULTILINE)
_LEVELS = {"NOTE": "note", "WARNING": "warning", "FATAL": "fatal"}


@dataclass(frozen=True)
class Text:
    """One `Finding(...)` of the source, as text; … stands for what is measured."""

    levels: tuple[str, ...]
    problem: str
    expected: str
    remedy: str


def check_names() -> dict[str, str]:
    """Return CHECK_NAMES: what each check finds."""
    tree = ast.parse((PACKAGE / "diagnosis" / "finding.py").read_text("utf-8"))
    for node in tree.body:
        if isinstance(node, ast.AnnAssign) and getattr(node.target, "id", "") == "CHECK_NAMES":
            return dict(ast.literal_eval(node.value))
    raise LookupError("vntoolkit/diagnosis/finding.py: CHECK_NAMES is not there")


def findings() -> dict[str, list[Text]]:
    """Return every finding that the package can make, by the name of its check."""
    found: dict[str, list[Text]] = {}
    for path in sorted((PACKAGE / "diagnosis").rglob("*.py")):
        tree = ast.parse(path.read_text("utf-8"))
        constants = {
            target.id: node.value.value
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant)
            for target in node.targets
            if isinstance(target, ast.Name)
        }
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "Finding":
                given = {word.arg: word.value for word in node.keywords}
                text = Text(
                    levels=_levels(given["level"]),
                    problem=_plain(given["problem"], constants),
                    expected=_plain(given["expected"], constants),
                    remedy=_plain(given["remedy"], constants),
                )
                for name in _words(given["check"]):
                    found.setdefault(name, []).append(text)
    return found


def on_page_markdown(markdown: str, page: object, **_: object) -> str:
    """Fill in the page; mkdocs calls it for each."""
    if page.file.src_uri != "wrong.md":  # type: ignore[attr-defined]
        return markdown
    meanings, texts = check_names(), findings()

    def filled(heading: re.Match[str]) -> str:
        return "\n".join(
            [
                heading[0],
                "",
                f"*{meanings[heading[1]]}*",
                "",
                *[_shown(t) for t in texts[heading[1]] if t.problem != "…"],
            ]
        )

    return _HEADING.sub(filled, markdown)


def headings(markdown: str) -> list[str]:
    """Return the names of the checks that a page has a section for."""
    return _HEADING.findall(markdown)


def _shown(text: Text) -> str:
    kind = "danger" if "fatal" in text.levels else "warning" if "warning" in text.levels else "note"
    return (
        f'!!! {kind} "{" or ".join(text.levels)}: {text.problem}"\n\n'
        f"    Expected: {text.expected}. Remedy: {text.remedy}.\n"
    ).replace("?.\n", "?\n")


def _levels(node: ast.expr) -> tuple[str, ...]:
    names = [part.attr for part in ast.walk(node) if isinstance(part, ast.Attribute)]
    return tuple(_LEVELS[name] for name in names if name in _LEVELS) or ("warning", "fatal")


def _words(node: ast.expr) -> list[str]:
    return [
        part.value
        for part in ast.walk(node)
        if isinstance(part, ast.Constant) and isinstance(part.value, str)
    ]


def _plain(node: ast.expr, constants: dict[str, object]) -> str:
    """Return a string expression as text: constants of the file as they are, what is measured as …."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_plain(part, constants) for part in node.values)
    if isinstance(node, ast.BinOp):
        return _plain(node.left, constants) + _plain(node.right, constants)
    if isinstance(node, ast.IfExp):
        return f"{_plain(node.body, constants)}; or: {_plain(node.orelse, constants)}"
    if isinstance(node, ast.FormattedValue):
        name = getattr(node.value, "id", None)
        if name in constants:
            how = "" if node.format_spec is None else _plain(node.format_spec, constants)
            return format(constants[name], how)
    return "…"

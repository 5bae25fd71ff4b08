"""mkdocs hook: on the page of Python, a verb's signature names what it asks for, as a caller writes it.

In the code a verb is a function of one argument class. Its fields are the keywords of a call.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).parent.parent / "vntoolkit"
CLASSES = {
    node.name: node
    for folder in ("options", "cli")
    for path in sorted((PACKAGE / folder).glob("*.py"))
    for node in ast.parse(path.read_text()).body
    if isinstance(node, ast.ClassDef)
}
_ASKED = re.compile(r'<span class="n">asked</span><span class="p">:</span> <span class="n">(\w+)</span>')


def on_page_content(html: str, page: object, **_: object) -> str:
    """Show `source, *, rig, out, …` in the place of `asked: ReconstructArguments`."""
    if page.file.src_uri != "api.md":  # type: ignore[attr-defined]
        return html
    return _ASKED.sub(lambda found: f'<span class="n">{call_of(found[1])}</span>', html)


def call_of(name: str) -> str:
    """Return what a caller gives: what stands first, keywords without a default, … for the rest."""
    fields = {field.target.id: field for field in fields_of(name)}.values()
    first = [field.target.id for field in fields if _is_first(field)]
    keywords = [field.target.id for field in fields if field.value is None]
    return ", ".join([*first, "*", *keywords, "…"])


def fields_of(name: str) -> Iterator[ast.AnnAssign]:
    """Yield the fields of an argument class and of the option classes that it joins."""
    for base in CLASSES[name].bases:
        if isinstance(base, ast.Name) and base.id in CLASSES:
            yield from fields_of(base.id)
    yield from (node for node in CLASSES[name].body if isinstance(node, ast.AnnAssign))


def _is_first(field: ast.AnnAssign) -> bool:
    return isinstance(field.value, ast.Call) and any(each.arg == "kw_only" for each in field.value.keywords)

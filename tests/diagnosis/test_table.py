"""The table of findings: every text is filled in by a check, with all the values that it names."""

import ast
from pathlib import Path
from string import Formatter

from vntoolkit import diagnosis
from vntoolkit.diagnosis.table import TABLE


def test_every_finding_is_given_the_values_that_its_texts_name() -> None:
    package = Path(diagnosis.__file__).parents[1]
    files = [
        path for path in package.rglob("*.py") if path.parent.name == "diagnosis" or path.stem == "track"
    ]
    sources = "\n".join(path.read_text("utf-8") for path in files if path.stem != "table")
    for node in ast.walk(ast.parse(sources.replace("from __future__ import annotations", ""))):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "Finding.of":
            given = {word.arg for word in node.keywords}
            for name in ast.walk(node.args[0]):
                if None not in given and isinstance(name, ast.Constant):
                    named = {field for text in TABLE[name.value] for _, field, *_ in Formatter().parse(text)}
                    assert named - {None} == given - {"level"}, name.value
    for name in TABLE:
        assert f'"{name}"' in sources, name

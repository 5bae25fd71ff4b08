"""CONVENTIONS.md names files that exist, and one function for each equation; the example computes them."""

import importlib
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGE = (ROOT / "CONVENTIONS.md").read_text()
EQUATIONS = re.findall(r"^\| (\d) \|.*\| `(\w+)` \| `([\w/]+)\.py` \|$", PAGE, flags=re.MULTILINE)
PATHS = re.findall(r"`([\w/]+\.py)`", PAGE)
UNITS = ("%", "%", "(a ratio)", "%", "px", "mm", "mm", "cm")


def test_every_equation_is_in_the_table() -> None:
    assert [number for number, _, _ in EQUATIONS] == list("12345678")


@pytest.mark.parametrize(("number", "name", "file"), EQUATIONS, ids=[f"equation_{e[0]}" for e in EQUATIONS])
def test_the_first_line_of_a_docstring_carries_the_number(number: str, name: str, file: str) -> None:
    documented = getattr(importlib.import_module(f"vntoolkit.{file.replace('/', '.')}"), name).__doc__
    assert documented.startswith(f"Equation {number}: ")


@pytest.mark.parametrize("path", PATHS)
def test_every_path_exists(path: str) -> None:
    assert any((ROOT / folder / path).is_file() for folder in ("vntoolkit", "."))


@pytest.mark.slow
def test_the_example_prints_a_figure_for_each_equation(capsys: pytest.CaptureFixture[str]) -> None:
    example = ROOT / "examples" / "paper.py"
    assert len(example.read_text().splitlines()) < 80
    runpy.run_path(str(example))
    lines = capsys.readouterr().out.splitlines()
    figures = []
    for number, (line, unit) in enumerate(zip(lines, UNITS, strict=True), start=1):
        assert line.startswith(f"equation {number} ")
        assert line.endswith(f" {unit}")
        figures.append(float(line.removesuffix(unit).split()[-1]))
    colour, _, condition, fit, flow, point, vertex, _ = figures
    assert colour < 2.0  # at edges a pixel mixes normals, and equation 1 holds for one
    assert fit < 1.0
    assert 1.0 < condition < 10.0
    assert flow < 1.0
    assert max(point, vertex) < 100.0  # one leg stands before the other: normals say nothing about the gap

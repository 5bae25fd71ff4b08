"""The page of all recipes: every number and figure is on it, and a bad file is named."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.browser import visit
from vntoolkit.errors import BadInput
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.report.recipes_page import (
    RecipeRun,
    RecipeText,
    figures_of,
    read_numbers,
    read_recipe_text,
    write_recipes_page,
)


@pytest.fixture
def folder(tmp_path: Path, rng: np.random.Generator) -> Path:
    out = tmp_path / "figure4"
    out.mkdir()
    rows = [
        {"what": "mean <angle>", "paper": 3.25, "ours": 1.23456789, "unit": "degrees"},
        {"what": "frames", "paper": None, "ours": 1500, "unit": ""},
    ]
    (out / "numbers.json").write_text(json.dumps(rows))
    write_png(out / "view10.png", rng.integers(0, 255, (40, 60, 3), dtype=np.uint8))
    write_png(out / "view2.png", rng.integers(0, 255, (1000, 1200, 3), dtype=np.uint8))  # too large as PNG
    (out / "plot.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"/>')
    (out / "video.mkv").write_bytes(b"not a figure")
    return out


def test_numbers_and_figures_are_on_the_page(folder: Path, tmp_path: Path) -> None:
    runs = [
        RecipeRun(name="figure4", text=RecipeText(summary="Shadows."), folder=folder, seconds=90),
        RecipeRun(
            name="table1",
            text=RecipeText(summary="A table."),
            folder=tmp_path / "none",
            failure="no footage <here>",
        ),
    ]
    page = write_recipes_page(tmp_path / "all.html", runs)
    text = page.read_text()
    for part in (
        "mean &lt;angle&gt;",
        "3.25",
        "1.235",
        "1,500",
        "–",
        "no footage &lt;here&gt;",
        "1.5 minutes",
    ):
        assert part in text
    assert [path.name for path in figures_of(folder)] == ["plot.svg", "view2.png", "view10.png"]
    assert text.count("data:image/jpeg") == 1
    with visit(page) as seen:
        assert seen.page.evaluate("[...document.images].length") == 3
        cells = seen.page.evaluate("[...document.querySelectorAll('td')].map(c => c.innerText)")
        assert cells[:5] == ["figure4", "mean <angle>", "3.25", "1.235", "degrees"]
        assert seen.requests == [page.as_uri()]
        assert seen.complaints == []


def test_a_table_without_published_numbers_has_no_column_for_them(tmp_path: Path) -> None:
    rows = [{"what": f"number {k}", "paper": None, "ours": 1.0 + k, "unit": "px"} for k in range(20)]
    (tmp_path / "numbers.json").write_text(json.dumps(rows))
    run = RecipeRun(name="nuisances", text=RecipeText(summary="Table: many."), folder=tmp_path)
    text = write_recipes_page(tmp_path / "page.html", [run]).read_text()
    assert "<th>paper</th>" not in text.replace(' class="right"', "")
    assert "<h2>Nuisances</h2>" in text
    assert "all 20 numbers</summary>" in text  # folded away


def test_bad_numbers_are_named(folder: Path) -> None:
    (folder / "numbers.json").write_text('[{"what": 1}]')
    with pytest.raises(BadInput, match="expected the keys what, paper, ours, unit, got what"):
        read_numbers(folder)
    (folder / "numbers.json").write_text('{"what": 1}')
    with pytest.raises(BadInput, match="expected a list of objects"):
        read_numbers(folder)
    (folder / "numbers.json").write_text("[")
    with pytest.raises(BadInput, match="is not JSON"):
        read_numbers(folder)
    (folder / "numbers.json").unlink()
    assert read_numbers(folder) == []


def test_a_recipe_says_what_its_figures_show(tmp_path: Path) -> None:
    (tmp_path / "figure9.py").write_text(
        '''"""Figure 9: views.

    python recipes/figure9.py --out out/figure9        # 2 min

Turns the mesh
and draws it.

figure9.png: the mesh from five sides,
    a moment a row.
curve_2.svg: its error.
"""
'''
    )
    text = read_recipe_text(tmp_path / "figure9.py")
    assert (text.title, text.summary) == ("Figure 9", "Figure 9: views.")
    assert text.paragraphs == ("Turns the mesh and draws it.",)
    assert text.captions == {
        "figure9.png": "the mesh from five sides, a moment a row.",
        "curve_2.svg": "its error.",
    }

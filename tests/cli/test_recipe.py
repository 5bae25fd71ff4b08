"""The recipes: found, short, described, run by name, and packed for those who install the package."""

import ast
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from vntoolkit.cli import recipe
from vntoolkit.errors import BadInput
from vntoolkit.report.recipes_page import number, read_numbers, write_numbers

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("path", sorted((ROOT / "recipes").glob("*.py")), ids=lambda p: p.stem)
def test_a_recipe_says_what_it_does(path: Path) -> None:
    text = path.read_text()
    assert len(recipe.summary_of(path)) > 20
    assert f"recipes/{path.name}" in (ast.get_docstring(ast.parse(text)) or "")
    assert "--out" in text


def test_the_recipes_are_packed_where_the_command_looks() -> None:
    packing = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]
    assert packing["wheel"]["force-include"]["recipes"] == "vntoolkit/recipes"
    assert {"figure06", "figure07", "nuisances", "real_objects"} <= set(recipe.recipes())


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(set(recipe.recipes()) - {"readme_picture", "figure04"}))
def test_a_recipe_runs_in_its_short_form(name: str, tmp_path: Path) -> None:
    """figure04 has none: `tests/test_measured.py` runs it, and compares its numbers."""
    if name == "real_objects" and "VNTOOLKIT_REAL_DATA" not in os.environ:
        pytest.skip("VNTOOLKIT_REAL_DATA is not set: there are no photographs")
    command = f"{sys.executable} -m vntoolkit recipe run {name} --out {tmp_path / 'out'} --quick".split()
    paths = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=paths, text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    assert any((tmp_path / "out").iterdir())


@pytest.fixture
def made_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two recipes: one that works, one that fails with a clear line."""
    scripts = {
        "good": '"""Figure 1: a made-up one."""\nimport sys\nfrom pathlib import Path\n'
        "from vntoolkit.report.recipes_page import number, write_numbers\n"
        'folder = Path(sys.argv[sys.argv.index("--out") + 1])\n'
        'quick = "--quick" in sys.argv\n'
        'print(write_numbers(folder, [number("answer", 21.0 if quick else 42.0, "", 40)]))\n',
        "bad": '"""Table 2: a bad one."""\nfrom vntoolkit.errors import BadInput\n'
        'raise BadInput("no footage")\n',
    }
    for name, text in scripts.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(recipe, "recipes", lambda: {n: tmp_path / f"{n}.py" for n in scripts})
    return tmp_path


def test_one_runs_by_name_with_its_own_arguments(made_up: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recipe.run_command("good", "--quick", out=made_up / "out")
    assert json.loads((made_up / "out" / "numbers.json").read_text())[0]["ours"] == 21.0
    assert "answer: 21 (in paper: 40)" in capsys.readouterr().out
    with pytest.raises(BadInput, match="no footage"):
        recipe.run_command("bad", "--quick", out=made_up / "out")
    assert "bad has no shorter form: it runs in full" in capsys.readouterr().out
    with pytest.raises(BadInput, match=r"expected all, or one of good, bad$"):
        recipe.run_command("other")
    with pytest.raises(BadInput, match=r"one of good, bad; did you mean good\?$"):
        recipe.run_command("goood")


def test_all_run_and_the_one_that_fails_is_named(made_up: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recipe.run_command("all", "--quick", "--data", "nowhere", out=made_up / "all")
    page = (made_up / "all" / "recipes.html").read_text()
    assert "answer" in page
    assert "bad: no footage" in page
    assert "failed: bad" in capsys.readouterr().out


def test_numbers_are_read_back(tmp_path: Path) -> None:
    rows = [number("mean", 1.2345678, "degrees", 8.67), number("frames", 180, "")]
    write_numbers(tmp_path, rows)
    assert [r.ours for r in read_numbers(tmp_path)] == [1.2346, 180]


def test_a_method_that_is_not_there_is_named(tmp_path: Path) -> None:
    from recipes.own_method import method_of

    with pytest.raises(BadInput, match=r"nothing\.py: no such file"):
        method_of(tmp_path / "nothing.py")
    (tmp_path / "empty.py").write_text("other = 1\n")
    with pytest.raises(BadInput, match="expected a function `normals"):
        method_of(tmp_path / "empty.py")

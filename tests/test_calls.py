"""Every call that recipes, benchmarks, examples, scripts and documents make of the package fits its function.

The type checker reads them all. Reported is what ends a run: a module, a name or an attribute that is not
there, and arguments that a function does not take.
"""

import json
import re
import sys
from pathlib import Path

import pytest
from mypy import api

from tests.readme_commands import ROOT, steps_of

SCRIPTS = sorted(path for name in ("recipes", "benchmarks", "scripts") for path in (ROOT / name).glob("*.py"))
EXAMPLES = sorted((ROOT / "examples").rglob("*.py"))
NOTEBOOKS = sorted((ROOT / "examples" / "notebooks").glob("*.ipynb"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
pytestmark = pytest.mark.slow  # the first look at the whole package takes half a minute
STOPS_A_RUN = r"\[(attr-defined|call-arg|name-defined)\]$|Skipping analyzing .vntoolkit"


def faults_of(files: list[Path], cache: Path) -> list[str]:
    """Return the lines of the type checker on what would end a run."""
    options = ["--config-file", str(ROOT / "pyproject.toml"), "--cache-dir", str(cache), "--no-error-summary"]
    options += ["--python-executable", sys.executable, "--scripts-are-modules", "--hide-error-context"]
    report, error, _ = api.run([*options, *map(str, files)])
    assert not error, error
    return [line for line in report.splitlines() if re.search(STOPS_A_RUN, line)]


def scripts_of_documents(folder: Path) -> list[Path]:
    """Write the Python blocks of every page, and the cells of every notebook, as one script each."""
    written = []
    for page in PAGES:
        blocks = [step.text for step in steps_of(page.read_text("utf-8")) if step.language == "python"]
        if blocks:
            written.append(folder / f"page_{page.stem}.py")
            written[-1].write_text("\n".join(blocks))
    for notebook in NOTEBOOKS:
        cells = json.loads(notebook.read_text("utf-8"))["cells"]
        code = ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"]
        written.append(folder / f"notebook_{notebook.stem}.py")
        written[-1].write_text("\n".join(code))
    return written


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("types")


def test_every_call_of_a_script_and_of_a_document_binds(tmp_path: Path, cache: Path) -> None:
    files = [*SCRIPTS, *EXAMPLES, *scripts_of_documents(tmp_path)]
    assert len(files) > 40
    assert not faults_of(files, cache)


def test_a_strict_type_checker_accepts_every_example_of_the_documents(tmp_path: Path, cache: Path) -> None:
    """As an editor shows them. The blocks of a page are one script here, so names come twice."""
    options = ["--strict", "--allow-redefinition", "--follow-imports=silent", "--scripts-are-modules"]
    options += ["--python-executable", sys.executable, "--cache-dir", str(cache), "--no-error-summary"]
    report, error, _ = api.run([*options, *map(str, scripts_of_documents(tmp_path))])
    assert not error, error
    assert not report, report


def test_a_wrong_call_is_found(tmp_path: Path, cache: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text(
        "from vntoolkit.photometry.rig import Rig\n"
        "from vntoolkit.cli.calibrate import calibrate_board\n"
        "from vntoolkit.cli.nowhere import there\n"
        "from vntoolkit.io.rigs import read_rigg\n"
        'calibrate_board("capture.mkv", camera=Rig.camra)\n'
    )
    found = faults_of([wrong], cache)
    assert len(found) == 4, found

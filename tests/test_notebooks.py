"""The notebooks run from top to bottom, each in an empty folder and a process, and show what they make."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "examples" / "notebooks").glob("*.ipynb"))
# Prints what a cell shows, as a browser would get it. No kernel: its messages can be lost.
_RUN = """
import sys
import nbformat
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output

shell = InteractiveShell.instance(history_length=0)
formatter = shell.display_formatter
formatter.active_types = formatter.format_types
for cell in nbformat.read(sys.argv[1], as_version=4).cells:
    if cell.cell_type == "code":
        with capture_output() as captured:
            done = shell.run_cell(cell.source)
        print(captured.stdout, captured.stderr)
        done.raise_error()
        for shown in [formatter.format(done.result)[0], *(output.data for output in captured.outputs)]:
            print(shown.get("text/html", ""))
"""


def test_there_are_notebooks_without_stored_results() -> None:
    nbformat = pytest.importorskip("nbformat")
    assert len(NOTEBOOKS) >= 4
    for path in NOTEBOOKS:
        for cell in nbformat.read(path, as_version=4).cells:
            assert not cell.get("outputs"), f"{path.name}: clear its results"


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path: Path, tmp_path: Path) -> None:
    for name in ("nbformat", "IPython"):
        pytest.importorskip(name)
    environment = {**os.environ, "PYTHONPATH": str(path.parents[2]), "IPYTHONDIR": str(tmp_path / "ipython")}
    command = [sys.executable, "-c", _RUN, str(path)]
    done = subprocess.run(command, check=False, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    assert "data:image/png" in done.stdout

"""Cloth and gel without the libraries that a small computer may lack: pycolmap, pymeshlab, usd-core.

pycolmap has no wheel for Linux on ARM.
"""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.readme_commands import ROOT

# Makes a process that cannot import them.
_WITHOUT = """
import sys
for name in ("pycolmap", "pymeshlab", "pxr"):
    sys.modules[name] = None
"""
_RUN = "from {} import main; sys.exit(main(sys.argv[1:]))"


def run(folder: Path, command: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-c", _WITHOUT + _RUN.format("vntoolkit.__main__"), *command.split()]
    return subprocess.run(words, cwd=folder, env=environment, text=True, capture_output=True, check=False)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Cloth, from footage to a moving mesh."""
    place = tmp_path_factory.mktemp("without")
    for command in (
        "simulate sweater --out film --size 160x120 --frames 0:2",
        "reconstruct film/capture.mkv --rig film/truth/rig.json --out result --distance 5",
        "track result",
    ):
        found = run(place, command)
        assert found.returncode == 0, f"{command}: {found.stderr}"
    return place


@pytest.mark.parametrize("command", ["export result --to glb", "export result --to ply", "report result"])
def test_cloth_goes_on(folder: Path, command: str) -> None:
    found = run(folder, command)
    assert found.returncode == 0, found.stderr


def test_a_gel_answers_a_frame() -> None:
    """The gel's own tests, in a process without the libraries."""
    code = _WITHOUT + _RUN.format("pytest")
    words = [sys.executable, "-c", code, "-q", "-p", "no:cacheprovider", "tests/pipeline/test_gel.py"]
    found = subprocess.run(words, cwd=ROOT, text=True, capture_output=True, check=False)
    assert found.returncode == 0, found.stdout


@pytest.mark.parametrize(
    ("command", "library"),
    [
        ("calibrate head film/capture.mkv --out head.json", "pycolmap"),
        ("export result --to usd --out cloth.usdc", "usd-core"),
        ("export result --to ply --mesh frames --clean --out clean", "pymeshlab"),
    ],
)
def test_what_is_missing_is_named_in_one_line(folder: Path, command: str, library: str) -> None:
    found = run(folder, command)
    assert found.returncode == 1
    assert len(found.stderr.strip().splitlines()) == 1
    assert re.search(rf"pip install (--force-reinstall )?{library}\b", found.stderr.strip()), found.stderr
    assert not (folder / "head.json").exists()
    assert not (folder / "cloth.usdc").exists()

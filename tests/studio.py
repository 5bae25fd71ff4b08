"""What a user would have filmed, small: made once a run, for all tests that run the commands of a page on it.

board.mkv (the calibration board), ball.mkv (a matte ball), capture.mkv (a dancing sweater), all 640×480 and
at one zoom, as on a real set; touch.mkv (touches of a gel).
"""

import fcntl
import os
import shutil
from pathlib import Path

import pytest

from tests.readme_commands import Step, run_step

FILMED = {
    "board": "simulate board --frames ::15 --field-width-m 1.42",
    "ball": "simulate sphere --frames 0:1 --field-width-m 1.42",
    "capture": "simulate sweater --frames 0:3 --field-width-m 1.42",
    "touch": "simulate gel --frames 37:39 --size 320x240 --samples 1",
}


@pytest.fixture(scope="session")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of the films, which the workers of a run share."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "footage"
    folder.mkdir(exist_ok=True)
    with (folder / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        for name, command in FILMED.items():
            if not (folder / f"{name}.mkv").exists():
                run_step(Step("sh", f"vntoolkit {command} --out {name}", 0), folder)
                (folder / name / "capture.mkv").rename(folder / f"{name}.mkv")
    return folder


@pytest.fixture(scope="module")
def studio(footage: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the films in it, for the commands of one page after the other."""
    folder = tmp_path_factory.mktemp("studio")
    for film in footage.glob("*.mkv"):
        shutil.copy(film, folder)
    return folder

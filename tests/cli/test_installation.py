"""`vntoolkit doctor` without footage: what is broken is found, though it is installed; lists agree."""

import os
import re
import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from vntoolkit.__main__ import main
from vntoolkit.cli import doctor
from vntoolkit.libraries import OPEN3D_LIBRARIES, PYMESHLAB_LIBRARIES

ROOT = Path(__file__).resolve().parents[2]
LOCK = ROOT / "requirements.lock"
SYSTEM_LIBRARIES = {**OPEN3D_LIBRARIES, **PYMESHLAB_LIBRARIES}


@pytest.fixture
def broken(tmp_path, monkeypatch, capsys):
    """Return what the doctor says where one library is a module with this text."""

    def said_of(text):
        (tmp_path / "broken_library.py").write_text(text, encoding="utf-8")
        path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
        monkeypatch.setenv("PYTHONPATH", path)
        monkeypatch.setattr(doctor, "_LIBRARIES", (("numpy", "broken_library", "arrays"),))
        monkeypatch.setattr(doctor, "_TRY_VIDEO", "pass")
        assert main(["doctor"]) == 1
        return capsys.readouterr().out

    return said_of


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            "raise ImportError('libidn2.so.0: cannot open shared object file: No such file or directory')",
            r"this system lacks libidn2.so.0: sudo apt-get install libidn2-0\n",
        ),
        (
            "raise ImportError('libnew.so.7: cannot open shared object file: No such file or directory')",
            r"this system lacks libnew.so.7: install the package that holds libnew.so.7 \(apt-file search",
        ),
        (
            # what pymeshlab says of a plugin that it then goes without
            "print('Warning: libp11-kit.so.0: cannot open shared object file: No such file or directory')",
            r"this system lacks libp11-kit.so.0: sudo apt-get install libp11-kit0\n",
        ),
        ("import os; os.abort()", r"numpy: was ended by SIGABRT; pip install --force-reinstall numpy"),
        (
            "raise RuntimeError('built for another NumPy')",
            r"numpy: RuntimeError: built for another NumPy; pip install --force-reinstall numpy",
        ),
        ("raise SystemExit(3)", r"numpy: exit status 3; pip install --force-reinstall numpy"),
    ],
)
def test_a_library_that_is_installed_but_cannot_be_imported_is_found(broken, text, line):
    said = broken(text)
    assert re.search(line, said)
    assert "complete" not in said


def test_a_library_that_never_ends_is_found(broken, monkeypatch):
    monkeypatch.setattr(doctor, "_LONGEST_S", 2.0)
    assert "numpy: did not end within 2 s" in broken("import time; time.sleep(60)")


def test_a_library_that_is_not_installed_is_found(monkeypatch, capsys):
    monkeypatch.setattr(doctor, "_LIBRARIES", (("nowhere-to-be-had", "nowhere_to_be_had", "nothing"),))
    monkeypatch.setattr(doctor, "_TRY_VIDEO", "raise OSError('no codec')")
    assert main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert "nowhere-to-be-had: is not installed; pip install nowhere-to-be-had\n" in said
    assert "a video cannot be written and read back: OSError: no codec\n" in said


def test_a_video_that_comes_back_changed_is_found(monkeypatch):
    monkeypatch.setattr(
        "vntoolkit.io.footage.video.VideoReader.frames",
        lambda reader: iter([SimpleNamespace(values=np.zeros((24, 32, 3), np.uint8))] * 3),
    )
    with pytest.raises(doctor.BadCapture, match="came back with other values"):
        doctor.try_video()


def test_every_dependency_is_tried():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = {re.match(r"[\w.-]+", line)[0].lower() for line in project["dependencies"]}
    assert {name.lower() for name, _, _ in doctor._LIBRARIES} == named - {"open3d-cpu"}


def test_set_up_and_the_readme_name_the_system_libraries_that_the_package_needs():
    set_up = (ROOT / "scripts/set_up.sh").read_text(encoding="utf-8")
    looked_for = re.findall(r'has_library (\S+) \|\| wanted="\$wanted (\S+)"', set_up)
    assert dict(looked_for) == SYSTEM_LIBRARIES
    line = re.search(
        r"^sudo apt-get install (.*)$", (ROOT / "README.md").read_text(encoding="utf-8"), re.MULTILINE
    )
    assert set(line[1].split()) == set(SYSTEM_LIBRARIES.values())


def test_nothing_is_fetched_that_is_not_pinned():
    """pip checks hashes, or installs this package by the locked backend; image and actions have digests."""
    pinned = r"(?m)^([a-z0-9][\w.-]*)==\S+(?: ;[^\\\n]*)? \\\n\s+(--hash)=sha256:"
    locked = dict(re.findall(pinned, LOCK.read_text("utf-8")))
    backend = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["build-system"]["requires"]
    for name in [*(re.split(r"[<>=!~ ]", each)[0] for each in backend), "editables", "uv"]:
        assert locked.get(name) == "--hash", f"{name} is not in requirements.lock with its hashes"
    for script in ("scripts/set_up.sh", "Makefile"):
        for line in (ROOT / script).read_text("utf-8").splitlines():
            if "pip install" in line and not line.lstrip().startswith("#"):
                own = "--no-deps --no-build-isolation --editable ." in line
                assert own or "--require-hashes -r" in line, f"{script}: {line}"
    images = re.findall(r"(?m)^FROM (\S+)", (ROOT / "Dockerfile").read_text("utf-8"))
    assert images
    assert all(re.fullmatch(r"\S+@sha256:[0-9a-f]{64}", image) for image in images)
    workflows = "".join(path.read_text("utf-8") for path in (ROOT / ".github/workflows").glob("*.y*ml"))
    actions = re.findall(r"uses: (\S+)", workflows)
    assert actions
    assert all(re.fullmatch(r"\S+@[0-9a-f]{40}", action) for action in actions)

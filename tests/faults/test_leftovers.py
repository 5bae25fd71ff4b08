"""What a killed run left half-written is removed by the next one, and nothing else is."""

import os
import subprocess
import sys

import pytest

from vntoolkit.io.atomic import atomic_path, require_writable_folder
from vntoolkit.options.export import ExportArguments, ExportFormat
from vntoolkit.pipeline.export import export


@pytest.fixture
def dead() -> int:
    """Number of a process that has ended."""
    done = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True
    )
    return int(done.stdout)


def test_temporaries_of_dead_processes_are_removed(tmp_path, dead):
    (tmp_path / "normals").mkdir()
    old = [tmp_path / f".a.{dead}.part.exr", tmp_path / "normals" / f".1.{dead}.part"]
    kept = [
        tmp_path / f".a.{os.getpid()}.part.exr", tmp_path / ".a.part.exr", tmp_path / f"a.{dead}.part.exr",
        tmp_path / ".hidden", tmp_path / "normals" / "1.exr",
    ]  # fmt: skip
    for path in old + kept:
        path.write_bytes(b"0")
    require_writable_folder(tmp_path)
    assert not any(path.exists() for path in old)
    assert all(path.exists() for path in kept)


def test_a_temporary_is_told_by_its_name(tmp_path):
    with atomic_path(tmp_path / "a.b.exr") as temporary:
        temporary.write_bytes(b"0")
        require_writable_folder(tmp_path)
    assert (tmp_path / "a.b.exr").exists()


@pytest.mark.parametrize("name", ["a.usdc", "a.glb", "folder"])
def test_what_a_killed_export_left_is_removed(tmp_path, dead, dome_result, name):
    to = {"a.usdc": ExportFormat.USD, "a.glb": ExportFormat.GLB}.get(name, ExportFormat.PLY)
    place = tmp_path / name if name == "folder" else tmp_path
    place.mkdir(exist_ok=True)
    left = place / f".a.{dead}.part.usdc"
    left.write_bytes(b"0")
    export(ExportArguments(dome_result.folder, to=to, out=tmp_path / name))
    assert not left.exists()
    assert any(path.is_file() for path in place.iterdir())

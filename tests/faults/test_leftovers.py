"""What a killed run left half-written is removed by the next one, and nothing else is."""

import os
import subprocess
import sys

from vntoolkit.io.atomic import atomic_path, require_writable_folder


def test_temporaries_of_dead_processes_are_removed(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, check=True
    )
    dead = int(done.stdout)
    (tmp_path / "normals").mkdir()
    old = [
        tmp_path / f".a.{dead}.part.exr",
        tmp_path / "normals" / f".1.{dead}.part",
        tmp_path / f".probe.{dead}",
    ]
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

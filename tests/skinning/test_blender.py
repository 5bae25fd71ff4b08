"""What Blender finds in the exported files; needs a Python with `bpy`, named by VNTOOLKIT_BLENDER_PYTHON."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.result_files import write_mesh_sequence
from vntoolkit.geometry.mesh import MeshSequence

ROOT = Path(__file__).parents[2]
SCRIPT = ROOT / "scripts" / "check_in_blender.py"


def run_check(track: MeshSequence, folder: Path, python: str) -> subprocess.CompletedProcess[str]:
    write_mesh_sequence(folder / "track", track)
    motion = ["--motion", str(ROOT / "data" / "walk.bvh"), "--blender", python, "--out", str(folder / "out")]
    command = [sys.executable, str(SCRIPT), str(folder / "track"), *motion]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_without_blender_nothing_is_checked_and_that_is_said(moving_jumper, tmp_path):
    done = run_check(moving_jumper, tmp_path, str(tmp_path / "no_python"))
    assert done.returncode == 0
    assert done.stdout.startswith("nothing checked: ")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_mesh_skeleton_colours_and_range_arrive_in_blender(moving_jumper, tmp_path):
    python = os.environ.get("VNTOOLKIT_BLENDER_PYTHON")
    if python is None:
        pytest.skip("VNTOOLKIT_BLENDER_PYTHON is not set: it names a Python that has `bpy`")
    done = run_check(moving_jumper, tmp_path, python)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("arrives") == 22
    assert "FAILS" not in done.stdout
    assert (tmp_path / "out" / "cloth.usdc.png").stat().st_size > 1000

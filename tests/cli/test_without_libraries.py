"""Cloth and gel without the libraries that a small computer may lack: pycolmap, pymeshlab, usd-core.

pycolmap has no wheel for Linux on ARM.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.readme_commands import ROOT

# A process that cannot import them runs the commands, and then the gel's own tests.
_RUN = """
import contextlib, io, json, sys
for name in ("pycolmap", "pymeshlab", "pxr"):
    sys.modules[name] = None
import pytest
from vntoolkit.__main__ import main

ended = {}
for command in sys.argv[2:]:
    with contextlib.redirect_stderr(io.StringIO()) as said:
        ended[command] = (main(command.split()), said.getvalue())
with contextlib.redirect_stdout(io.StringIO()) as said:
    ended["gel"] = (pytest.main(["-q", "-p", "no:cacheprovider", sys.argv[1]]), said.getvalue())
print(json.dumps(ended))
"""
GOES_ON = (
    "simulate sphere --out film --size 80x60 --frames 0:2",
    "reconstruct film/capture.mkv --rig film/truth/rig.json --out result --distance 5",
    "track result",
    "export result --to glb",
    "export result --to ply",
    "report result",
)
LACKING = {
    "calibrate head film/capture.mkv --out head.json": "pycolmap",
    "export result --to usd --out cloth.usdc": "usd-core",
    "export result --to ply --mesh frames --clean --out clean": "pymeshlab",
}


def test_cloth_and_gel_go_on_and_what_is_missing_is_named_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    gel = str(ROOT / "tests/pipeline/test_gel.py")
    words = [sys.executable, "-c", _RUN, gel, *GOES_ON, *LACKING]
    done = subprocess.run(words, cwd=tmp_path, text=True, capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    ended = json.loads(done.stdout.splitlines()[-1])
    for command in (*GOES_ON, "gel"):
        assert ended[command][0] == 0, f"{command}: {ended[command][1]}"
    for command, library in LACKING.items():
        status, said = ended[command]
        assert (status, said.count("\n")) == (1, 1), said
        assert re.search(rf"pip install (--force-reinstall )?{library}\b", said), said
    assert not (tmp_path / "head.json").exists()
    assert not (tmp_path / "cloth.usdc").exists()

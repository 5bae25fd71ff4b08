"""`reconstruct` lets M change as near lamps ask, says so, and goes on with what its first run found."""

import numpy as np
import pytest

from tests.diagnosis.test_lamp_nearness import CAMERA, seen_under_lamps
from vntoolkit.__main__ import main
from vntoolkit.io.footage.images import write_png
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.io.rigs import rig_from_entry, write_rig
from vntoolkit.photometry.rig import Rig


@pytest.mark.parametrize("nearness", [0.0, 0.12])
def test_a_run_corrects_near_lamps_and_goes_on_alike(tmp_path, nearness):
    frames = tmp_path / "frames"
    frames.mkdir()
    for k in range(2):
        light, response, _ = seen_under_lamps(1, nearness)
        write_png(frames / f"{k}.png", np.rint(light * 65535).astype(np.uint16))
    write_rig(tmp_path / "rig.json", Rig(camera=CAMERA, response=response))
    command = ["reconstruct", str(frames), "--rig", str(tmp_path / "rig.json"), "--out"]
    command += [str(tmp_path / "out"), "--to", "normals", "--shadows", "none", "--materials", "calibrated"]
    assert main([*command, "--frames", "0:1"]) == 0
    first = read_manifest(tmp_path / "out")
    assert main([*command, "--frames", "0:2"]) == 0
    again = read_manifest(tmp_path / "out")
    found = first.options.get("lamps.nearness", 0.0)
    assert again.options.get("lamps.nearness", 0.0) == found
    assert (rig_from_entry(again.rig).response.variation is not None) == (nearness > 0)
    assert abs(found - nearness) < 0.05
    assert ("near-lamps" in [finding.check for finding in first.findings]) == (nearness > 0)

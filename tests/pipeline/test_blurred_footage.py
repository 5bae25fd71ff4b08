"""`reconstruct` says that footage is blurred, and goes on with what its first run found."""

import numpy as np
import pytest

from tests.diagnosis.test_sharpness import filmed, finely, sheet
from vntoolkit.__main__ import main
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.images import write_png
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig

MATRIX = np.array([[0.5, 0.06, -0.45], [-0.22, 0.4, -0.5], [-0.2, -0.35, -0.42]])


@pytest.mark.parametrize("blur_px", [0.5, 2.0])
def test_a_run_measures_blur_and_goes_on_alike(tmp_path, rng, blur_px):
    frames = tmp_path / "frames"
    frames.mkdir()
    for k in range(2):
        light = np.asarray(filmed(finely(sheet), rng, blur_px).rgb)
        write_png(frames / f"{k}.png", np.rint(light * 65535).astype(np.uint16))
    camera = Camera.orthographic(width=240, height=240)
    write_rig(tmp_path / "rig.json", Rig(camera=camera, response=LightResponse(matrix=MATRIX)))
    command = ["reconstruct", str(frames), "--rig", str(tmp_path / "rig.json"), "--out"]
    command += [str(tmp_path / "out"), "--to", "normals", "--shadows", "none", "--materials", "calibrated"]
    assert main([*command, "--frames", "0:1"]) == 0
    first = read_manifest(tmp_path / "out")
    assert main([*command, "--frames", "0:2"]) == 0
    again = read_manifest(tmp_path / "out")
    assert first.options["lens.blur_px"] == pytest.approx(blur_px, rel=0.1, abs=0.07)
    assert again.options["lens.blur_px"] == first.options["lens.blur_px"]
    assert ("blur" in [finding.check for finding in first.findings]) == (blur_px > 1.5)

"""`reconstruct` says that footage is blurred, and goes on with what its first run found."""

import numpy as np
import pytest

from tests.diagnosis.test_sharpness import filmed, finely, sheet
from tests.pipeline.conftest import reconstructed_twice
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig

MATRIX = np.array([[0.5, 0.06, -0.45], [-0.22, 0.4, -0.5], [-0.2, -0.35, -0.42]])


@pytest.mark.parametrize("blur_px", [0.5, 2.0])
def test_a_run_measures_blur_and_goes_on_alike(tmp_path, rng, blur_px):
    lights = [np.asarray(filmed(finely(sheet), rng, blur_px).rgb) for _ in range(2)]
    rig = Rig(camera=Camera.orthographic(width=240, height=240), response=LightResponse(matrix=MATRIX))
    first, again = reconstructed_twice(tmp_path, lights, rig)
    assert first.known.blur_px == pytest.approx(blur_px, rel=0.1, abs=0.07)
    assert again.known == first.known
    assert ("blur" in [finding.check for finding in first.known.findings]) == (blur_px > 1.5)

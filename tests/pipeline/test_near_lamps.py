"""`reconstruct` lets M change as near lamps ask, says so, and goes on with what its first run found."""

import pytest

from tests.diagnosis.test_lamp_nearness import CAMERA, seen_under_lamps
from tests.pipeline.conftest import reconstructed_twice
from vntoolkit.io.results.manifest import rig_of_result
from vntoolkit.photometry.rig import Rig


@pytest.mark.parametrize("nearness", [0.0, 0.12])
def test_a_run_corrects_near_lamps_and_goes_on_alike(tmp_path, nearness):
    light, response, _ = seen_under_lamps(1, nearness)
    first, again = reconstructed_twice(tmp_path, [light, light], Rig(camera=CAMERA, response=response))
    found = first.known.nearness
    assert again.known == first.known
    assert (rig_of_result(again).response.variation is not None) == (nearness > 0)
    assert abs(found - nearness) < 0.05
    assert ("near-lamps" in [finding.check for finding in first.known.findings]) == (nearness > 0)

"""What an albedo that fits, or does not, says of a weak light."""

from __future__ import annotations

import numpy as np

from vntoolkit.shadows.evidence import (
    WEAK_COSINE,
    evidence_from_albedo,
)

LIGHTS = np.array([[-0.5, 0.2, -0.84], [0.5, 0.2, -0.84], [0.0, -0.55, -0.835]])


def test_the_albedo_tells_a_missing_light_from_a_weak_one() -> None:
    """A wall whose light 0 grazes it, and one whose light 0 does not arrive; the surface is known."""
    duals = np.linalg.inv(LIGHTS)
    for normal, missing in (((0.85, 0.0, -0.75), False), ((0.3, 0.3, -0.9), True)):
        predicted = LIGHTS @ (np.asarray(normal) / np.linalg.norm(normal))
        cosines = predicted * [0.0 if missing else 1.0, 1.0, 1.0]
        assert cosines[0] < WEAK_COSINE
        ratio = np.linalg.norm(duals @ cosines)
        found = evidence_from_albedo(0, cosines[0], predicted, ratio, duals)
        assert found < -0.02 if missing else abs(found) < 1e-3

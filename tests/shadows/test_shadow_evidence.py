"""What makes evidence of a shadow sharp: blur undone, and an albedo that fits or does not."""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.shadows.evidence import (
    WEAK_COSINE,
    evidence_from_albedo,
    sharpened_cosines,
)

LIGHTS = np.array([[-0.5, 0.2, -0.84], [0.5, 0.2, -0.84], [0.0, -0.55, -0.835]])


def test_a_blurred_line_of_shadow_turns_dark_again(rng: np.random.Generator) -> None:
    """Three pixels wide, behind a blur of 0.8 pixels and noise: darker inside, no noisier outside."""
    true = np.full((40, 60, 3), 0.8)
    true[:, 29:32] = 0.0
    blurred = cv2.GaussianBlur(true, (0, 0), 0.8) + rng.normal(0.0, 0.01, true.shape)
    mask = np.ones((40, 60), bool)
    mask[:, 55:] = False
    found = sharpened_cosines(blurred, mask)
    assert blurred[:, 29:32].mean() > 0.12
    assert found[5:-5, 29:32].mean() < 0.8 * blurred[5:-5, 29:32].mean()
    assert found[5:-5, 5:20].std() < 1.1 * blurred[5:-5, 5:20].std()
    assert np.array_equal(found[:, 55:], blurred[:, 55:].astype(np.float32))
    narrow = np.zeros((40, 60), bool)
    narrow[:, 26:32] = True  # all of it near the outline, where nothing is sharpened
    kept = sharpened_cosines(blurred, narrow)
    assert np.array_equal(kept[:, 26:32], cv2.medianBlur(blurred.astype(np.float32), 3)[:, 26:32])


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

"""Where cast shadows end: blur undone in part, and the edge at half of the light."""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.shadows.shadow_edges import lit_beyond_half, sharpened


def test_a_blurred_edge_of_a_cast_shadow_lies_at_half_light() -> None:
    mask = np.ones((20, 40), bool)
    step = np.where(np.arange(40) < 20, 0.0, 0.8)[None, :, None] * np.ones((20, 1, 3))
    cosines = cv2.GaussianBlur(step, (0, 0), 1.0).astype(np.float32)
    found = cosines > 0.07
    assert not found[:, :19].any()
    assert found[:, 19:].all()
    lit = lit_beyond_half(found, cosines, np.full_like(cosines, 0.8), mask)
    assert not lit[:, :20].any()
    assert lit[:, 20:].all()
    turned = lit_beyond_half(found, cosines, np.where(found, cosines, 0.0), mask)
    assert np.array_equal(turned, found)  # the surface turns away there


def test_a_blurred_edge_turns_steep_again(rng: np.random.Generator) -> None:
    """Behind a blur of 0.8 pixels and noise: darker just inside the shadow, no noisier outside."""
    true = np.full((40, 60, 3), 0.8)
    true[:, 29:] = 0.0
    blurred = cv2.GaussianBlur(true, (0, 0), 0.8) + rng.normal(0.0, 0.01, true.shape)
    blurred = blurred.astype(np.float32)
    mask = np.ones((40, 60), bool)
    mask[:, 50:] = False
    found = sharpened(blurred, mask)
    assert blurred[5:-5, 29].mean() > 0.2
    assert found[5:-5, 29].mean() < 0.85 * blurred[5:-5, 29].mean()
    assert found[5:-5, 5:20].std() < 1.1 * blurred[5:-5, 5:20].std()
    assert np.array_equal(found[:, 47:], blurred[:, 47:])  # beside the outline

"""Where shadows end: blur undone in part, at a figure's outline, and at half of the light."""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.shadows.shadow_edges import lit_beyond_half, sharpened, turned_from_lights


def sphere(radius: float, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Normals and mask of a sphere seen orthographically."""
    v, u = np.mgrid[:size, :size] - (size - 1) / 2.0
    x, y = u / radius, v / radius
    rest = 1.0 - x**2 - y**2
    normals = np.stack([x, y, -np.sqrt(np.maximum(rest, 0.0))], axis=-1)
    return np.where(rest[..., None] > 0, normals, 0.0), rest > 0


LIGHTS = np.array([[-0.5, 0.0, -0.866], [0.5, 0.0, -0.866], [0.0, -0.5, -0.866]])


def test_the_outline_turns_from_the_lights_that_it_turns_from() -> None:
    normals, mask = sphere(40.0, 96)
    cosines = normals @ LIGHTS.T
    blurred = cv2.GaussianBlur(np.maximum(cosines, 0.0), (0, 0), 0.8)
    inset = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)
    ring = mask & (inset < 2.5)
    spoilt = np.where((inset < 1.6)[..., None], (0.0, 0.0, -1.0), normals)  # blur leaves nothing to read
    turned = turned_from_lights(spoilt, blurred, LIGHTS, mask)
    assert not turned[~ring].any()
    dark = cosines[ring] < 0.0
    assert 100 < dark.sum() < 1000
    assert turned[ring][dark].mean() > 0.9
    assert not turned[ring][cosines[ring] > 0.12].any()
    half = turned_from_lights(spoilt[::2, ::2], blurred, LIGHTS, mask)  # normals of a smaller image
    assert (half == turned)[ring].mean() > 0.8


def test_a_cut_through_a_plane_is_no_outline() -> None:
    normals = np.broadcast_to(np.array([0.6, 0.0, -0.8]), (60, 60, 3))
    mask = np.zeros((60, 60), bool)
    mask[10:50, 10:50] = True
    dark = np.zeros((60, 60, 3))
    assert not turned_from_lights(normals, dark, LIGHTS, mask).any()
    assert not turned_from_lights(normals, dark, LIGHTS, np.ones_like(mask)).any()


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


def test_a_blurred_line_of_shadow_turns_dark_again(rng: np.random.Generator) -> None:
    """Three pixels wide, behind a blur of 0.8 pixels and noise: darker inside, no noisier outside."""
    true = np.full((40, 60, 3), 0.8)
    true[:, 29:32] = 0.0
    blurred = cv2.GaussianBlur(true, (0, 0), 0.8) + rng.normal(0.0, 0.01, true.shape)
    blurred = blurred.astype(np.float32)
    mask = np.ones((40, 60), bool)
    mask[:, 50:] = False
    found = sharpened(blurred, mask)
    assert blurred[:, 29:32].mean() > 0.12
    assert found[5:-5, 29:32].mean() < 0.8 * blurred[5:-5, 29:32].mean()
    assert found[5:-5, 5:20].std() < 1.1 * blurred[5:-5, 5:20].std()
    assert np.array_equal(found[:, 47:], blurred[:, 47:])  # beside the outline

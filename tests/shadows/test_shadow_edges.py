"""Where shadows end: at a figure's outline, beside cast shadows, and in the pixels that need no cut."""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.photometry.frame import labels_from_lit, lit_from_labels
from vntoolkit.shadows.evidence import inset_of
from vntoolkit.shadows.shadow_edges import labels_beyond_half, turned_from_lights


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
    turned = lit_from_labels(turned_from_lights(spoilt, blurred, LIGHTS, inset, mask))
    assert not turned[~ring].any()
    dark = cosines[ring] < 0.0
    assert 100 < dark.sum() < 1000
    assert turned[ring][dark].mean() > 0.9
    assert not turned[ring][cosines[ring] > 0.12].any()
    few = np.zeros_like(mask)
    few[:, :48] = True
    asked = lit_from_labels(turned_from_lights(spoilt, blurred, LIGHTS, inset, few))
    assert np.array_equal(asked, turned & few[..., None])
    half = turned_from_lights(spoilt[::2, ::2], blurred, LIGHTS, inset, mask)  # normals of a smaller image
    assert (lit_from_labels(half) == turned)[ring].mean() > 0.8


def test_a_cut_through_a_plane_is_no_outline() -> None:
    normals = np.broadcast_to(np.array([0.6, 0.0, -0.8]), (60, 60, 3))
    mask = np.zeros((60, 60), bool)
    mask[10:50, 10:50] = True
    dark = np.zeros((60, 60, 3))
    inset = inset_of(mask)
    assert inset is not None
    assert not turned_from_lights(normals, dark, LIGHTS, inset, mask).any()
    assert inset_of(np.ones_like(mask)) is None


def test_a_blurred_edge_of_a_cast_shadow_lies_at_half_light() -> None:
    mask = np.ones((20, 40), bool)
    step = np.where(np.arange(40) < 20, 0.0, 0.8)[None, :, None] * np.ones((20, 1, 3))
    cosines = cv2.GaussianBlur(step, (0, 0), 1.0)
    found = cosines > 0.07
    assert not found[:, :19].any()
    assert found[:, 19:].all()
    labels = labels_from_lit(found)
    facing = np.full(mask.shape, 7, np.uint8)
    lit = lit_from_labels(labels_beyond_half(labels, cosines, facing, mask))
    assert not lit[:, :20].any()
    assert lit[:, 20:].all()
    assert np.array_equal(labels_beyond_half(labels, cosines, labels, mask), labels)  # it turns away there

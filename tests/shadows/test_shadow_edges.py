"""Where cast shadows end."""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.photometry.frame import labels_from_lit, lit_from_labels
from vntoolkit.shadows.shadow_edges import labels_beyond_half


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

"""Which lit pixels keep the normal that their colour gives, and which the one solved with the depth."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import contributions_from_rgb
from vntoolkit.shadows.recovery import weight_of_colour

LIGHTS = np.array([[-0.3, 0.1, -0.95], [0.3, 0.1, -0.95], [0.0, -0.3, -0.95]])
LIGHTS = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)


def test_colour_counts_where_no_light_grazes_and_nowhere_else() -> None:
    leaning = np.deg2rad([0.0, 32.0, 50.0])
    normals = np.stack([np.sin(leaning), np.zeros(3), -np.cos(leaning)], axis=-1)[None]
    assert (normals[0] @ LIGHTS.T).min(axis=-1) == pytest.approx([0.95, 0.65, 0.4], abs=0.05)
    response = LightResponse(matrix=LIGHTS)
    light = contributions_from_rgb(
        (normals @ LIGHTS.T).astype(np.float32), response, np.ones((1, 3), np.float32)
    )
    weights = weight_of_colour(light)[0]
    assert weights[0] == 1.0
    assert 0.0 < weights[1] < 1.0
    assert weights[2] == 0.0

"""Which lit pixels keep the normal that their colour gives, and which the one solved with the depth."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.shadows.recovery import weight_of_colour
from vntoolkit.shadows.surface import mixed

LIGHTS = np.array([[-0.3, 0.1, -0.95], [0.3, 0.1, -0.95], [0.0, -0.3, -0.95]])
LIGHTS = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)


def leaning(degrees: float) -> np.ndarray:
    angle = np.deg2rad(degrees)
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


def test_colour_counts_where_no_light_grazes_and_nowhere_else() -> None:
    inverted = np.array([leaning(0.0), leaning(32.0), leaning(50.0)])
    assert (inverted @ LIGHTS.T).min(axis=-1) == pytest.approx([0.95, 0.65, 0.4], abs=0.05)
    weights = [weight_of_colour(*normal, tuple(LIGHTS.ravel())) for normal in inverted]
    assert weights[0] == 1.0
    assert 0.0 < weights[1] < 1.0
    assert weights[2] == 0.0


def test_a_blend_of_two_normals_lies_between_them() -> None:
    first, second = leaning(20.0), leaning(60.0)
    assert np.allclose(mixed(*first, 1.0, *second), first)
    assert np.allclose(mixed(*first, 0.0, *second), second)
    assert np.allclose(mixed(*first, 0.5, *second), leaning(40.0))

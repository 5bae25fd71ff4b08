"""Which lit pixels keep the normal that their colour gives, and which the one solved with the depth."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.shadows.recovery import normals_by_grazing_incidence

LIGHTS = np.array([[-0.3, 0.1, -0.95], [0.3, 0.1, -0.95], [0.0, -0.3, -0.95]])
LIGHTS = LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)


def leaning(degrees: float) -> np.ndarray:
    angle = np.deg2rad(degrees)
    return np.array([np.sin(angle), 0.0, -np.cos(angle)])


def test_colour_counts_where_no_light_grazes_and_nowhere_else() -> None:
    inverted = np.array([[leaning(0.0), leaning(32.0), leaning(50.0), leaning(0.0)]])
    assert (inverted @ LIGHTS.T).min(axis=-1)[0] == pytest.approx([0.95, 0.65, 0.4, 0.95], abs=0.05)
    solved = np.roll(inverted, 1, axis=-1)  # anything else
    lit = np.array([[True, True, True, False]])
    found = normals_by_grazing_incidence(solved, inverted, LIGHTS, lit)
    assert np.allclose(np.linalg.norm(found, axis=-1), 1.0)
    assert np.allclose(found[0, 0], inverted[0, 0])
    assert np.allclose(found[0, 2:], solved[0, 2:])
    between = found[0, 1] @ inverted[0, 1], found[0, 1] @ solved[0, 1]
    assert all(inverted[0, 1] @ solved[0, 1] < cosine < 1.0 - 1e-4 for cosine in between)

"""How dark a shadow is, where it is half, and what ambient light does to dark paint."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import contributions_from_frame
from vntoolkit.shadows.evidence import (
    CONTRIBUTION_NOISE,
    evidence_of_frame,
    lamps_of,
    typical_dark_cosine,
)

EVERYWHERE = np.ones((20, 30), bool)
MATRIX = np.array([[-0.3, -0.2, -0.5], [0.4, -0.1, -0.5], [0.0, 0.4, -0.6]])
NOISELESS = np.full((20, 30), 1e9)  # an albedo so high that the camera's noise counts for nothing


def test_ambient_light_scales_with_the_albedo(rng: np.random.Generator) -> None:
    normals = rng.normal(size=(20, 30, 3)) * 0.3 - (0.0, 0.0, 1.0)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    response = LightResponse(matrix=MATRIX, ambient=np.array([0.03, 0.02, 0.04]))
    albedo = rng.uniform(0.05, 1.5, (20, 30))
    rgb = albedo[..., None] * (normals @ MATRIX.T + response.ambient)
    measured = contributions_from_frame(
        LinearFrame(rgb=rgb.astype(np.float32), clipped=~EVERYWHERE), response
    )
    assert np.abs(measured.length / albedo - 1.0).max() < 1e-4
    assert np.abs(measured.normals - normals).max() < 1e-4
    assert np.abs(measured.relative_to(albedo) - normals @ MATRIX.T).max() < 1e-4


def test_the_frame_tells_how_much_light_its_shadows_hold() -> None:
    """One light of three is missing on a third of the pixels, where other surfaces return `glow` of it."""
    predicted = np.full((20, 30, 3), 0.8)
    predicted[15:] = 0.02
    for glow in (0.0, 0.1):
        cosines = predicted.copy()
        cosines[:15, :10, 1] = glow
        typical, spread = typical_dark_cosine(cosines, predicted, NOISELESS, EVERYWHERE)
        assert typical == pytest.approx(glow)
        assert spread == pytest.approx(0.0)


def test_shadows_of_uneven_darkness_have_a_spread() -> None:
    """From the tenth percentile to the median."""
    predicted = np.full((20, 30, 3), 0.8)
    cosines = predicted.copy()
    cosines[..., 1] = 0.1 + 0.04 * np.linspace(-1.25, 1.25, 30)
    typical, spread = typical_dark_cosine(cosines, predicted, NOISELESS, EVERYWHERE)
    assert typical == pytest.approx(0.1, abs=0.004)
    assert spread == pytest.approx(0.04, abs=0.004)


def test_a_part_predicted_wrongly_does_not_call_itself_shadow() -> None:
    """Two lights have true shadows without glow; a larger part returns less of the third than predicted."""
    predicted = np.full((20, 30, 3), 0.8)
    cosines = predicted.copy()
    cosines[:4, :, 0] = cosines[4:8, :, 1] = 0.01
    cosines[8:, :, 2] = 0.25  # lit, at a slant that the surface does not know yet
    typical, _ = typical_dark_cosine(cosines, predicted, NOISELESS, EVERYWHERE)
    assert typical == pytest.approx(0.01)


def test_the_noise_of_dark_paint_is_taken_off() -> None:
    predicted = np.full((20, 30, 3), 0.8)
    cosines = np.full((20, 30, 3), 0.3)
    typical, _ = typical_dark_cosine(cosines, predicted, np.full((20, 30), 0.1), EVERYWHERE)
    assert typical == pytest.approx(0.3 - 10 * CONTRIBUTION_NOISE)


def test_a_frame_s_evidence_counts_from_the_level_of_its_shadows() -> None:
    """A light of which half is left, where little and where much light is in shadows."""
    response = LightResponse(matrix=MATRIX, light_colours=np.eye(3))
    normal = np.linalg.inv(MATRIX) @ np.array([0.2, 0.4, 0.4])
    normal /= np.linalg.norm(normal)
    rgb = np.tile(MATRIX @ normal, (20, 30, 1)).astype(np.float32)
    cosines = MATRIX @ normal / np.linalg.norm(MATRIX, axis=1)
    rgb[:, 15:, 0] *= 0.05
    expected = np.ones((4, 20, 30), np.float32)
    expected[:3] = cosines[:, None, None]
    found = evidence_of_frame(rgb, EVERYWHERE, lamps_of(response), expected, (0.0, 0.02))
    assert (found.evidence[0][:, 15:] < 0).all()
    assert (found.evidence[0][found.near & (np.arange(30) < 15)] > 0).all()

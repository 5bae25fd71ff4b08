"""How dark a shadow is, where it is half, and what ambient light does to dark paint."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.contributions import contributions_from_frame
from vntoolkit.shadows.evidence import CONTRIBUTION_NOISE, largest_dark_cosine
from vntoolkit.shadows.initialisation import noise_of_frame

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
    levels = {}
    for glow in (0.0, 0.1):
        cosines = predicted.copy()
        cosines[:15, :10, 1] = glow
        level, _ = largest_dark_cosine(cosines, predicted, NOISELESS, EVERYWHERE)
        assert ((cosines < level)[:15] == (np.arange(30)[:, None] < 10) & (np.arange(3) == 1)).all()
        levels[glow] = level
    assert levels[0.0][15:].max() == pytest.approx(0.015)
    assert levels[0.1][15:].max() == pytest.approx(0.115)
    assert levels[0.0][:15].max() == pytest.approx(0.015)
    assert levels[0.1][:15].max() == pytest.approx(0.315)


def test_shadows_of_uneven_darkness_raise_the_level() -> None:
    """The same median in shadow, with and without a spread: 1.3 times that is added to the upper bound."""
    predicted = np.full((20, 30, 3), 0.8)
    upper = []
    for spread in (0.0, 0.04):
        cosines = predicted.copy()
        cosines[..., 1] = 0.1 + spread * np.linspace(-1.25, 1.25, 30)
        level, _ = largest_dark_cosine(cosines, predicted, NOISELESS, EVERYWHERE)
        upper.append(level.max())
    assert upper[1] - upper[0] == pytest.approx(1.3 * 0.04, abs=0.004)


def test_a_part_predicted_wrongly_does_not_call_itself_shadow() -> None:
    """Two lights have true shadows without glow; a larger part returns less of the third than predicted."""
    predicted = np.full((20, 30, 3), 0.8)
    cosines = predicted.copy()
    cosines[:4, :, 0] = cosines[4:8, :, 1] = 0.01
    cosines[8:, :, 2] = 0.25  # lit, at a slant that the surface does not know yet
    level, _ = largest_dark_cosine(cosines, predicted, NOISELESS, EVERYWHERE)
    dark = cosines < level
    assert dark[:4, :, 0].all()
    assert dark[4:8, :, 1].all()
    assert not dark[8:].any()


def test_noise_counts_for_more_on_dark_paint() -> None:
    predicted = np.full((20, 30, 3), 0.8)
    dark, grain = largest_dark_cosine(predicted, predicted, np.full((20, 30), 0.1), EVERYWHERE)
    white, _ = largest_dark_cosine(predicted, predicted, np.ones((20, 30)), EVERYWHERE)
    assert grain.max() == pytest.approx(10 * CONTRIBUTION_NOISE)
    assert (dark > white).all()


def test_noise_of_slopes_is_measured_whatever_the_shape(rng: np.random.Generator) -> None:
    v, u = np.mgrid[:120, :150] / 30.0
    depth = 12.0 * np.sin(u) * np.cos(1.3 * v)
    slopes = np.stack([np.gradient(depth, axis=1), np.gradient(depth, axis=0)], axis=-1)
    response = LightResponse(matrix=MATRIX)
    for deviation in (0.01, 0.05):
        noisy = slopes + rng.normal(0, deviation, slopes.shape) * (1 + (slopes**2).sum(-1, keepdims=True))
        normals = np.concatenate([noisy, -np.ones((120, 150, 1))], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        found = noise_of_frame(normals @ MATRIX.T, response, np.ones((120, 150), bool))
        assert found == pytest.approx(deviation, rel=0.15)
    assert noise_of_frame(normals @ MATRIX.T, response, np.zeros((120, 150), bool)) is None

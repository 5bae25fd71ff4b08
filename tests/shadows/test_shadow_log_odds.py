"""How dark a shadow is, what dark paint is, and an albedo that fits a missing light or does not."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from vntoolkit.shadows.log_odds import (
    CONTRIBUTION_NOISE,
    WEAK_COSINE,
    log_odds_from_albedo,
    log_odds_of_lights,
    typical_dark_cosine,
    without_paint,
)

LIGHTS = np.array([[-0.5, 0.2, -0.84], [0.5, 0.2, -0.84], [0.0, -0.55, -0.835]])
EVERYWHERE = np.ones((20, 30), bool)
NOISELESS = 1e9  # an albedo so high that the camera's noise counts for nothing


def log_odds(
    cosines: np.ndarray, predicted: npt.ArrayLike, albedo: float, dark: tuple[float, float]
) -> np.ndarray:
    """(h, w, 3), without what the albedo says."""
    surface = np.broadcast_to(predicted, cosines.shape)
    found = log_odds_of_lights(cosines, surface, np.full(cosines.shape[:2], albedo), None, dark, LIGHTS)
    return np.moveaxis(found, 0, -1)


def level(predicted: float, dark: tuple[float, float], albedo: float = NOISELESS) -> float:
    """Cosine at which the log odds change their sign."""
    cosines = np.repeat(np.linspace(0.0, 1.0, 2001)[None, :, None], 3, axis=-1)
    sign = log_odds(cosines, predicted, albedo, dark)[0, :, 0] < 0.0
    return float(cosines[0, sign.argmin(), 0])


def plain_evidence(cosines: np.ndarray, predicted: np.ndarray, albedo: float, dark: tuple[float, float]):
    """The loop of `log_odds_of_lights` without the albedo, as arrays."""
    noise = CONTRIBUTION_NOISE / albedo
    least = dark[0] + 0.015 + noise
    most = max(3.0 * dark[0] + 0.015 + 1.3 * dark[1] + noise, least)
    at = np.clip(0.5 * np.clip(predicted / 0.3, 0.0, 1.0) * predicted, least, most)
    unit = 0.04 + 0.05 * np.maximum(predicted, 0.0)
    return np.clip((cosines - at) / np.hypot(unit, noise), -4.0, 4.0)


def test_the_loop_says_what_the_plain_form_says(rng: np.random.Generator) -> None:
    predicted, cosines = rng.uniform(-0.5, 1.0, (20, 30, 3)), rng.uniform(-0.05, 1.0, (20, 30, 3))
    for albedo, dark in ((1.0, (0.0, 0.02)), (0.1, (0.1, 0.05))):
        assert np.allclose(
            log_odds(cosines, predicted, albedo, dark),
            plain_evidence(cosines, predicted, albedo, dark),
            atol=1e-4,
        )


def test_the_frame_tells_how_much_light_its_shadows_hold() -> None:
    """One light of three is missing on a third of the pixels, where other surfaces return `glow` of it."""
    predicted = np.full((20, 30, 3), 0.8)
    predicted[15:] = 0.02
    albedo = np.full((20, 30), NOISELESS)
    levels = {}
    for glow in (0.0, 0.1):
        cosines = predicted.copy()
        cosines[:15, :10, 1] = glow
        dark = typical_dark_cosine(cosines, predicted, albedo, EVERYWHERE)
        found = log_odds(cosines, predicted, NOISELESS, dark)
        assert ((found < 0.0)[:15] == (np.arange(30)[:, None] < 10) & (np.arange(3) == 1)).all()
        levels[glow] = level(0.02, dark), level(0.8, dark)
    assert levels[0.0] == pytest.approx((0.015, 0.015), abs=6e-4)
    assert levels[0.1] == pytest.approx((0.115, 0.315), abs=6e-4)


def test_shadows_of_uneven_darkness_raise_the_level() -> None:
    """The same median in shadow, with and without a spread: 1.3 times that is added to the upper bound."""
    predicted, albedo = np.full((20, 30, 3), 0.8), np.full((20, 30), NOISELESS)
    upper = []
    for spread in (0.0, 0.04):
        cosines = predicted.copy()
        cosines[..., 1] = 0.1 + spread * np.linspace(-1.25, 1.25, 30)
        upper.append(level(0.8, typical_dark_cosine(cosines, predicted, albedo, EVERYWHERE)))
    assert upper[1] - upper[0] == pytest.approx(1.3 * 0.04, abs=0.004)


def test_a_part_predicted_wrongly_does_not_call_itself_shadow() -> None:
    """Two lights have true shadows without glow; a larger part returns less of the third than predicted."""
    predicted, albedo = np.full((20, 30, 3), 0.8), np.full((20, 30), NOISELESS)
    cosines = predicted.copy()
    cosines[:4, :, 0] = cosines[4:8, :, 1] = 0.01
    cosines[8:, :, 2] = 0.25  # lit, at a slant that the surface does not know yet
    dark = typical_dark_cosine(cosines, predicted, albedo, EVERYWHERE)
    found = log_odds(cosines, predicted, NOISELESS, dark) < 0.0
    assert found[:4, :, 0].all()
    assert found[4:8, :, 1].all()
    assert not found[8:].any()


def test_noise_counts_for_more_on_dark_paint() -> None:
    dark = (0.0, 0.02)
    assert level(0.8, dark, 0.1) - level(0.8, dark) == pytest.approx(10 * CONTRIBUTION_NOISE, abs=1e-3)
    assert level(0.8, dark, 1.0) - level(0.8, dark) == pytest.approx(CONTRIBUTION_NOISE, abs=1e-3)


def test_three_lights_that_are_missing_alike_are_paint() -> None:
    predicted = np.broadcast_to([0.8, 0.7, 0.75], (2, 2, 3)).astype(np.float32)
    painted, shadowed = 0.25 * predicted, predicted * [1.0, 0.1, 1.0]
    assert np.allclose(without_paint(painted, predicted), predicted)
    assert np.allclose(without_paint(shadowed, predicted), shadowed)
    assert np.allclose(without_paint(0.05 * predicted, predicted), 0.05 * predicted)  # three shadows


def test_the_albedo_tells_a_missing_light_from_a_weak_one() -> None:
    """A wall whose light 0 grazes it, and one whose light 0 does not arrive; the surface is known."""
    duals = np.linalg.inv(LIGHTS)
    for normal, missing in (((0.85, 0.0, -0.75), False), ((0.3, 0.3, -0.9), True)):
        predicted = LIGHTS @ (np.asarray(normal) / np.linalg.norm(normal))
        cosines = predicted * [0.0 if missing else 1.0, 1.0, 1.0]
        assert cosines[0] < WEAK_COSINE
        ratio = np.linalg.norm(duals @ cosines)
        found = log_odds_from_albedo(0, cosines[0], predicted, ratio, duals)
        assert found < -0.02 if missing else abs(found) < 1e-3
        one = (cosines.reshape(1, 1, 3), predicted.reshape(1, 1, 3), np.ones((1, 1)))
        without, within = (
            log_odds_of_lights(*one, length, (0.0, 0.02), LIGHTS)[:, 0, 0]
            for length in (None, np.full((1, 1), ratio))
        )
        assert within - without == pytest.approx([found, 0.0, 0.0], abs=1e-5)

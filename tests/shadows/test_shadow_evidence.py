"""What a pixel's cosines say of each light."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt
import pytest

from vntoolkit.shadows.evidence import SURFACE_NOISE, log_odds, mean_dark_cosine

NOISE, PAINT, STRAY = 0.008, 1.0, 0.04
EVERYWHERE = np.ones((9, 11), bool)


def odds_of(
    cosines: npt.ArrayLike, predicted: npt.ArrayLike, albedo: float = 1.0, stray: float = STRAY
) -> np.ndarray:
    """(3,) of one pixel."""
    one = np.ones((1, 1), bool)
    seen, surface = (np.asarray(values, np.float32).reshape(1, 1, 3) for values in (cosines, predicted))
    return log_odds(seen, surface, np.full((1, 1), albedo), one, stray)[:, 0, 0]


def plain_odds(cosines: np.ndarray, predicted: np.ndarray, albedo: float) -> np.ndarray:
    """The same, set by set of lights, as the module says it."""
    noise = NOISE / albedo
    scale, variance = np.hypot(STRAY, noise), SURFACE_NOISE**2 + noise**2
    best = np.zeros((3, 2))
    for arrives in itertools.product((False, True), repeat=3):
        lit = np.array(arrives)
        seen, surface = cosines[lit], np.maximum(predicted[lit], 0.0)
        ratio = (seen @ surface / variance + PAINT**-2) / (surface @ surface / variance + PAINT**-2)
        ratio = max(ratio, 1e-2)
        likely = 1.0 / (1.0 + (np.log(ratio) / PAINT) ** 2)
        rest = seen - ratio * surface
        likely *= np.prod(np.sqrt(variance) / (np.pi * (variance + rest**2)))
        likely *= np.prod(np.exp(-np.maximum(cosines[~lit], 0.0) / scale) / (2.0 * scale))
        for k in range(3):
            best[k, int(lit[k])] = max(best[k, int(lit[k])], likely)
    return np.clip(np.log(best[:, 1] / best[:, 0]), -4.0, 4.0)


def test_the_loop_says_what_the_plain_form_says(rng: np.random.Generator) -> None:
    for _ in range(200):
        predicted = rng.uniform(-0.3, 1.0, 3)
        cosines = np.where(rng.random(3) < 0.5, rng.exponential(STRAY, 3), predicted + rng.normal(0, 0.1, 3))
        albedo = rng.uniform(0.1, 1.0)
        assert odds_of(cosines, predicted, albedo) == pytest.approx(
            plain_odds(cosines.astype(np.float32), predicted, albedo), abs=2e-3
        )


def test_one_light_that_is_missing_is_dark_and_three_that_are_weak_are_paint() -> None:
    predicted = np.array([0.8, 0.7, 0.75])
    assert (np.sign(odds_of([0.8, 0.03, 0.75], predicted)) == (1, -1, 1)).all()
    assert (odds_of(0.25 * predicted, predicted) > 1.0).all()
    assert (odds_of([0.8, 0.7, 0.75], predicted) == 4.0).all()


def test_what_shadows_hold_in_this_frame_counts() -> None:
    predicted = np.array([0.8, 0.7, 0.75])
    cosines = [0.8, 0.12, 0.75]
    assert odds_of(cosines, predicted, stray=0.005)[1] > 1.0
    assert odds_of(cosines, predicted, stray=0.08)[1] < -1.0


def test_noise_counts_for_more_on_dark_paint() -> None:
    predicted, cosines = np.array([0.8, 0.15, 0.75]), [0.8, 0.08, 0.75]
    white, dark = (odds_of(cosines, predicted, albedo, 0.005)[1] for albedo in (1.0, 0.05))
    assert white > dark + 1.0


def test_the_mean_in_shadow_is_measured_away_from_edges() -> None:
    cosines, lit = np.full((9, 11, 3), 0.7, np.float32), np.ones((9, 11, 3), bool)
    lit[1:8, 1:8, 1] = False
    cosines[1:8, 1:8, 1] = 0.3
    cosines[2:7, 2:7, 1] = 0.06
    assert mean_dark_cosine(cosines, lit, EVERYWHERE) == pytest.approx(0.06)
    assert mean_dark_cosine(cosines, np.ones_like(lit), EVERYWHERE) == pytest.approx(0.02)

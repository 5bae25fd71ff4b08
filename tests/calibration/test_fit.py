"""Fitting M to pairs: exact without noise, unmoved by shadow and outliers, refused where undetermined."""

import logging

import numpy as np
import pytest

from tests.attached_shadow import shaded_rgb_from_normals
from vntoolkit.calibration import fit as fitting
from vntoolkit.calibration.fit import Design, fit_by_msac, fit_by_trimming, fit_response
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.options.calibration import FitMethod, ResponseFitOptions, ResponseModel
from vntoolkit.photometry.response import LightResponse, rgb_from_normals

DIRECTIONS = np.array([[0.6, 0.0, -0.8], [-0.36, 0.48, -0.8], [-0.36, -0.48, -0.8]])
COLOURS = np.array([[0.5, 0.05, 0.02], [0.06, 0.6, 0.1], [0.0, 0.1, 0.4]])
AMBIENT = np.array([0.05, 0.03, 0.04])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)
WITH_AMBIENT = LightResponse(matrix=RESPONSE.matrix, ambient=AMBIENT, light_colours=COLOURS)


def hemisphere(rng: np.random.Generator, count: int, cone_deg: float = 80.0) -> np.ndarray:
    z = -rng.uniform(np.cos(np.deg2rad(cone_deg)), 1, count)
    azimuth = rng.uniform(0, 2 * np.pi, count)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)


@pytest.mark.parametrize("method", list(FitMethod))
@pytest.mark.parametrize("model", list(ResponseModel))
def test_matte_hemisphere_gives_the_response_back(rng, monkeypatch, method, model) -> None:
    monkeypatch.setattr(fit_by_msac, "__defaults__", (2000, 0.01))
    truth = RESPONSE if model is ResponseModel.LINEAR else WITH_AMBIENT
    normals = hemisphere(rng, 3000)
    rgb = shaded_rgb_from_normals(normals, truth)
    options = ResponseFitOptions(model=model, method=method)
    fit = fit_response(normals, rgb, options, rng=rng, verb="sphere")
    atol = 1e-9 if method is FitMethod.TRIMMED else 0.005  # MSAC keeps the first hundredth of a shadow
    np.testing.assert_allclose(fit.response.matrix, truth.matrix, atol=atol)
    np.testing.assert_allclose(fit.response.ambient, truth.ambient, atol=atol)
    assert fit.quality.residual_deg < (1e-5 if method is FitMethod.TRIMMED else 0.3)
    assert fit.quality.condition_number == pytest.approx(truth.condition_number, rel=0.02)
    assert fit.quality.samples == fit.inliers.sum()
    shadowed = (normals @ DIRECTIONS.T < -0.05).any(axis=1)
    assert not fit.inliers[shadowed].any()


def test_gloss_and_clipping_do_not_move_the_fit(rng) -> None:
    normals = hemisphere(rng, 5000, 60)
    rgb = shaded_rgb_from_normals(normals, RESPONSE) + rng.normal(0, 0.002, (5000, 3))
    gloss = rng.random(5000) < 0.08
    rgb[gloss] += rng.uniform(0.1, 0.5, (gloss.sum(), 1))
    clipped = (rgb > 0.8).any(axis=1)
    fit = fit_response(normals, np.minimum(rgb, 0.8), clipped=clipped)
    np.testing.assert_allclose(fit.response.matrix, RESPONSE.matrix, atol=0.002)
    assert not fit.inliers[gloss | clipped].any()


def test_msac_survives_forty_percent_of_wrong_pairs(rng, monkeypatch) -> None:
    monkeypatch.setattr(fit_by_msac, "__defaults__", (2000, 0.03))
    normals = hemisphere(rng, 2000, 50)
    rgb = shaded_rgb_from_normals(normals, WITH_AMBIENT) + rng.normal(0, 0.003, (2000, 3))
    wrong = rng.random(2000) < 0.4
    rgb[wrong] = rng.uniform(0, 0.8, (wrong.sum(), 3))
    options = ResponseFitOptions(model=ResponseModel.AMBIENT, method=FitMethod.MSAC)
    fit = fit_response(normals, rgb, options, rng=rng)
    np.testing.assert_allclose(fit.response.matrix, WITH_AMBIENT.matrix, atol=0.01)
    assert fit.inliers[wrong].mean() < 0.01
    assert fit.inliers[~wrong].mean() > 0.9


def test_residual_is_the_injected_noise_from_both_sides(rng, monkeypatch) -> None:
    monkeypatch.setattr(fitting, "_OUTLIER_SIGMAS", 9.0)
    normals = hemisphere(rng, 20000, 45)
    sigma = 0.004
    fit = fit_response(
        normals,
        rgb_from_normals(normals, RESPONSE) + rng.normal(0, sigma, normals.shape),
    )
    scatter = sigma * rng.normal(size=normals.shape) @ RESPONSE.inverse.T
    across = scatter - np.sum(scatter * normals, axis=1, keepdims=True) * normals
    expected = np.rad2deg(np.median(np.linalg.norm(across, axis=1)))
    assert fit.quality.residual_deg == pytest.approx(expected, rel=0.03)


def test_cone_is_the_half_angle_that_holds_most_normals(rng, caplog) -> None:
    normals = hemisphere(rng, 4000, 12)
    with caplog.at_level(logging.WARNING):
        fit = fit_response(normals, rgb_from_normals(normals, RESPONSE))
    assert 11 < fit.quality.cone_deg < 12
    assert "within 12 degrees" in caplog.text


def test_a_channel_that_is_dark_everywhere_is_fitted_where_shadow_is_kept(rng) -> None:
    """Colours from which a background was taken may be negative: then no pair is the brightest."""
    normals = hemisphere(rng, 200, 40)
    truth = np.array([[0.3, 0.1, 0.2], [0.0, 0.4, 0.1], [0.2, 0.2, 0.5]])
    for colours in (normals @ truth - [0.0, 0.0, 5.0], normals @ truth * [1, 1, 0]):
        design = Design.from_pairs(normals, colours, with_ambient=True)
        unknowns, inliers = fit_by_trimming(design, np.ones(200, bool), 0.0)
        assert inliers.all()
        np.testing.assert_allclose(design.rows @ unknowns, colours, atol=1e-9)


def test_same_seed_same_fit(rng) -> None:
    normals = hemisphere(rng, 500)
    rgb = shaded_rgb_from_normals(normals, RESPONSE) + rng.normal(0, 0.01, (500, 3))
    fits = [
        fit_response(normals, rgb, ResponseFitOptions(method=FitMethod.MSAC), rng=np.random.default_rng(5))
        for _ in "ab"
    ]
    assert np.array_equal(fits[0].response.matrix, fits[1].response.matrix)


def test_refusals(rng) -> None:
    normals = hemisphere(rng, 200, 40)
    rgb = rgb_from_normals(normals, RESPONSE)
    one, same = np.tile(normals[:1], (50, 1)), np.tile(rgb[:1], (50, 1))
    one_colour = RESPONSE.matrix[[0, 0, 0]]
    by_draws = ResponseFitOptions(method=FitMethod.MSAC)
    for error, line, given, named in (
        (BadCalibration, "no light in the red, green, blue", (normals, np.zeros((200, 3))), {}),
        (BadCalibration, "every pixel is clipped", (normals, rgb), {"clipped": np.ones(200, bool)}),
        (BadCalibration, "no pixel", (normals[:0], rgb[:0]), {}),
        (BadCalibration, "only 2 lit", (normals[:2], rgb[:2]), {}),
        (BadCalibration, "do not determine", (one, same), {}),
        (BadCalibration, "singular", (normals, normals @ one_colour.T), {}),
        (BadCalibration, "none of 2000 samples", (one, same, by_draws), {"rng": rng}),
        (BadInput, "random generator", (normals, rgb, by_draws), {}),
        (BadInput, "colours: expected shape 200 × 3", (normals, rgb[:100]), {}),
    ):
        with pytest.raises(error, match=line):
            fit_response(*given, **named)

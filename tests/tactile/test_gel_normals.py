"""The untouched gel is flat exactly; the light's drift goes and a touch stays; the loop is the formula."""

from dataclasses import replace
from itertools import combinations_with_replacement

import numpy as np

from vntoolkit.photometry.gel import TERMS, GelResponse, completed_coefficients
from vntoolkit.photometry.response import LightResponse
from vntoolkit.tactile.inversion import GelInverter, change_without_drift, drift_of_change
from vntoolkit.tactile.response import correction_terms, normals_from_change

MATRIX = np.array([[0.2, 0.1, -0.42], [-0.1, 0.2, -0.45], [-0.1, -0.2, -0.5]])
RESPONSE = LightResponse(matrix=MATRIX, ambient=MATRIX[:, 2])
SHAPE = (60, 80)
EVERYWHERE = np.ones(SHAPE, bool)
V, U = np.indices(SHAPE)


def gel(rng: np.random.Generator) -> GelResponse:
    return GelResponse(
        coefficients=rng.normal(0, 0.1, (TERMS, 2)),
        centre_px=np.array([39.5, 29.5]),
        scale_px=40.0,
        reach=0.6,
    )


def quadratic(rng: np.random.Generator) -> np.ndarray:
    x, y = U / 79 * 2 - 1, V / 59 * 2 - 1
    terms = np.stack([np.ones(SHAPE), x, y, x * x, x * y, y * y], axis=-1)
    return terms @ rng.normal(0, 0.02, (6, 3))


def test_an_untouched_gel_is_flat_to_the_last_bit(rng) -> None:
    nothing = np.zeros((*SHAPE, 3), np.float32)
    drift = drift_of_change(nothing, EVERYWHERE)
    assert not drift.any()
    normal_map = GelInverter(RESPONSE, gel(rng)).normals(nothing, drift, EVERYWHERE)
    assert (normal_map.normals_in_camera == [0, 0, -1]).all()


def test_a_touch_survives_the_removal_of_drift(rng) -> None:
    touched = np.hypot(U - 30, V - 25) < 14
    change = quadratic(rng) + rng.normal(0, 0.002, (*SHAPE, 3))
    change[touched] += rng.uniform(-0.3, 0.3, (touched.sum(), 3))
    rest = change_without_drift(change.astype(np.float32), EVERYWHERE)
    assert np.abs(rest[~touched]).max() < 0.015  # noise of 0.002
    assert np.abs(rest[touched]).mean() > 0.1


def test_the_loop_is_the_formula(rng) -> None:
    model, change = gel(rng), rng.normal(0, 0.2, (*SHAPE, 3)).astype(np.float32)
    drift = rng.normal(0, 0.05, (6, 3))
    x, y = U / 79 * 2 - 1, V / 59 * 2 - 1
    rest = change - np.stack([np.ones(SHAPE), x, y, x * x, x * y, y * y], axis=-1) @ drift
    found = GelInverter(RESPONSE, model).normals(change, drift, EVERYWHERE).normals_in_camera
    positions = np.stack([U, V], axis=-1).reshape(-1, 2)
    wanted = normals_from_change(rest.reshape(-1, 3), positions, RESPONSE, model)
    np.testing.assert_allclose(found.reshape(-1, 3), wanted, atol=2e-5)
    np.testing.assert_allclose(np.linalg.norm(wanted, axis=1), 1)
    assert (wanted[:, 2] < 0).all()


def test_the_expected_error_is_that_of_the_tilt(rng) -> None:
    model = replace(gel(rng), errors_deg=np.array([[0.0, 1.0], [20.0, 3.0], [40.0, 9.0]]))
    change = rng.normal(0, 0.2, (*SHAPE, 3)).astype(np.float32)
    inverter = GelInverter(RESPONSE, model)
    found = inverter.with_expected_error(inverter.normals(change, np.zeros((6, 3)), EVERYWHERE))
    tilts = np.degrees(np.arccos(-found.normals_in_camera[..., 2].clip(-1, 0)))
    np.testing.assert_allclose(found.error_deg, np.interp(tilts, [0, 20, 40], [1, 3, 9]), atol=0.15)
    assert found.noise_deg.min() > 5  # white noise has no other part
    assert GelInverter(RESPONSE, gel(rng)).with_expected_error(found) is found


def test_a_correction_of_the_third_degree_is_one_of_the_fourth(rng) -> None:
    earlier, scaled, place = rng.normal(0, 0.1, (46, 2)), rng.normal(0, 0.2, 3), rng.uniform(-1, 1, 2)
    products = [
        np.prod(scaled[list(k)]) for d in (1, 2, 3) for k in combinations_with_replacement((0, 1, 2), d)
    ]
    degrees = [1] * 3 + [2] * 6 + [3] * 10
    powers = [(total - j, j) for total in range(3) for j in range(total + 1)]
    terms = [
        product * place[0] ** i * place[1] ** j
        for product, degree in zip(products, degrees, strict=True)
        for i, j in powers
        if degree + i + j <= 3
    ]
    found = correction_terms(scaled[None], place[None], 9.0) @ completed_coefficients(earlier)
    np.testing.assert_allclose(found[0], np.array(terms) @ earlier, rtol=1e-12)

"""A drawn gel with a ball pressed in gives its response back, and the untouched gel comes out flat."""

from dataclasses import replace

import numpy as np
import pytest

from tests.drawn_gel import press_on_ball
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.options.calibration import LabelOffset, PressOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.tactile.circles import Press, find_contact_circle
from vntoolkit.tactile.fit import fit_gel_to_presses, fit_label_offset
from vntoolkit.tactile.presses import PressSamples, pairs_from_samples, samples_from_press
from vntoolkit.tactile.response import normals_from_change

MATRIX = np.array([[0.4, 0.1, -0.42], [-0.2, 0.35, -0.45], [-0.15, -0.35, -0.5]])
LEVEL = -MATRIX[:, 2]
SHAPE = (120, 90)
SIZE = (90, 120)
OPTIONS = PressOptions(ball_radius_mm=2.4, pixel_mm=0.1)


def true_normals(press: Press, radius_mm: float = 2.4) -> np.ndarray:
    normals, distance = press_on_ball(SHAPE, press.u_px, press.v_px, 10 * radius_mm)
    return np.where((distance < press.radius_px)[..., None], normals, [0, 0, -1])


def pressed_gel(
    press: Press, rng: np.random.Generator, nearness: float = 0.0, radius_mm: float = 2.4
) -> np.ndarray:
    """The change of colour of a press: M (n − n0), brighter towards one corner, bent, with noise and dots."""
    change = (true_normals(press, radius_mm) - [0, 0, -1]) @ MATRIX.T
    v, u = np.indices(SHAPE)
    change = change * (1 + nearness * (u - 45 + v - 60) / 60)[..., None]
    change = change + 0.8 * nearness * change**2
    change += rng.normal(0, 0.004, change.shape)
    change[::15, ::15] = -0.4  # printed dots
    return change.astype(np.float32)


def samples_of(
    change: np.ndarray, press: Press, rng: np.random.Generator, radius_mm: float = 2.4
) -> PressSamples:
    untouched = np.broadcast_to(LEVEL, (*SHAPE, 3)).astype(np.float32)
    return samples_from_press(
        change, untouched, np.ones(SHAPE, bool), press, replace(OPTIONS, ball_radius_mm=radius_mm), rng
    )


def random_press(rng: np.random.Generator) -> Press:
    return Press(u_px=rng.uniform(20, 70), v_px=rng.uniform(20, 100), radius_px=rng.uniform(12, 19))


def test_presses_give_the_response(rng) -> None:
    presses = [random_press(rng) for _ in range(12)]
    samples = [samples_of(pressed_gel(press, rng), press, rng) for press in presses]
    fit = fit_gel_to_presses(samples, LEVEL, SIZE, OPTIONS)
    np.testing.assert_allclose(fit.response.matrix, MATRIX, atol=0.01)
    assert fit.quality.residual_deg < 0.8  # the noise of 0.004
    assert fit.held_back_deg < 0.9
    assert fit.quality.method == "presses"
    flat = normals_from_change(np.zeros((1, 3)), np.array([[80.0, 7.0]]), fit.response, fit.gel)
    np.testing.assert_array_equal(flat, [[0, 0, -1]])


def test_balls_of_two_radii_give_one_response(rng) -> None:
    """Taken for one ball, they do not fit: the larger one's slopes are told too steep."""
    balls = [2.4, 3.6] * 6
    presses = [random_press(rng) for _ in balls]
    pictures = [
        pressed_gel(*pair, 0.0, radius) for *pair, radius in zip(presses, [rng] * 12, balls, strict=True)
    ]
    samples = [samples_of(*each[:2], rng, each[2]) for each in zip(pictures, presses, balls, strict=True)]
    fit = fit_gel_to_presses(samples, LEVEL, SIZE, OPTIONS)
    np.testing.assert_allclose(fit.response.matrix, MATRIX, atol=0.015)
    as_one = [replace(part, ball_radius_mm=2.4) for part in samples]
    assert fit_gel_to_presses(as_one, LEVEL, SIZE, OPTIONS).held_back_deg > 2 * fit.held_back_deg
    beside = [replace(part, press=replace(part.press, u_px=part.press.u_px - 3)) for part in samples]
    np.testing.assert_allclose(fit_label_offset(beside, LEVEL, OPTIONS), [3, 0], atol=0.5)


def test_near_lamps_and_a_bent_answer_are_fitted_on_presses_not_seen(rng) -> None:
    presses = [random_press(rng) for _ in range(24)]
    samples = [samples_of(pressed_gel(press, rng, 0.3), press, rng) for press in presses]
    fit = fit_gel_to_presses(samples, LEVEL, SIZE, OPTIONS)
    press = Press(u_px=30, v_px=40, radius_px=16)
    change = pressed_gel(press, rng, 0.3)
    v, u = np.nonzero(np.hypot(np.indices(SHAPE)[1] - 30, np.indices(SHAPE)[0] - 40) < 14)
    found = normals_from_change(change[v, u], np.column_stack([u, v]), fit.response, fit.gel)
    error = np.median(angles_deg(found, true_normals(press)[v, u]))
    one = replace(fit.gel, coefficients=np.zeros_like(fit.gel.coefficients))
    alone = np.median(
        angles_deg(
            normals_from_change(change[v, u], np.column_stack([u, v]), fit.response, one),
            true_normals(press)[v, u],
        )
    )
    assert error < 1.5
    assert alone > 2 * error


def test_a_single_press_leaves_one_matrix(rng) -> None:
    press = Press(u_px=45, v_px=60, radius_px=18)
    samples = [samples_of(pressed_gel(press, rng), press, rng)]
    fit = fit_gel_to_presses(samples, LEVEL, SIZE, OPTIONS)
    assert not fit.gel.coefficients.any()
    assert np.isnan(fit.held_back_deg)
    np.testing.assert_allclose(fit.response.matrix, MATRIX, atol=0.02)


def test_labels_that_all_lie_beside_their_dents_are_found_out(rng) -> None:
    samples = []
    for _ in range(12):
        press = random_press(rng)
        wrong = Press(u_px=press.u_px + 3, v_px=press.v_px - 2, radius_px=press.radius_px)
        samples.append(samples_of(pressed_gel(press, rng), wrong, rng))
    np.testing.assert_allclose(fit_label_offset(samples, LEVEL, OPTIONS), [-3, 2], atol=0.3)
    believing = replace(OPTIONS, label_offset=LabelOffset.NONE)
    right, wrong = (fit_gel_to_presses(samples, LEVEL, SIZE, options) for options in (OPTIONS, believing))
    np.testing.assert_allclose(right.response.matrix, MATRIX, atol=0.01)
    assert np.abs(wrong.response.matrix - MATRIX).max() > 0.05


def test_labels_that_scatter_move_to_their_dents(rng) -> None:
    samples, slips = [], rng.normal(0, 2, (12, 2))
    for slip in slips:
        press = random_press(rng)
        label = Press(u_px=press.u_px + slip[0], v_px=press.v_px + slip[1], radius_px=press.radius_px)
        samples.append(samples_of(pressed_gel(press, rng), label, rng))
    moved = fit_gel_to_presses(samples, LEVEL, SIZE, OPTIONS)
    believed = fit_gel_to_presses(samples, LEVEL, SIZE, replace(OPTIONS, label_offset=LabelOffset.NONE))
    scatter = np.median(np.linalg.norm(slips - np.median(slips, axis=0), axis=1))
    assert moved.label_scatter_px == pytest.approx(scatter, abs=0.5)
    assert believed.label_scatter_px == 0
    assert 2 * moved.quality.residual_deg < believed.quality.residual_deg


def test_the_circle_of_a_dent_is_found_before_any_response_is_known(rng) -> None:
    for _ in range(5):
        press = random_press(rng)
        found = find_contact_circle(pressed_gel(press, rng, 0.3))
        assert found is not None
        assert np.hypot(found.u_px - press.u_px, found.v_px - press.v_px) < 1
        assert found.radius_px == pytest.approx(press.radius_px, rel=0.15)
    assert find_contact_circle(rng.normal(0, 0.004, (*SHAPE, 3)).astype(np.float32)) is None
    two = pressed_gel(Press(u_px=25, v_px=30, radius_px=12), rng) + pressed_gel(
        Press(u_px=60, v_px=90, radius_px=14), rng
    )
    between = find_contact_circle(two)  # expects one press: two are odd about the middle between them
    assert between is None or np.hypot(between.u_px - 42.5, between.v_px - 60) < 1


def test_the_dent_bulges_towards_the_camera(rng) -> None:
    press = Press(u_px=45, v_px=60, radius_px=15)
    pairs = pairs_from_samples([samples_of(pressed_gel(press, rng), press, rng)], np.zeros(2), OPTIONS)
    normals, places = pairs.normals[pairs.touched], pairs.positions_px[pairs.touched]
    np.testing.assert_allclose(normals[:, :2], 0.1 / 2.4 * (places - [45, 60]))  # turned away from the centre
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    assert (normals[:, 2] < 0).all()
    assert np.linalg.norm(places - [45, 60], axis=1).max() < 0.8 * 15


def test_refusals(rng) -> None:
    with pytest.raises(BadCalibration, match="not narrower than the ball"):
        samples_of(np.zeros((*SHAPE, 3), np.float32), Press(u_px=45, v_px=60, radius_px=30), rng)
    with pytest.raises(BadCalibration, match="no press"):
        fit_gel_to_presses([], LEVEL, SIZE, OPTIONS)
    press = Press(u_px=45, v_px=60, radius_px=15)
    with pytest.raises(BadInput, match="change of colour"):
        samples_of(pressed_gel(press, rng)[1:], press, rng)

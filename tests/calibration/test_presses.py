"""A drawn gel with a ball pressed in gives its response back, and the untouched gel comes out flat."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.calibration.presses import (
    LabelOffset,
    Press,
    PressOptions,
    fit_label_offset,
    fit_response_to_presses,
    normals_of_press,
    pairs_from_samples,
    samples_from_press,
)
from vntoolkit.calibration.varying import VariationOptions, fit_varying_response
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.lambertian import rgb_from_normals, scaled_normals_from_rgb
from vntoolkit.photometry.response import LightResponse, ResponseVariation, powers_to_degree

MATRIX = np.array([[0.4, 0.1, -0.42], [-0.2, 0.35, -0.45], [-0.15, -0.35, -0.5]])
LEVEL = -MATRIX[:, 2]
SHAPE = (120, 90)
SIZE = (90, 120)
OPTIONS = PressOptions(
    ball_radius_mm=2.4, pixel_mm=0.1, contact_share=0.9, variation=VariationOptions(degree=0)
)


def pressed_gel(press: Press, rng: np.random.Generator):
    """A press on an unevenly lit gel with dots, and the untouched gel."""
    unevenness = 0.05 * np.sin(np.indices(SHAPE)[1] / 20.0)[..., None]
    normals, inside = normals_of_press(
        press, PressOptions(ball_radius_mm=2.4, pixel_mm=0.1, contact_share=1.0), SHAPE
    )
    normals = np.where(inside[..., None], normals, [0, 0, -1])
    background = (LEVEL + unevenness + np.zeros((*SHAPE, 3))).astype(np.float32)
    rgb = normals @ MATRIX.T + unevenness + rng.normal(0, 0.004, (*SHAPE, 3))
    rgb[::15, ::15] = 0.05  # printed dots
    return LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(SHAPE, bool)), background


def test_presses_give_the_response(rng) -> None:
    samples = []
    for _ in range(12):
        press = Press(u_px=rng.uniform(30, 60), v_px=rng.uniform(30, 90), radius_px=rng.uniform(12, 19))
        frame, background = pressed_gel(press, rng)
        samples.append(samples_from_press(frame, press, background, OPTIONS, rng))
    fit = fit_response_to_presses(samples, LEVEL, SIZE, OPTIONS)
    np.testing.assert_allclose(fit.response.matrix, MATRIX, atol=0.005)
    flat = fit.response.inverse @ -fit.response.ambient
    np.testing.assert_allclose(flat, [0, 0, -1], atol=1e-9)
    assert fit.quality.residual_deg < 0.7
    assert fit.quality.method == "presses"


def test_labels_that_all_lie_beside_their_dents_are_found_out(rng) -> None:
    samples = []
    for _ in range(12):
        press = Press(u_px=rng.uniform(30, 60), v_px=rng.uniform(30, 90), radius_px=rng.uniform(12, 19))
        frame, background = pressed_gel(press, rng)
        wrong = Press(u_px=press.u_px + 3, v_px=press.v_px - 2, radius_px=press.radius_px)
        samples.append(samples_from_press(frame, wrong, background, OPTIONS, rng))
    np.testing.assert_allclose(fit_label_offset(samples, SIZE, OPTIONS), [-3, 2], atol=0.5)
    believing = replace(OPTIONS, label_offset=LabelOffset.NONE)
    right = fit_response_to_presses(samples, LEVEL, SIZE, OPTIONS)
    assert right.quality.residual_deg < 1.0
    assert fit_response_to_presses(samples, LEVEL, SIZE, believing).quality.residual_deg > 4


def test_the_dent_bulges_towards_the_camera() -> None:
    normals, inside = normals_of_press(Press(u_px=45, v_px=60, radius_px=15), OPTIONS, SHAPE)
    assert inside.sum() == pytest.approx(np.pi * (0.9 * 15) ** 2, rel=0.02)
    assert normals[60, 55, 0] == pytest.approx(1.0 / 2.4)  # 10 px = 1 mm right of the centre: turned right
    assert normals[70, 45, 1] == pytest.approx(1.0 / 2.4)
    np.testing.assert_allclose(np.linalg.norm(normals[inside], axis=1), 1)
    assert (normals[inside][:, 2] < 0).all()


def near_lights() -> LightResponse:
    rng = np.random.default_rng(5)
    powers = powers_to_degree(2)
    matrices = rng.normal(0, 0.08, (len(powers), 3, 3))
    variation = ResponseVariation(
        powers=powers,
        matrices=matrices,
        ambients=matrices[:, :, 2],  # so that the flat gel's colour, its background taken off, is 0
        centre_px=np.array([44.5, 59.5]),
        scale_px=60.0,
    )
    return LightResponse(matrix=MATRIX, ambient=MATRIX[:, 2], variation=variation)


def test_presses_all_over_the_gel_give_the_response_that_varies(rng) -> None:
    truth = near_lights()
    whole = PressOptions(ball_radius_mm=2.4, pixel_mm=0.1, contact_share=1.0)
    options = PressOptions(
        ball_radius_mm=2.4, pixel_mm=0.1, samples=100, variation=VariationOptions(degree=2)
    )
    samples = []
    for u in (15, 45, 75):
        for v in (15, 45, 75, 105):
            press = Press(u_px=u, v_px=v, radius_px=15)
            normals, inside = normals_of_press(press, whole, SHAPE)
            normals = np.where(inside[..., None], normals, [0, 0, -1])
            rgb = rgb_from_normals(normals, truth) + rng.normal(0, 0.004, (*SHAPE, 3))
            frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(SHAPE, bool))
            nothing = np.zeros((*SHAPE, 3), np.float32)
            samples.append(samples_from_press(frame, press, nothing, options, rng))
    fit = fit_response_to_presses(samples, LEVEL, SIZE, options)
    pairs = pairs_from_samples(samples, np.zeros(2), options)
    normals, positions = pairs.normals[pairs.touched], pairs.positions_px[pairs.touched]
    clean = rgb_from_normals(normals, truth, positions)

    def error_deg(response: LightResponse) -> float:
        found = scaled_normals_from_rgb(clean, response, positions)
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        return float(np.rad2deg(np.median(np.linalg.norm(found - normals, axis=1))))

    assert error_deg(fit.response) < 0.15  # noise of 0.004 over 100 samples a press
    assert error_deg(fit.response.central) > 2  # what one response leaves
    assert 0.2 < fit.quality.residual_deg < 1.2  # the noise itself


def test_a_pair_without_light_does_not_stop_the_fit(rng) -> None:
    normals = np.column_stack([rng.normal(0, 0.3, (400, 2)), -np.ones(400)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    rgb = normals @ MATRIX.T
    rgb[7] = 0.0  # no direction, whatever M
    one, start = VariationOptions(degree=0), LightResponse(matrix=1.2 * MATRIX + 0.05)
    anywhere = rng.uniform(0, 80, (400, 2))
    fitted = fit_varying_response(normals, rgb, anywhere, SIZE, start, one, fit_ambient=False)
    np.testing.assert_allclose(fitted.matrix, MATRIX, atol=1e-6)
    rgb[7] = np.nan
    with pytest.raises(BadInput, match="colours: 3 of 1200 values are NaN"):
        fit_varying_response(normals, rgb, anywhere, SIZE, start, one)


def test_one_place_does_not_tell_how_the_light_varies(rng) -> None:
    normals = np.column_stack([rng.normal(0, 0.3, (400, 2)), -np.ones(400)])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    start = near_lights().central
    rgb = rgb_from_normals(normals, start)
    here = np.array([40.0, 40.0]) + rng.uniform(-1, 1, (400, 2))
    with pytest.raises(BadCalibration, match="too few places"):
        fit_varying_response(normals, rgb, here, SIZE, start)


def test_refusals(rng) -> None:
    with pytest.raises(BadCalibration, match="not narrower than the ball"):
        normals_of_press(Press(u_px=45, v_px=60, radius_px=30), OPTIONS, SHAPE)
    with pytest.raises(BadCalibration, match="no press"):
        fit_response_to_presses([], LEVEL, SIZE, OPTIONS)
    frame, background = pressed_gel(Press(u_px=45, v_px=60, radius_px=15), rng)
    with pytest.raises(BadInput, match="background"):
        samples_from_press(frame, Press(u_px=45, v_px=60, radius_px=15), background[1:], OPTIONS, rng)

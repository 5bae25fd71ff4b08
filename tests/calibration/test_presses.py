"""A drawn gel with a ball pressed in gives its response back, and the untouched gel comes out flat."""

import numpy as np
import pytest

from vntoolkit.calibration.presses import (
    Press,
    PressOptions,
    fit_response_to_presses,
    normals_of_press,
    samples_from_press,
)
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.photometry.frame import LinearFrame

MATRIX = np.array([[0.4, 0.1, -0.42], [-0.2, 0.35, -0.45], [-0.15, -0.35, -0.5]])
LEVEL = -MATRIX[:, 2]
OPTIONS = PressOptions(ball_radius_mm=2.4, pixel_mm=0.1, contact_share=0.9)
SHAPE = (120, 90)


def pressed_gel(press: Press, rng: np.random.Generator):
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
    fit = fit_response_to_presses(samples, LEVEL, OPTIONS)
    np.testing.assert_allclose(fit.response.matrix, MATRIX, atol=0.005)
    flat = fit.response.inverse @ -fit.response.ambient
    np.testing.assert_allclose(flat, [0, 0, -1], atol=1e-9)
    assert fit.quality.residual_deg < 0.7
    assert fit.quality.method == "presses"


def test_the_dent_bulges_towards_the_camera() -> None:
    normals, inside = normals_of_press(Press(u_px=45, v_px=60, radius_px=15), OPTIONS, SHAPE)
    assert inside.sum() == pytest.approx(np.pi * (0.9 * 15) ** 2, rel=0.02)
    assert normals[60, 55, 0] == pytest.approx(1.0 / 2.4)  # 10 px = 1 mm right of the centre: turned right
    assert normals[70, 45, 1] == pytest.approx(1.0 / 2.4)
    np.testing.assert_allclose(np.linalg.norm(normals[inside], axis=1), 1)
    assert (normals[inside][:, 2] < 0).all()


def test_refusals(rng) -> None:
    with pytest.raises(BadCalibration, match="not narrower than the ball"):
        normals_of_press(Press(u_px=45, v_px=60, radius_px=30), OPTIONS, SHAPE)
    with pytest.raises(BadCalibration, match="no press"):
        fit_response_to_presses([], LEVEL, OPTIONS)
    with pytest.raises(BadInput, match="positive ball radius"):
        PressOptions(ball_radius_mm=-1, pixel_mm=0.1)
    frame, background = pressed_gel(Press(u_px=45, v_px=60, radius_px=15), rng)
    with pytest.raises(BadInput, match="background"):
        samples_from_press(frame, Press(u_px=45, v_px=60, radius_px=15), background[1:], OPTIONS, rng)

"""M = Σ c_k l_kᵀ put together from known lights, and taken apart again by single-light photographs."""

import numpy as np
import pytest

from vntoolkit.calibration.lights import (
    LightColours,
    fit_light_colours,
    response_from_lights,
    with_light_colours,
)
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

DIRECTIONS = np.array([[0.6, 0.0, -0.8], [-0.36, 0.48, -0.8], [-0.36, -0.48, -0.8]])
COLOURS = np.array([[0.5, 0.05, 0.02], [0.06, 0.6, 0.1], [0.0, 0.1, 0.4]])


def photographs(rng, noise: float = 0.003) -> list[LinearFrame]:
    frames = []
    for colour in COLOURS:
        shading = np.clip(rng.normal(0.5, 0.4, (60, 80, 1)), 0, 1)
        rgb = shading * colour + rng.normal(0, noise, (60, 80, 3))
        rgb[:5] += 0.3  # gloss, of the same brightness in all channels
        frames.append(LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros((60, 80), bool)))
    return frames


def test_single_light_photographs_take_m_apart(rng) -> None:
    colours = fit_light_colours(photographs(rng))
    np.testing.assert_allclose(colours, COLOURS / np.linalg.norm(COLOURS, axis=1, keepdims=True), atol=0.004)
    response = with_light_colours(LightResponse(matrix=COLOURS.T @ DIRECTIONS), colours)
    np.testing.assert_allclose(response.light_colours, COLOURS, atol=0.006)
    np.testing.assert_allclose(response.light_directions, DIRECTIONS, atol=0.02)
    np.testing.assert_allclose(
        response.light_colours.T @ response.light_directions, response.matrix, atol=1e-12
    )


def test_known_lights_make_m() -> None:
    response, quality = response_from_lights(DIRECTIONS * 3.0, COLOURS, LightColours.GIVEN)
    np.testing.assert_allclose(response.matrix, COLOURS.T @ DIRECTIONS)
    np.testing.assert_allclose(response.light_directions, DIRECTIONS, atol=1e-12)
    assert quality.samples == 0
    assert quality.condition_number == pytest.approx(np.linalg.cond(response.matrix))
    stacked, _ = response_from_lights(DIRECTIONS, None, LightColours.CHANNELS)
    np.testing.assert_allclose(stacked.matrix, DIRECTIONS)
    weighed, _ = response_from_lights(DIRECTIONS, COLOURS, LightColours.CHANNELS)
    np.testing.assert_allclose(weighed.matrix, np.diag(COLOURS)[:, None] * DIRECTIONS)


def test_refusals(rng) -> None:
    frames = photographs(rng)
    with pytest.raises(BadInput, match="albedo: expected a positive number, got -1"):
        response_from_lights(DIRECTIONS, COLOURS, LightColours.GIVEN, albedo=-1.0)
    with pytest.raises(BadCalibration, match="three photographs"):
        fit_light_colours(frames[:2])
    with pytest.raises(BadCalibration, match="same colour"):
        fit_light_colours([frames[0], frames[0], frames[2]])
    black = LinearFrame(rgb=np.zeros((60, 80, 3)), clipped=np.zeros((60, 80), bool))
    with pytest.raises(BadCalibration, match="photograph of the green light is black"):
        fit_light_colours([frames[0], black, frames[2]])
    with pytest.raises(BadInput, match="one size"):
        fit_light_colours(frames, np.ones((60, 81), bool))
    flat = DIRECTIONS.copy()
    flat[2] = flat[0] + flat[1]
    with pytest.raises(BadCalibration, match="singular"):
        response_from_lights(flat, None, LightColours.CHANNELS)
    with pytest.raises(BadCalibration, match="no intensities"):
        response_from_lights(DIRECTIONS, None, LightColours.GIVEN)
    with pytest.raises(BadCalibration, match="length 0"):
        response_from_lights(np.zeros((3, 3)), None, LightColours.CHANNELS)
    with pytest.raises(BadCalibration, match="negative"):
        response_from_lights(DIRECTIONS, -COLOURS, LightColours.GIVEN)

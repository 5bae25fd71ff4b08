"""M = Σ c_k l_kᵀ put together from known lights, and taken apart again by single-light photographs."""

import numpy as np
import pytest

from vntoolkit.calibration.lights import (
    colour_of_frame,
    find_switched_lamps,
    fit_light_colours,
    response_from_lights,
    with_light_colours,
)
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.options.calibration import LightColours
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


def switched(rng, script: str) -> list:
    """Frames of a ball: r, g, b under one lamp, w under all, y red and half the green, - none."""
    v, u = (np.indices((40, 40)) - 19.5) / 20
    normals = np.stack([u, v, -np.sqrt(np.maximum(1 - u * u - v * v, 0))], axis=-1)
    light = np.maximum(normals @ DIRECTIONS.T, 0) * (u * u + v * v < 1)[..., None]
    on = {"r": (1, 0, 0), "g": (0, 1, 0), "b": (0, 0, 1), "w": (1, 1, 1), "y": (1, 0.5, 0), "-": (0, 0, 0)}
    frames = []
    for number, letter in enumerate(script):
        rgb = light * on[letter] @ COLOURS + 0.004 + rng.normal(0, 0.003, light.shape)
        clipped = np.zeros((40, 40), bool)
        frames.append(LinearFrame(rgb=rgb.astype(np.float32), clipped=clipped, number=number))
    return [colour_of_frame(frame) for frame in frames]


@pytest.mark.parametrize(
    ("script", "alone", "dark"),
    [
        ("gbr", ([2], [0], [1]), []),
        ("wwww--bbbbyrrrrggg-", ([11, 12, 13, 14], [15, 16, 17], [6, 7, 8, 9]), [4, 5, 18]),
    ],
)
def test_frames_under_one_lamp_are_found_whatever_their_order(rng, script, alone, dark) -> None:
    found = find_switched_lamps(switched(rng, script))
    assert found is not None
    assert found.alone == alone
    assert found.dark == dark


def test_ordinary_footage_has_no_lamp_alone_and_a_missing_lamp_is_told(rng) -> None:
    assert find_switched_lamps(switched(rng, "wwwwww")) is None
    with pytest.raises(BadCalibration, match="in 6 of 10 frames one lamp is on alone, but not each"):
        find_switched_lamps(switched(rng, "wwwwrrrggg"))


def test_colours_that_are_not_of_the_lamps_are_refused() -> None:
    colours = COLOURS / np.linalg.norm(COLOURS, axis=1, keepdims=True)
    white = COLOURS.T @ DIRECTIONS @ [0, 0, -1]
    colours[2] = white / np.linalg.norm(white)  # all lamps on in the blue lamp's photograph
    with pytest.raises(BadCalibration, match="is each photograph lit by one lamp alone"):
        with_light_colours(LightResponse(matrix=COLOURS.T @ DIRECTIONS), colours)


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
    black = LinearFrame(rgb=np.zeros((60, 80, 3)), clipped=np.zeros((60, 80), bool))
    first, _, third = frames
    for error, line, given in (
        (BadCalibration, "three photographs", (frames[:2],)),
        (BadCalibration, "same colour", ([first, first, third],)),
        (BadCalibration, "photograph of the green light is black", ([first, black, third],)),
        (BadInput, "one size", (frames, np.ones((60, 81), bool))),
    ):
        with pytest.raises(error, match=line):
            fit_light_colours(*given)
    flat = np.array([DIRECTIONS[0], DIRECTIONS[1], DIRECTIONS[0] + DIRECTIONS[1]])
    for error, line, given in (
        (
            BadInput,
            "albedo: expected a positive number, got -1",
            (DIRECTIONS, COLOURS, LightColours.GIVEN, -1.0),
        ),
        (BadCalibration, "singular", (flat, None, LightColours.CHANNELS)),
        (BadCalibration, "no intensities", (DIRECTIONS, None, LightColours.GIVEN)),
        (BadCalibration, "length 0", (np.zeros((3, 3)), None, LightColours.CHANNELS)),
        (BadCalibration, "negative", (DIRECTIONS, -COLOURS, LightColours.GIVEN)),
    ):
        with pytest.raises(error, match=line):
            response_from_lights(*given)

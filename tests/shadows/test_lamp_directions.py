"""Directions of lamps from the colours of what they do not reach."""

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3, VisibilityLabels
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.shadows.lamp_directions import directions_from_shadows, directions_from_unlit, unlit_by_lamp

SHAPE = (60, 60)
LAMPS = np.array([[-0.3, 0.15, -1.0], [0.3, 0.2, -1.0], [0.0, -0.35, -1.0]])
LAMPS = LAMPS / np.linalg.norm(LAMPS, axis=1, keepdims=True)
COLOURS = np.array([[0.9, 0.15, 0.05], [0.2, 0.8, 0.15], [0.1, 0.3, 0.9]])  # row k: of lamp k


def angle_deg(a: FloatArray, b: FloatArray) -> float:
    return float(np.degrees(np.arccos(np.clip(a @ b, -1.0, 1.0))))


def seen(bend: float, noise: float, missing: slice, *, seed: int = 3) -> tuple[LinearFrame, VisibilityLabels]:
    """A bent surface of varying albedo; lamp 2 is missing in some rows."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[-1 : 1 : SHAPE[0] * 1j, -1 : 1 : SHAPE[1] * 1j]
    normals = np.stack([bend * x, bend * y, -np.ones(SHAPE)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    labels = np.full(SHAPE, 7, np.uint8)
    labels[missing] = 3
    arrives = (labels[..., None] >> np.arange(3)) & 1
    albedo = rng.uniform(0.5, 1.0, SHAPE)[..., None]
    rgb = albedo * (np.maximum(normals @ LAMPS.T, 0.0) * arrives) @ COLOURS
    rgb = rgb + noise * rng.standard_normal(rgb.shape)
    return LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(SHAPE, np.bool_)), labels


def response(colours: Matrix3 | None = None) -> LightResponse:
    return LightResponse(matrix=COLOURS.T @ LAMPS, light_colours=colours)


def test_lamp_whose_colour_nobody_knows_is_found_from_its_shadow() -> None:
    frame, labels = seen(0.6, 0.003, np.s_[20:45])
    found = directions_from_shadows(frame, labels, response(), np.ones(SHAPE, np.bool_))
    off = angle_deg(found.at(2, np.array([[30.0, 30.0]]))[0], LAMPS[2])
    row = angle_deg(response().light_directions[2], LAMPS[2])
    assert off < 0.5 < row  # M's row mixes the lamps
    assert off < np.degrees(found.deviations[2]) < 8.0
    assert np.all(np.isinf(found.deviations[:2]))  # nothing lies in their shadows


def test_flat_surface_in_shadow_leaves_the_direction_in_doubt() -> None:
    frame, labels = seen(0.02, 0.003, np.s_[20:45])
    found = directions_from_shadows(frame, labels, response(), np.ones(SHAPE, np.bool_))
    assert np.degrees(found.deviations[2]) > 20.0


def test_light_is_split_by_the_lamps_that_are_sure() -> None:
    frame, labels = seen(1.2, 0.0, np.s_[20:45])
    found = directions_from_shadows(frame, labels, response(), np.ones(SHAPE, np.bool_)).separated
    assert angle_deg(found.light_directions[2], LAMPS[2]) < 0.5
    rows = response().light_directions
    assert max(angle_deg(found.light_directions[k], rows[k]) for k in range(2)) < 1e-6  # as channels have it
    contributions = frame.rgb @ found.contributions_from_rgb.T
    assert np.abs(contributions[labels == 3, 2]).max() < 0.01  # what lamp 2 does not reach has none of it


def test_light_stays_as_channels_have_it_where_no_lamp_is_sure() -> None:
    frame, labels = seen(0.02, 0.003, np.s_[20:45])
    found = directions_from_shadows(frame, labels, response(), np.ones(SHAPE, np.bool_))
    assert found.separated.light_colours is None


def test_few_pixels_leave_the_lamp_unknown() -> None:
    frame, labels = seen(0.6, 0.003, np.s_[20:24, 20:30])
    found = directions_from_shadows(frame, labels, response(), np.ones(SHAPE, np.bool_))
    assert np.all(np.isinf(found.deviations))


def test_frames_together_tell_what_none_tells_alone() -> None:
    unlit, everywhere = np.empty((0, 3)), np.ones(SHAPE, np.bool_)
    for rows in (np.s_[10:17, 5:9], np.s_[30:36, 20:26], np.s_[45:50, 40:47]):
        frame, labels = seen(0.6, 0.003, rows)
        alone = unlit_by_lamp(frame, labels, response(), everywhere)
        assert np.isinf(directions_from_unlit(alone, response()).deviations[2])
        unlit = np.concatenate([unlit, alone[2]])
    found = directions_from_unlit([unlit[:0], unlit[:0], unlit], response())
    assert angle_deg(found.central[2], LAMPS[2]) < np.degrees(found.deviations[2]) < 8.0


def test_known_colours_give_the_directions_at_once() -> None:
    frame, labels = seen(0.6, 0.003, np.s_[0:0])
    found = directions_from_shadows(frame, labels, response(COLOURS), np.ones(SHAPE, np.bool_))
    for k in range(3):
        assert angle_deg(found.at(k, np.array([[3.0, 50.0]]))[0], LAMPS[k]) < 1e-6
    np.testing.assert_array_equal(found.deviations, 0.0)

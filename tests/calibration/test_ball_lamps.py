"""A ball under one lamp at a time gives the lamps' places and colours, and the light of the room."""

import numpy as np
import pytest

from vntoolkit.calibration import sphere
from vntoolkit.calibration.ball_lamps import fit_lamps_to_ball
from vntoolkit.calibration.ball_outline import outline_from_mask as circle_of
from vntoolkit.calibration.sphere import fit_response_to_switched_sphere, sphere_normals
from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.frame import LinearFrame

WIDTH, HEIGHT, RADIUS = 320, 240, 90.0
CENTRE = np.array([170.0, 115.0])
DIRECTIONS = np.array([[-0.45, 0.1, -0.89], [0.4, 0.3, -0.87], [0.0, -0.5, -0.87]])
DIRECTIONS = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
COLOURS = np.array([[0.6, 0.05, 0.02], [0.06, 0.55, 0.1], [0.02, 0.1, 0.5]])
ROOM = np.array([0.03, 0.02, 0.025])
CAMERA = Camera.orthographic(width=WIDTH, height=HEIGHT)


def photographs(closeness, room=ROOM, gloss=0.0):
    """The ball under each lamp, shadowed where the ball itself is in the way, by the lamps' places."""
    v, u = np.indices((HEIGHT, WIDTH))
    x, y = (u - CENTRE[0]) / RADIUS, (v - CENTRE[1]) / RADIUS
    inside = x**2 + y**2 < 1.0
    points = np.dstack([x, y, -np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))])
    rng, frames = np.random.default_rng(0), []
    for direction, colour, t in zip(DIRECTIONS, COLOURS, closeness, strict=True):
        if t:
            towards = direction / t - points
            away = np.linalg.norm(towards, axis=2)
            light = np.maximum((towards * points).sum(axis=2) / away, 0.0) / (t * away) ** 2
        else:
            light = np.maximum(points @ direction, 0.0)
        half = direction - np.array([0.0, 0.0, 1.0])
        light += (
            gloss * np.maximum(points @ half / np.linalg.norm(half), 0.0) ** 20 * (points @ direction > 0)
        )
        rgb = inside[..., None] * (light[..., None] * colour + room) + rng.normal(0, 0.002, (*u.shape, 3))
        frames.append(LinearFrame(rgb=rgb.astype(np.float32), clipped=np.zeros(u.shape, bool)))
    return frames, inside


def angle_deg(one, other):
    return np.degrees(np.arccos(np.clip((one * other).sum(axis=-1), -1, 1)))


@pytest.mark.parametrize("closeness", [(0.08, 0.1, 0.06), (0.0, 0.0, 0.0), (0.02, 0.0, 0.12)])
def test_a_ball_tells_where_the_lamps_are_their_colours_and_the_room(closeness) -> None:
    frames, mask = photographs(closeness)
    found = fit_lamps_to_ball(frames, sphere_normals(circle_of(mask), CAMERA, 0.02))
    assert found.is_room_known
    np.testing.assert_allclose(found.room, ROOM, atol=0.001)
    for lamp, direction, colour, t in zip(found.lamps, DIRECTIONS, COLOURS, closeness, strict=True):
        assert angle_deg(lamp.direction, direction) < 0.3
        assert lamp.closeness == pytest.approx(t, abs=0.006)
        np.testing.assert_allclose(lamp.colour, colour, atol=0.006)


def test_m_is_that_of_far_lamps_without_the_room_and_changes_over_the_picture() -> None:
    closeness = (0.08, 0.1, 0.06)
    frames, mask = photographs(closeness)
    far_off = Camera.pinhole(width=WIDTH, height=HEIGHT, focal_px=1e5)
    result = fit_response_to_switched_sphere(frames, far_off, mask)
    response = result.fit.response
    np.testing.assert_allclose(response.matrix, COLOURS.T @ DIRECTIONS, atol=0.012)
    np.testing.assert_allclose(response.ambient, ROOM, atol=0.001)
    assert result.fit.quality.residual_deg < 1.0  # of noise
    place = CENTRE + np.array([60.0, -40.0])  # a patch there, in the plane of the ball's centre
    at = np.array([*(place - CENTRE) / RADIUS, 0.0])
    expected = np.zeros((3, 3))
    for direction, colour, t in zip(DIRECTIONS, COLOURS, closeness, strict=True):
        towards = direction / t - at
        away = np.linalg.norm(towards)
        expected += np.outer(colour, towards / away) / (t * away) ** 2
    there = response.at(place)[0]
    apart = np.abs(there - expected).max()
    assert apart < 0.25 * np.abs(response.matrix - expected).max()  # what is left is of second order


def test_far_lamps_or_an_unknown_focal_length_leave_one_m() -> None:
    for closeness, focal_px in ((0.0, 1e5), (0.08, None)):
        frames, mask = photographs((closeness,) * 3)
        camera = CAMERA if focal_px is None else Camera.pinhole(width=WIDTH, height=HEIGHT, focal_px=focal_px)
        response = fit_response_to_switched_sphere(frames, camera, mask).fit.response
        assert response.variation is None
        np.testing.assert_allclose(response.matrix, COLOURS.T @ DIRECTIONS, atol=0.012)


def test_what_the_mask_leaves_out_of_the_ball_does_not_count() -> None:
    frames, mask = photographs((0.08, 0.08, 0.08))
    held = np.zeros_like(mask)
    held[125:] = True  # a table before it
    grey = np.float32(0.3)
    frames = [
        LinearFrame(rgb=np.where(held[..., None], grey, each.rgb), clipped=each.clipped) for each in frames
    ]
    result = fit_response_to_switched_sphere(frames, CAMERA, mask & ~held)
    assert result.lit is not None
    np.testing.assert_allclose(result.lit.room, ROOM, atol=0.002)
    for lamp, direction in zip(result.lit.lamps, DIRECTIONS, strict=True):
        assert angle_deg(lamp.direction, direction) < 0.5


def test_gloss_is_not_taken_for_near_lamps() -> None:
    frames, mask = photographs((0.0, 0.0, 0.0), gloss=0.2)
    far_off = Camera.pinhole(width=WIDTH, height=HEIGHT, focal_px=1e5)
    response = fit_response_to_switched_sphere(frames, far_off, mask).fit.response
    assert response.variation is None
    assert angle_deg(response.light_directions, DIRECTIONS).max() < 0.4


def test_a_dark_frame_tells_the_room() -> None:
    frames, mask = photographs((0.05, 0.05, 0.05))
    dark = LinearFrame(rgb=(mask[..., None] * ROOM).astype(np.float32), clipped=np.zeros(mask.shape, bool))
    found = fit_lamps_to_ball(frames, sphere_normals(circle_of(mask), CAMERA, 0.02), dark)
    np.testing.assert_allclose(found.room, ROOM, atol=1e-6)


def test_a_ball_that_shows_no_dark_side_does_not_tell_the_room(caplog, monkeypatch) -> None:
    monkeypatch.setattr(sphere, "_RIM_SHARE", 0.4)
    frames, mask = photographs((0.05, 0.05, 0.05))
    result = fit_response_to_switched_sphere(frames, CAMERA, mask)
    assert result.lit is not None
    assert not result.lit.is_room_known
    assert "film some frames with all lamps off" in caplog.text


def test_a_lamp_that_seems_to_stand_in_the_picture_is_told(caplog) -> None:
    frames, mask = photographs((0.2, 0.05, 0.05))
    fit_response_to_switched_sphere(frames, CAMERA, mask)
    assert "5.0 radii of the ball from its centre" in caplog.text
    assert "--transfer" in caplog.text

"""Unseen parts go where a plate would carry them: exactly, where the rest moves by a linear map."""

from __future__ import annotations

import numpy as np
import pytest

from tests.tracking.wrinkled_video import WrinkledVideo
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.tracking.extrapolation import Extrapolation, seen_share
from vntoolkit.tracking.lattice import lattice_on_template
from vntoolkit.tracking.template import TrackingTemplate, template_from_maps


def sheet(seams=()) -> TrackingTemplate:
    video = WrinkledVideo(width=96, height=72)
    return template_from_maps(*video.maps(0), video.camera, seams)


def extrapolation(template: TrackingTemplate) -> Extrapolation:
    return Extrapolation(
        lattice_on_template(template, 8), template, WrinkledVideo(width=96, height=72).camera
    )


def test_what_is_seen_stays_and_a_hidden_hole_follows_a_shift() -> None:
    template = sheet()
    shift = np.tile([3.0, -2.0], (len(template.pixels), 1))
    hidden = np.linalg.norm(template.positions_px - [48, 36], axis=1) < 16
    wrong = np.where(hidden[:, None], shift + 20.0, shift)
    carried = extrapolation(template).carried(wrong, np.where(hidden, 0.0, 1.0))
    np.testing.assert_array_equal(carried[~hidden], shift[~hidden])
    np.testing.assert_allclose(carried[hidden], shift[hidden], atol=1e-6)


def test_a_hidden_hole_turns_with_what_is_around_it() -> None:
    template = sheet()
    centred = template.positions_px - [48.0, 36.0]
    turn = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    true = centred @ turn.T - centred
    hidden = np.linalg.norm(centred, axis=1) < 14
    carried = extrapolation(template).carried(
        np.where(hidden[:, None], 0.0, true), np.where(hidden, 0.1, 0.9)
    )
    assert np.abs(carried - true)[hidden].max() < 0.15
    assert np.abs(true)[hidden].max() > 5.0


@pytest.mark.parametrize(("reach", "leak"), [(0.4, 0.02), (0.0, 0.05)])
def test_a_seam_carries_nothing_across(reach: float, leak: float) -> None:
    """Across a whole seam nothing; where its last pixel is not cut, a trace of the jump of 8 pixels."""
    template = sheet([np.array([[-reach, 35.5], [95 + reach, 35.5]])])
    below = template.pixels[:, 1] >= 36
    moved = np.where(below[:, None], [4.0, 0.0], [-4.0, 0.0])
    hidden = (np.abs(template.pixels[:, 1] - 35.5) < 6) & (np.abs(template.pixels[:, 0] - 48) < 16)
    wrong = np.where(hidden[:, None], 0.0, moved)
    carried = extrapolation(template).carried(wrong, np.where(hidden, 0.0, 1.0))
    assert np.abs(carried - moved)[hidden].max() < leak * 8.0


def test_with_nothing_in_sight_all_stays_as_measured() -> None:
    template = sheet()
    measured = np.random.default_rng(0).normal(size=(len(template.pixels), 2))
    carried = extrapolation(template).carried(measured, np.zeros(len(measured)))
    np.testing.assert_array_equal(carried, measured)


def test_the_share_seen_goes_from_none_to_all_without_a_step() -> None:
    share = seen_share(np.linspace(0, 1, 101))
    assert (share[0], share[-1]) == (0.0, 1.0)
    assert np.all(np.diff(share) >= 0)
    assert np.diff(share).max() < 0.05


@pytest.mark.parametrize(
    ("camera", "unit"),
    [
        (Camera.orthographic(width=96, height=72), 1.0),
        (Camera.orthographic(width=96, height=72, pixels_per_unit=1000.0), 1e-3),  # metres
        (Camera.pinhole(width=96, height=72, focal_px=2000.0), 1 / 2000.0),  # mean depth 1
    ],
)
def test_the_hidden_depth_of_a_body_that_turns_does_not_depend_on_the_unit(camera: Camera, unit: float):
    """Where lengths are not pixels, the guess that does well must still tell itself from the poor ones."""
    normals, depth = WrinkledVideo(width=96, height=72).maps(0)
    start = 1.0 if camera.is_perspective else 0.0
    here = DepthMap(depth=start + unit * (depth.depth - 200.0), mask=depth.mask)
    template = template_from_maps(normals, here, camera)
    hidden = template.pixels[:, 0] > 64  # an end, which nothing holds on its far side
    turned = template.vertices_in_camera[:, 2] + unit * 0.3 * (template.pixels[:, 0] - 48.0)
    seen = np.where(hidden, template.vertices_in_camera[:, 2], turned)
    plate = Extrapolation(lattice_on_template(template, 8), template, camera)
    carried = plate.carried_depth(seen, np.where(hidden, 0.0, 1.0))
    assert np.abs(carried - turned)[hidden].max() < 0.5 * unit  # of up to 14 pixels

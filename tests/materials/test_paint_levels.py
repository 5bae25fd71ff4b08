"""Steps of paint tell its levels, whatever the lamps' directions are."""

from dataclasses import replace

import numpy as np
import pytest

from vntoolkit.materials.paint_levels import in_one_paint
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

H, W = 120, 160
PAINTS = np.array([[0.9, 0.3, 0.3], [0.3, 0.65, 0.4], [0.3, 0.4, 0.7]])
COLOURS = np.array([[0.8, 0.1, 0.02], [0.1, 0.7, 0.1], [0.02, 0.1, 0.8]])
TOWARDS = np.array([[-0.5, -0.3, -0.81], [0.5, -0.3, -0.81], [0.0, 0.6, -0.8]])
RESPONSE = LightResponse(matrix=COLOURS.T @ TOWARDS, light_colours=COLOURS)


def _shading():
    """(h, w, 3), light of each lamp on a wavy sheet."""
    v, u = np.mgrid[:H, :W] / 25.0
    normals = np.stack([0.4 * np.cos(u), 0.4 * np.sin(v + 0.5 * u), -np.ones_like(u)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return normals @ TOWARDS.T


def _painted(shading):
    v, u = np.mgrid[:H, :W] // 24
    return LinearFrame((shading * PAINTS[(u + 2 * v) % 3] @ COLOURS).astype(np.float32))


def test_squares_of_paint_become_one_paint():
    shading = _shading()
    levelled = in_one_paint(_painted(shading), np.ones((H, W), np.bool_), RESPONSE)
    there = ~levelled.clipped
    assert there.mean() > 0.9
    ratio = np.log(levelled.rgb @ RESPONSE.contributions_from_rgb.T / shading)[there]
    assert (ratio.std(axis=0) < 0.12).all()  # of log ρ; the paints themselves spread by .3 to .5
    mean = np.log(PAINTS).mean(axis=0)
    assert np.median(ratio, axis=0) == pytest.approx(mean, abs=0.1)


def test_nothing_is_asked_of_the_lamps_directions():
    frame, mask = _painted(_shading()), np.ones((H, W), np.bool_)
    mirrored = replace(RESPONSE, matrix=RESPONSE.matrix @ np.diag([-1.0, 1.0, 1.0]))
    one, other = (in_one_paint(frame, mask, response) for response in (RESPONSE, mirrored))
    assert np.array_equal(one.rgb, other.rgb)
    assert np.array_equal(one.clipped, other.clipped)


def test_a_frame_without_a_subject_is_marked_all_over():
    frame = _painted(_shading())
    assert in_one_paint(frame, np.zeros((H, W), np.bool_), RESPONSE).clipped.all()

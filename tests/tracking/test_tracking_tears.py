"""Tears: a ball before a wall is cut out along its rim; a wall, a fold and noise are left whole."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import ndimage

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.options import Tears, TrackingOptions
from vntoolkit.tracking.tears import tear_pixels
from vntoolkit.tracking.tracker import SurfaceTracker

SIZE, RADIUS = 80, 24.0
U, V = np.meshgrid(np.arange(SIZE) - 39.5, np.arange(SIZE) - 39.5)
BALL = np.hypot(U, V) < RADIUS


def normal_map(slope_u: np.ndarray, slope_v: np.ndarray) -> NormalMap:
    normals = np.stack([slope_u, slope_v, -np.ones_like(slope_u)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return NormalMap(normals_in_camera=normals.astype(np.float32), mask=np.ones(slope_u.shape, dtype=bool))


def ball_before_wall() -> NormalMap:
    depth = np.sqrt(np.maximum(RADIUS**2 - U**2 - V**2, 1.0))
    return normal_map(np.where(BALL, U / depth, 0.0), np.where(BALL, V / depth, 0.0))


def test_a_ball_is_cut_out_along_its_rim() -> None:
    torn = tear_pixels(ball_before_wall())
    assert np.abs(np.hypot(U, V)[torn] - RADIUS).max() < 3.0
    left = ~torn
    labels, _ = ndimage.label(left)  # four neighbours, as the template's edges
    assert labels[40, 40] != labels[2, 2]


def test_what_hides_nothing_is_not_torn() -> None:
    tilted = normal_map(np.full(U.shape, 1.5), np.zeros(U.shape))
    fold = normal_map(np.where(U > 0, 0.8, -0.8), np.zeros(U.shape))  # a ridge towards the viewer
    valley = normal_map(np.where(U > 0, -0.3, 0.3), np.zeros(U.shape))
    rng = np.random.default_rng(0)
    noise = normal_map(rng.normal(scale=0.2, size=U.shape), rng.normal(scale=0.2, size=U.shape))
    for whole in (tilted, fold, valley, noise):
        assert not tear_pixels(whole).any()


def test_a_torn_template_has_no_triangle_across() -> None:
    normals = ball_before_wall()
    depth = DepthMap(depth=np.full(U.shape, 50.0), mask=normals.mask)
    camera = Camera.orthographic(width=SIZE, height=SIZE)
    options = TrackingOptions()
    whole = SurfaceTracker(normals, depth, camera, options)
    torn = SurfaceTracker(normals, depth, camera, replace(options, tears=Tears.NORMALS))
    assert len(whole.template.pixels) == SIZE * SIZE
    pixels = torn.template.pixels
    inside = np.hypot(*(pixels[torn.template.faces] - 39.5).transpose(2, 0, 1)) < RADIUS - 3
    outside = np.hypot(*(pixels[torn.template.faces] - 39.5).transpose(2, 0, 1)) > RADIUS + 3
    assert not np.any(inside.any(axis=1) & outside.any(axis=1))
    labels = np.zeros(len(pixels), dtype=int)
    labels[:] = np.arange(len(pixels))
    for _ in range(4 * SIZE):  # the least number among neighbours spreads over each piece
        low = np.minimum(labels[torn.template.edges[:, 0]], labels[torn.template.edges[:, 1]])
        np.minimum.at(labels, torn.template.edges[:, 0], low)
        np.minimum.at(labels, torn.template.edges[:, 1], low)
    middle, corner = (torn.template.index[at, at] for at in (40, 2))
    assert labels[middle] != labels[corner]

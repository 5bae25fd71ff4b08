"""What lies before ends at its contour, and what lies behind is another surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.outline import depth_steps, edges_beside, occluding_contours
from vntoolkit.tracking.slopes import slopes_from_normals
from vntoolkit.tracking.template import template_from_maps
from vntoolkit.tracking.tracker import SurfaceTracker

WIDTH, HEIGHT = 128, 96
CAMERA = Camera.orthographic(width=WIDTH, height=HEIGHT)
U, V = np.moveaxis(CAMERA.pixel_grid(), -1, 0)
BETWEEN = 64  # first column of the right leg
RADIUS = 24.0


def maps(p: np.ndarray, q: np.ndarray, weight: np.ndarray | None = None) -> tuple[NormalMap, DepthMap]:
    """Maps of slopes p, q between the outer borders of two legs."""
    n = np.stack([p, q, -np.ones_like(p)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    mask = np.abs(U - (BETWEEN - 0.5)) < 2 * RADIUS
    mask &= (V > 3) & (V < HEIGHT - 4)
    return (
        NormalMap(normals_in_camera=n.astype(np.float32), mask=mask, weight=weight),
        DepthMap(depth=np.full(mask.shape, 100.0), mask=mask),
    )


def legs(raised_px: float = 0.0) -> tuple[NormalMap, DepthMap]:
    """Two legs side by side, of which the right one is raised; waves go round each."""
    centre = np.where(U < BETWEEN, BETWEEN - 0.5 - RADIUS, BETWEEN - 0.5 + RADIUS)
    angle = np.arcsin(np.clip((U - centre) / RADIUS, -0.985, 0.985))
    at = V + np.where(U < BETWEEN, 0.0, raised_px)
    waves = 0.15 * (np.cos(at / 2.1) + np.cos(at / 3.3 + 1.0))
    return maps(np.tan(angle), waves)


def found(normal_map: NormalMap) -> np.ndarray:
    return occluding_contours(slopes_from_normals(normal_map, CAMERA), normal_map.mask)


def test_the_contour_between_two_legs_is_found_and_parts_their_pixels() -> None:
    normal_map, depth = legs()
    contours = found(normal_map)
    rows = np.flatnonzero(contours.any(axis=1))
    assert len(rows) > 0.95 * np.count_nonzero(normal_map.mask.any(axis=1))
    assert np.abs(U[contours] - (BETWEEN - 0.5)).max() < 4
    template = template_from_maps(normal_map, depth, CAMERA)
    kept = edges_beside(template.edges, template.pixels, contours)
    count = len(template.pixels)
    ones = np.ones(len(kept))
    parts, part = connected_components(sp.coo_array((ones, kept.T), shape=(count, count)), directed=False)
    u = template.pixels[:, 0]
    assert parts == 2
    assert len(set(part[u < BETWEEN - 2])) == len(set(part[u >= BETWEEN + 2])) == 1


def test_neither_folds_nor_a_valley_are_contours() -> None:
    zero = np.zeros_like(U)
    folds = maps(1.5 * np.sin(U / 6.0), zero)
    valley = maps(np.where(U < BETWEEN, 1.2, -1.2), zero)  # 50° either way
    for normal_map, depth in (folds, valley):
        assert not found(normal_map).any()
        template = template_from_maps(normal_map, depth, CAMERA)
        kept = edges_beside(template.edges, template.pixels, found(normal_map))
        assert len(kept) == len(template.edges)


def test_a_step_of_depth_that_slopes_do_not_have_parts_its_sides_and_a_steep_slope_does_not() -> None:
    """As where a shadow tells how far an arm lies behind the flank, whose normals meet smoothly."""
    normal_map, depth = maps(np.full(U.shape, 5.0), 0.0 * U)
    slopes, sloped = slopes_from_normals(normal_map, CAMERA), 100.0 + 5.0 * U
    assert not depth_steps(replace(depth, depth=sloped), slopes, CAMERA).any()
    steps = depth_steps(replace(depth, depth=sloped + 6.0 * (U >= BETWEEN)), slopes, CAMERA)
    inner = normal_map.mask & (np.abs(V - HEIGHT / 2) < 30)
    np.testing.assert_array_equal(steps[inner], (np.abs(U - (BETWEEN - 0.5)) < 1)[inner])
    template = template_from_maps(normal_map, depth, CAMERA)
    kept = template.pixels[edges_beside(template.edges, template.pixels, steps)]
    crosses = (kept[:, :, 0] < BETWEEN).any(axis=1) & (kept[:, :, 0] >= BETWEEN).any(axis=1)
    assert not (crosses & (np.abs(kept[:, 0, 1] - HEIGHT / 2) < 30)).any()


def test_normals_of_which_nothing_is_known_make_no_contour() -> None:
    """The edge of a shadow, in which a surface seems steep."""
    shadow = U < BETWEEN
    steep, zero = np.where(shadow, 3.0, 0.0), np.zeros_like(U)
    assert found(maps(steep, zero)[0]).any()
    weight = np.where(shadow, 0.01, 1.0).astype(np.float32)
    assert not found(maps(steep, zero, weight)[0]).any()


def test_a_leg_stays_where_it_is_while_the_other_is_raised_beside_it() -> None:
    tracker = SurfaceTracker(*legs(), CAMERA)
    raised = 0.0
    for _ in range(8):
        raised += 1.0
        tracked = tracker.step(*legs(raised))
    moved = tracked.positions_px - tracker.template.positions_px
    inner = np.abs(tracker.template.positions_px[:, 1] - HEIGHT / 2) < 20
    left = tracker.template.pixels[:, 0] < BETWEEN
    np.testing.assert_allclose(moved[inner & left, 1], 0.0, atol=0.5)
    np.testing.assert_allclose(np.median(moved[inner & ~left, 1]), -raised, atol=0.5)

"""A part that lies still is told from one that moves, and the edge of a shadow is not registered by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.extrapolation import Extrapolation
from vntoolkit.tracking.flow_jumps import jump_pixels
from vntoolkit.tracking.flow_slopes import slope_pyramid
from vntoolkit.tracking.lattice import TemplateLattice, lattice_on_template
from vntoolkit.tracking.resting import RestingParts
from vntoolkit.tracking.template import TrackingTemplate, template_from_maps

WIDTH, HEIGHT, RADIUS = 96, 64, 36.0
CAMERA = Camera.orthographic(width=WIDTH, height=HEIGHT)


def column(turned_deg: float = 0.0, radius: float = RADIUS) -> NormalMap:
    """An upright cylinder, or one whose normals have turned about its axis."""
    across = np.broadcast_to((np.arange(WIDTH) - 47.5) / radius, (HEIGHT, WIDTH))
    angle = np.arcsin(np.clip(across, -1, 1)) + np.radians(turned_deg)
    normals = np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=-1)
    return NormalMap(normals_in_camera=normals.astype(np.float32), mask=np.abs(across) < 0.95)


def resting(first: NormalMap) -> tuple[RestingParts, TrackingTemplate, TemplateLattice]:
    depth = DepthMap(depth=np.full(first.shape, 100.0), mask=first.mask)
    template = template_from_maps(first, depth, CAMERA)
    lattice = lattice_on_template(template, 8)
    return RestingParts(lattice, template, first), template, lattice


def test_a_part_lies_still_where_it_looks_the_same_and_its_thought_place_does_not() -> None:
    parts, template, lattice = resting(column())
    here, moved = template.positions_px, template.positions_px + np.array([24.0, 0.0])
    counts = np.bincount(lattice.node_of_vertex)
    right_half = lattice.sums(here)[:, 0] / counts > 47.5
    shares = parts.shares(column(), moved)
    assert shares[right_half].min() == 1.0  # there it would be off the mask or on the steep side
    assert parts.shares(column(), here).max() == 0.0  # nothing speaks against where it is thought to be
    assert parts.shares(column(turned_deg=12.0), moved).mean() < 0.05  # it has turned: it does not lie still


def test_a_flat_part_is_not_said_to_lie_still() -> None:
    flat = column(radius=2000.0)
    parts, template, lattice = resting(flat)
    shares = parts.shares(flat, template.positions_px + np.array([10.0, 0.0]))
    assert shares[lattice.cells[:, 0] < 9].max() == 0.0
    assert shares[lattice.cells[:, 0] == 11].min() == 1.0  # these would have left the mask


def test_what_lies_still_is_not_carried_along_unless_it_is_seen() -> None:
    _, template, lattice = resting(column())
    extrapolation = Extrapolation(lattice, template, CAMERA)
    shift = np.tile([12.0, 0.0], (len(template.pixels), 1))
    seen = (template.pixels[:, 1] < 24).astype(float)
    still = (lattice.cells[:, 1] >= 5).astype(float)
    low = template.pixels[:, 1] >= 56
    without = extrapolation.carried(shift, seen)
    carried = extrapolation.carried(shift, seen, rest=still)
    np.testing.assert_allclose(without[low], shift[low], atol=0.02)
    assert np.abs(carried[low]).max() < 1.0
    np.testing.assert_array_equal(carried[seen > 0], shift[seen > 0])
    whole = extrapolation.carried(shift, np.ones_like(seen), rest=still)
    np.testing.assert_array_equal(whole, shift)


def test_jumps_of_the_weight_are_found_and_nothing_else() -> None:
    first = column()
    weight = np.full(first.shape, 0.9, dtype=np.float32)
    assert not jump_pixels(first).any()
    assert not jump_pixels(replace(first, weight=weight)).any()  # the outline is none
    ramp = np.broadcast_to(np.linspace(0.2, 1.0, WIDTH, dtype=np.float32), first.shape)
    assert not jump_pixels(replace(first, weight=ramp)).any()
    weight[30:] = 0.2
    rows = np.flatnonzero(jump_pixels(replace(first, weight=weight)).any(axis=1))
    assert rows.min() in range(25, 30)
    assert rows.max() in range(30, 35)


def test_a_jump_on_a_knit_is_none_since_the_knit_holds_its_place() -> None:
    smooth = column()
    weight = np.full(smooth.shape, 0.9, dtype=np.float32)
    weight[30:] = 0.2
    knit = 0.25 * np.sin(np.arange(WIDTH) * 2.1)[:, None] * np.array([1.0, 0.0, 0.0])
    ribbed = smooth.normals_in_camera + knit
    ribbed /= np.linalg.norm(ribbed, axis=-1, keepdims=True)
    assert jump_pixels(replace(smooth, weight=weight)).any()
    assert not jump_pixels(replace(smooth, normals_in_camera=ribbed.astype(np.float32), weight=weight)).any()


def test_the_edge_of_a_shadow_weighs_next_to_nothing_in_the_slopes() -> None:
    whole = column()
    even = np.full(whole.shape, 0.9, dtype=np.float32)
    shaded = even.copy()
    shaded[:, :40] = 0.25
    slopes = slope_pyramid(replace(whole, weight=shaded), 0)[0]
    before = slope_pyramid(replace(whole, weight=even), 0)[0]
    assert slopes[:, 39, 2].max() < 0.03 * before[:, 39, 2].min()
    np.testing.assert_array_equal(slopes[:, 50:], before[:, 50:])
    np.testing.assert_allclose(
        slopes[:, 16:30] / slopes[:, 16:30, 2:], before[:, 16:30] / before[:, 16:30, 2:], rtol=1e-4
    )

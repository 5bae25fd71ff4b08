"""How motion goes on where nothing is measured: as one body, or as what is measured beside it."""

import numpy as np
import pytest

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.body_motion import BodyMotion
from vntoolkit.tracking.lattice import TemplateLattice, lattice_on_template
from vntoolkit.tracking.template import template_from_maps

_WIDTH, _HEIGHT, _CELL_PX = 320, 96, 8


def _sheet() -> tuple[BodyMotion, TemplateLattice, FloatArray, FloatArray]:
    """A flat sheet: its motion, lattice, (m, 2) the nodes in pixels, and (e, 2) its links."""
    mask = np.ones((_HEIGHT, _WIDTH), dtype=bool)
    normals = np.tile(np.float32([0, 0, -1]), (_HEIGHT, _WIDTH, 1))
    camera = Camera.orthographic(width=_WIDTH, height=_HEIGHT)
    depth = DepthMap(depth=np.full(mask.shape, 500.0), mask=mask)
    template = template_from_maps(NormalMap(normals_in_camera=normals, mask=mask), depth, camera)
    lattice = lattice_on_template(template, _CELL_PX)
    nodes = lattice.sums(template.positions_px) / _CELL_PX**2
    rows = np.repeat(np.arange(lattice.count), np.diff(lattice.starts))
    once = rows < lattice.neighbours
    links = np.stack([rows[once], lattice.neighbours[once]], axis=1).astype(np.int64)
    along = nodes[links[:, 1]] - nodes[links[:, 0]]
    return BodyMotion(lattice, template, camera, links, along), lattice, nodes, links


def _guessed(
    motion: BodyMotion, links: FloatArray, moved: FloatArray, known: FloatArray
) -> tuple[FloatArray, FloatArray]:
    tested = np.minimum(known[links[:, 0]], known[links[:, 1]])
    return _answer(motion, moved, known, tested, np.zeros(len(links)))


def _answer(motion: BodyMotion, *told: FloatArray) -> tuple[FloatArray, FloatArray]:
    whole, own, field = motion.guessed(*told)
    return whole + own, field.errors


def _size(drawn: FloatArray) -> FloatArray:
    return np.sqrt(np.square(drawn).sum(axis=(1, 2)))


def test_one_body_is_followed_everywhere_and_surely() -> None:
    motion, _, nodes, links = _sheet()
    moved = nodes @ np.array([[0.02, 0.05], [-0.05, -0.03]]) + 3.0
    known = np.where(nodes[:, 0] < 120, 1.0, 1e-4)
    steps, drawn = _guessed(motion, links, moved, known)
    true = moved[links[:, 1]] - moved[links[:, 0]]
    assert np.abs(steps - true).max() < 0.01 * _CELL_PX
    assert np.median(_size(drawn)) < 0.05


def test_what_is_hidden_moves_as_what_is_measured_beside_it_and_farther_off_as_the_whole() -> None:
    """Half of a sheet is still, the other turns by 0.3; of that, a part is hidden."""
    motion, _, nodes, links = _sheet()
    right = np.maximum(nodes[:, 0] - 160.0, 0.0)
    moved = np.stack([np.zeros(len(nodes)), 0.3 * right], axis=1)
    known = np.where(nodes[:, 0] < 240, 1.0, 1e-4)
    steps, drawn = _guessed(motion, links, moved, known)
    true = moved[links[:, 1]] - moved[links[:, 0]]
    middle = nodes[links].mean(axis=1)[:, 0]
    error = np.linalg.norm(steps - true, axis=1) / _CELL_PX
    near, far = (middle > 240) & (middle < 256), middle > 300
    whole = motion._whole(moved, known)
    by_whole = np.linalg.norm(whole[links[:, 1]] - whole[links[:, 0]] - true, axis=1) / _CELL_PX
    assert np.median(error[near]) < 0.3 * np.median(by_whole[near])
    assert np.median(error[near]) < np.median(error[far])
    size = _size(drawn)
    assert np.median(size[middle < 232]) < 0.7 * np.median(size[near]) < 0.7 * np.median(size[far])


def test_a_contour_keeps_motion_to_its_side() -> None:
    motion, _, nodes, links = _sheet()
    moved = np.stack([np.zeros(len(nodes)), 0.3 * np.maximum(nodes[:, 0] - 80.0, 0.0)], axis=1)
    known = np.where(nodes[:, 0] < 160, 1.0, 1e-4)
    tested = np.minimum(known[links[:, 0]], known[links[:, 1]])
    sides = nodes[links][:, :, 0] > 160
    cut = (sides[:, 0] != sides[:, 1]).astype(float)
    open_steps, _ = _answer(motion, moved, known, tested, np.zeros(len(links)))
    steps, drawn = _answer(motion, moved, known, tested, cut)
    whole = motion._whole(moved, known)
    by_whole = whole[links[:, 1]] - whole[links[:, 0]]
    beyond = (nodes[links].mean(axis=1)[:, 0] > 168) & (nodes[links].mean(axis=1)[:, 0] < 190)
    own = [np.linalg.norm((s - by_whole)[beyond], axis=1).mean() for s in (steps, open_steps)]
    assert own[0] < 0.5 * own[1]
    assert _size(drawn)[beyond].mean() > 0.0


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_nothing_measured_and_all_measured_are_finite(share: float) -> None:
    motion, _, nodes, links = _sheet()
    known = np.full(len(nodes), max(share, 1e-4))
    steps, drawn = _guessed(motion, links, np.zeros_like(nodes), known)
    assert np.abs(steps).max() < 1e-9
    assert np.isfinite(drawn).all()

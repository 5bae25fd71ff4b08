"""How motion goes on where nothing is measured: as one body."""

import numpy as np
import pytest

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.body_motion import BodyMotion
from vntoolkit.tracking.lattice import lattice_on_template
from vntoolkit.tracking.template import template_from_maps

_WIDTH, _HEIGHT, _CELL_PX = 320, 96, 8


def _sheet(mask: Mask) -> tuple[BodyMotion, FloatArray]:
    """A flat sheet: its motion, and (m, 2) its nodes in pixels."""
    normals = np.tile(np.float32([0, 0, -1]), (_HEIGHT, _WIDTH, 1))
    camera = Camera.orthographic(width=_WIDTH, height=_HEIGHT)
    depth = DepthMap(depth=np.full(mask.shape, 500.0), mask=mask)
    template = template_from_maps(NormalMap(normals_in_camera=normals, mask=mask), depth, camera)
    lattice = lattice_on_template(template, _CELL_PX)
    return BodyMotion(lattice, template, camera), lattice.sums(template.positions_px) / _CELL_PX**2


def test_one_body_is_followed_everywhere_whatever_a_few_places_do() -> None:
    motion, nodes = _sheet(np.ones((_HEIGHT, _WIDTH), dtype=bool))
    true = nodes @ np.array([[0.02, 0.05], [-0.05, -0.03]]) + 3.0
    known = np.where(nodes[:, 0] < 120, 1.0, 1e-4)
    moved = true + 20.0 * (np.hypot(*(nodes - [40.0, 40.0]).T) < 12)[:, None]
    assert np.abs(motion.fitted(true, known) - true).max() < 0.1
    assert np.abs(motion.fitted(moved, known) - true).max() < 0.5


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_nothing_measured_and_all_measured_are_finite(share: float) -> None:
    motion, nodes = _sheet(np.ones((_HEIGHT, _WIDTH), dtype=bool))
    assert np.abs(motion.fitted(np.zeros_like(nodes), np.full(len(nodes), max(share, 1e-4)))).max() < 1e-9

"""What carries unseen vertices: lengths that stay, and the motion of one body, each exact where it holds."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.extrapolation import Extrapolation
from vntoolkit.tracking.isometry import Isometry
from vntoolkit.tracking.lattice import TemplateLattice, lattice_on_template
from vntoolkit.tracking.lifted_motion import LiftedMotion
from vntoolkit.tracking.template import TrackingTemplate, template_from_maps

WIDTH, HEIGHT = 64, 48
CAMERA = Camera.orthographic(width=WIDTH, height=HEIGHT)


def sheet(depth: npt.NDArray[np.float64]) -> tuple[TrackingTemplate, TemplateLattice]:
    mask = np.ones(depth.shape, dtype=bool)
    normals = np.zeros((*depth.shape, 3), dtype=np.float32)
    normals[..., 2] = -1.0
    template = template_from_maps(
        NormalMap(normals_in_camera=normals, mask=mask), DepthMap(depth=depth, mask=mask), CAMERA
    )
    return template, lattice_on_template(template, 8)


def slopes(p: float, q: float) -> npt.NDArray[np.float32]:
    image = np.ones((HEIGHT, WIDTH, 3), dtype=np.float32)
    image[..., 0], image[..., 1] = p, q
    return image


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_a_flat_sheet_that_tilts_shrinks_along_the_slope(turn: float) -> None:
    template, lattice = sheet(np.full((HEIGHT, WIDTH), 100.0))
    around = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    isometry = Isometry(lattice, template, slopes(0.0, 0.0))
    jacobians, trust = isometry.jacobians(
        slopes(1.5, 0.0), template.positions_px, np.tile(around.ravel(), (lattice.count, 1))
    )
    metric = np.array([[1 + 1.5**2, 0.0], [0.0, 1.0]])
    lengths = np.einsum("nji,jk,nkl->nil", jacobians, metric, jacobians)
    np.testing.assert_allclose(lengths, np.tile(np.eye(2), (lattice.count, 1, 1)), atol=1e-6)
    if turn == 0.0:
        np.testing.assert_allclose(jacobians[0], np.diag([1 / np.sqrt(1 + 1.5**2), 1.0]), atol=1e-6)
    assert trust.min() == 1.0


def test_the_same_slopes_ask_for_no_stretch() -> None:
    template, lattice = sheet(np.full((HEIGHT, WIDTH), 100.0))
    isometry = Isometry(lattice, template, slopes(0.8, -0.4))
    around = np.tile([1.0, 0.0, 0.0, 1.0], (lattice.count, 1))
    jacobians, _ = isometry.jacobians(slopes(0.8, -0.4), template.positions_px, around)
    np.testing.assert_allclose(jacobians, np.tile(np.eye(2), (lattice.count, 1, 1)), atol=1e-6)


def test_no_slopes_are_not_trusted() -> None:
    template, lattice = sheet(np.full((HEIGHT, WIDTH), 100.0))
    isometry = Isometry(lattice, template, slopes(0.0, 0.0))
    around = np.tile([1.0, 0.0, 0.0, 1.0], (lattice.count, 1))
    _, trust = isometry.jacobians(np.zeros((HEIGHT, WIDTH, 3), np.float32), template.positions_px, around)
    assert trust.max() == 0.0


@pytest.mark.parametrize(
    ("stretch", "sure", "reliable"), [(1.0, 1.0, 1.0), (2.5, 0.3, 0.05), (0.4, 0.3, 0.05)]
)
def test_what_stretches_beyond_cloth_is_not_relied_on(stretch: float, sure: float, reliable: float) -> None:
    template, lattice = sheet(np.full((HEIGHT, WIDTH), 100.0))
    isometry = Isometry(lattice, template, slopes(0.0, 0.0))
    stretched = np.tile([stretch, 0.0, 0.0, 1.0], (lattice.count, 1))
    surely, reliably = isometry.plausibility(slopes(0.0, 0.0), template.positions_px, stretched)
    assert surely == pytest.approx(np.full(len(surely), surely[0]))
    assert surely[0] <= sure
    assert reliably[0] <= reliable
    if stretch == 1.0:
        assert (surely[0], reliably[0]) == (1.0, 1.0)
    # the same stretch is none where the surface turns to face the viewer
    facing = Isometry(lattice, template, slopes(np.sqrt(max(stretch**2 - 1, 0.0)), 0.0))
    if stretch > 1.0:
        assert facing.plausibility(slopes(0.0, 0.0), template.positions_px, stretched)[1].min() > 0.99


def turned_bump() -> tuple[TrackingTemplate, TemplateLattice, npt.NDArray[np.float64]]:
    """A bump, and the displacement in the image (n, 2) of its turn about the vertical by 0.2 radians."""
    u, v = np.meshgrid(np.arange(WIDTH) - 31.5, np.arange(HEIGHT) - 23.5)
    template, lattice = sheet(100.0 - 20.0 * np.exp(-(u**2 + v**2) / 300.0))
    points = template.vertices_in_camera - [31.5, 23.5, 100.0]
    across = np.cos(0.2) * points[:, 0] + np.sin(0.2) * points[:, 2]
    moved = np.stack([across - points[:, 0], np.zeros(len(points))], axis=1)
    return template, lattice, moved


def test_the_motion_of_one_body_is_known_from_a_part_of_it() -> None:
    template, lattice, moved = turned_bump()
    counts = np.bincount(lattice.node_of_vertex)
    means = lattice.sums(moved) / counts[:, None]
    seen = (lattice.cells[:, 0] < 6).astype(float)
    means[(lattice.cells[:, 0] < 2) & (lattice.cells[:, 1] < 3)] += 9.0  # another body, which does not count
    at_nodes, at_vertices = LiftedMotion(lattice, template, CAMERA).fitted(means, seen)
    unseen = template.pixels[:, 0] >= 48
    assert np.abs(at_vertices - moved)[unseen].max() < 0.4
    assert np.abs(moved[unseen]).max() > 1.2
    assert at_nodes.shape == means.shape


def test_a_turn_carries_the_hidden_end_of_the_bump() -> None:
    template, lattice, moved = turned_bump()
    hidden = template.pixels[:, 0] >= 36
    wrong = np.where(hidden[:, None], 0.0, moved)
    carried = Extrapolation(lattice, template, CAMERA).carried(wrong, np.where(hidden, 0.0, 1.0))
    np.testing.assert_allclose(carried[~hidden], moved[~hidden], atol=1e-12)
    assert np.abs(carried - moved)[hidden].max() < 0.5
    assert np.abs(moved[hidden]).max() > 2.0

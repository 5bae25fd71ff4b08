import numpy as np
import pytest

from vntoolkit.errors import BadMesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.meshing.clean import clean_mesh
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.options.export import CleanOptions


@pytest.fixture
def sheet_with_crumb_and_hole() -> Mesh:
    mask = np.ones((30, 40), bool)
    mask[:, 30:] = False
    mask[2:5, 34:37] = True  # a crumb of 8 triangles
    mask[15, 15] = False  # a hole of one pixel, with 4 boundary edges
    depth = DepthMap(depth=np.zeros((30, 40)), mask=mask)
    rgb = np.full((30, 40, 3), 0.25, np.float32)
    return mesh_from_depth(depth, Camera.orthographic(width=40, height=30), rgb=rgb)


def test_crumbs_go_and_the_rest_stays(sheet_with_crumb_and_hole: Mesh) -> None:
    cleaned = clean_mesh(sheet_with_crumb_and_hole, CleanOptions(largest_hole=0))
    assert len(cleaned.faces) == len(sheet_with_crumb_and_hole.faces) - 8
    assert len(cleaned.vertices) == 30 * 30 - 1
    np.testing.assert_allclose(cleaned.colours, 0.25, atol=0.003)  # pymeshlab keeps 8 bits
    np.testing.assert_allclose(cleaned.normals, np.tile([0, 0, -1], (899, 1)), atol=1e-9)


def test_small_holes_close_and_the_rim_stays(sheet_with_crumb_and_hole: Mesh) -> None:
    closed = clean_mesh(sheet_with_crumb_and_hole, CleanOptions(largest_hole=8))
    corners = closed.vertices[closed.faces]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    assert area.sum() == pytest.approx(29 * 29.5, rel=2e-3)  # the rim is half a pixel beyond its centres


def test_decimation_reaches_its_target(sheet_with_crumb_and_hole: Mesh) -> None:
    small = clean_mesh(sheet_with_crumb_and_hole, CleanOptions(most_faces=200))
    assert 0 < len(small.faces) <= 200
    assert small.diagonal == pytest.approx(np.hypot(29, 29.5), rel=0.01)


def test_nothing_left_is_an_error(sheet_with_crumb_and_hole: Mesh) -> None:
    with pytest.raises(BadMesh, match="none is left"):
        clean_mesh(sheet_with_crumb_and_hole, CleanOptions(smallest_piece=10**6))

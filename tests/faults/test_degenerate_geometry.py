"""Masks with holes and islands, one pixel wide; lone vertices; seams that cut a mesh in two."""

import numpy as np
import pytest
from scipy import ndimage

from vntoolkit.errors import BadMesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.maps_and_meshes.meshes import read_mesh, write_mesh
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.options.depth import IntegrationOptions, Integrator
from vntoolkit.options.tracking import TrackingOptions
from vntoolkit.tracking.tracker import SurfaceTracker

SIZE = 48
CAMERA = Camera.orthographic(width=SIZE, height=SIZE)


def _bumps() -> tuple[np.ndarray, np.ndarray]:
    """Depth (h, w) in pixels, and its normals."""
    v, u = np.mgrid[:SIZE, :SIZE].astype(float)
    depth = 3 * np.sin(u / 7) * np.cos(v / 9)
    slopes = [3 / 7 * np.cos(u / 7) * np.cos(v / 9), -3 / 9 * np.sin(u / 7) * np.sin(v / 9), -np.ones_like(u)]
    normals = np.stack(slopes, axis=-1)
    return depth, normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def _masks() -> dict[str, np.ndarray]:
    v, u = np.mgrid[:SIZE, :SIZE]
    ring = np.hypot(u - 24, v - 24)
    line = np.zeros((SIZE, SIZE), bool)
    line[20, 5:40] = True
    stair = np.zeros((SIZE, SIZE), bool)
    stair[np.arange(10, 40), np.arange(10, 40)] = stair[np.arange(10, 40), np.arange(9, 39)] = True
    lone = np.zeros((SIZE, SIZE), bool)
    lone[7, 9] = True
    return {
        "hole": (ring < 20) & (ring > 6),
        "islands": (np.hypot(u - 12, v - 24) < 9) | (np.hypot(u - 36, v - 24) < 8) | lone,
        "one row": line, "one column": line.T, "a stair": stair, "one pixel": lone,
        "joined by a corner": ((u < 20) & (v < 20)) | ((u >= 20) & (v >= 20)),
    }  # fmt: skip


@pytest.mark.parametrize("integrator", [Integrator.POISSON, Integrator.DISCONTINUITY])
@pytest.mark.parametrize("name", _masks())
def test_every_island_is_right_up_to_its_own_offset(integrator, name):
    """Islands share no edge, so normals cannot tell their depths apart: each has one free offset."""
    depth, normals = _bumps()
    mask = _masks()[name]
    normal_map = NormalMap(normals_in_camera=np.where(mask[..., None], normals, 0), mask=mask)
    found = DepthIntegrator(CAMERA, IntegrationOptions(integrator=integrator)).integrate(normal_map)
    assert np.array_equal(found.mask, mask)
    assert np.isfinite(found.depth[mask]).all()
    islands, count = ndimage.label(mask)
    for island in range(1, count + 1):
        inside = islands == island
        error = found.depth[inside] - depth[inside]
        assert np.ptp(error) < 0.15, f"island {island} of {count}"


@pytest.mark.parametrize("name", _masks())
def test_meshes_of_thin_and_split_masks_are_sound(tmp_path, name):
    depth, _ = _bumps()
    mask = _masks()[name]
    depth_map = DepthMap(depth=np.where(mask, depth, 0), mask=mask, unit=LengthUnit.PIXEL)
    if name in ("one row", "one pixel", "one column"):
        with pytest.raises(BadMesh, match="there is no triangle"):
            mesh_from_depth(depth_map, CAMERA)
        return
    mesh = mesh_from_depth(depth_map, CAMERA)
    assert np.isfinite(mesh.vertices).all()
    assert 0 < mesh.faces.max() < len(mesh.vertices)
    write_mesh(tmp_path / "a.ply", mesh)
    assert len(read_mesh(tmp_path / "a.ply").vertices) == len(mesh.vertices)


def test_a_lone_vertex_has_no_normal_and_survives_the_disk(tmp_path):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [5, 5, 5]])
    mesh = Mesh(vertices=vertices, faces=np.array([[0, 1, 2]])).with_vertices(vertices + 1)
    moved = Mesh(vertices=vertices, faces=mesh.faces, normals=np.zeros((4, 3))).with_vertices(vertices)
    assert np.array_equal(moved.normals[3], [0, 0, 0])
    for suffix in (".ply", ".obj"):
        write_mesh(tmp_path / f"a{suffix}", moved)
        read = read_mesh(tmp_path / f"a{suffix}")
        np.testing.assert_allclose(read.vertices, vertices, atol=1e-6)


@pytest.mark.parametrize("name", [pytest.param("across", marks=pytest.mark.slow), "hole", "islands"])
def test_a_seam_that_cuts_the_surface_in_two_is_tracked(name):
    """Both parts stay where they are on a surface that does not move."""
    depth, normals = _bumps()
    mask = np.ones((SIZE, SIZE), bool) if name == "across" else _masks()[name]
    normal_map = NormalMap(
        normals_in_camera=np.where(mask[..., None], normals, 0).astype(np.float32), mask=mask
    )
    depth_map = DepthMap(depth=np.where(mask, depth, 0).astype(np.float32), mask=mask, unit=LengthUnit.PIXEL)
    seams = {
        "across": ([[24.5, 0.0], [24.5, SIZE - 1.0]],),
        "hole": ([[24.5, 5.0], [24.5, 17.0]], [[24.5, 31.0], [24.5, 43.0]]),
        "islands": ([[12.5, 16.0], [12.5, 32.0]],),
    }[name]
    tracker = SurfaceTracker(normal_map, depth_map, CAMERA, TrackingOptions(), [np.array(s) for s in seams])
    start = np.array(tracker.state.vertices_in_camera)
    for _ in range(2):
        tracked = tracker.step(normal_map, depth_map)
    assert np.isfinite(tracked.vertices_in_camera).all()
    assert np.abs(tracked.vertices_in_camera - start).max() < 0.5

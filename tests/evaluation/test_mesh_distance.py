import numpy as np
import pytest

from vntoolkit.errors import BadMesh
from vntoolkit.evaluation.mesh_comparison import (
    mesh_distance,
    mesh_quality,
    mismatch,
    triangle_aspects,
    vertex_distances,
)
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.options.evaluation import MeasuredBy


def sphere(radius: float, resolution: int = 60) -> Mesh:
    open3d = pytest.importorskip("open3d")
    return Mesh.from_open3d(open3d.geometry.TriangleMesh.create_sphere(radius, resolution))


def grid(height: float = 0.0, size: int = 5, first_row: int = 0) -> Mesh:
    v, u = np.mgrid[first_row:size, :size]
    index = np.arange(u.size).reshape(u.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    points = np.stack([u, v, np.full(u.shape, height)], axis=-1).reshape(-1, 3).astype(float)
    return Mesh(vertices=points, faces=faces)


def test_concentric_spheres_are_as_far_apart_as_their_radii() -> None:
    distance = mesh_distance(sphere(1.0), sphere(1.1))
    assert distance.mean == pytest.approx(0.1, rel=0.01)  # facets of 3 degrees lie 0.0014 inside the sphere
    assert distance.hausdorff == pytest.approx(0.1, rel=0.02)
    assert distance.diagonal == pytest.approx(2.2 * np.sqrt(3), rel=1e-3)
    assert distance.mean_percent == pytest.approx(100 * distance.mean / distance.diagonal)


def test_the_two_ways_differ_where_one_mesh_lacks_a_part() -> None:
    whole, part = grid(), grid(first_row=3)
    distance = mesh_distance(part, whole)
    assert distance.to_reference.largest == 0
    assert distance.from_reference.largest == pytest.approx(3)
    assert distance.hausdorff == pytest.approx(3)


def test_samples_far_away_count_too() -> None:
    assert mesh_distance(grid(height=1000.0), grid()).mean == pytest.approx(1000)


def test_quality_of_a_clean_grid_and_of_a_broken_one() -> None:
    clean = mesh_quality(grid())
    assert (clean.pieces, clean.holes, clean.boundary_edges) == (1, 1, 16)
    assert clean.non_manifold_edges == clean.self_intersecting_faces == clean.isolated_vertices == 0
    assert clean.median_aspect == pytest.approx(np.sqrt(2) * (2 + np.sqrt(2)) / (2 * np.sqrt(3)))

    vertices = np.vstack([grid().vertices, [[0.5, 0.1, -1], [0.5, 0.4, 1], [0.6, 0.2, 1], [9, 9, 9]]])
    pierced = Mesh(vertices=vertices, faces=np.vstack([grid().faces, [[25, 26, 27]]]))
    broken = mesh_quality(pierced)
    assert broken.self_intersecting_faces >= 2
    assert (broken.pieces, broken.isolated_vertices) == (2, 1)


def test_an_equilateral_triangle_has_aspect_one() -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0.5, np.sqrt(3) / 2, 0]])
    assert triangle_aspects(Mesh(vertices=corners, faces=[[0, 1, 2]]))[0] == pytest.approx(1)
    for no_area in ([1, 0, 0], [0, 0, 0]):
        degenerate = Mesh(vertices=corners * no_area, faces=[[0, 1, 2]])
        assert np.isinf(triangle_aspects(degenerate)[0])


def test_distances_far_off_and_of_other_scales_are_exact() -> None:
    for other in (grid(height=1e6), grid().with_vertices(1e-4 * grid().vertices + [0, 0, 50.0])):
        nearest = np.linalg.norm(grid().vertices[:, None] - other.vertices, axis=2).min(axis=1)
        assert vertex_distances(grid(), other) == pytest.approx(nearest, rel=1e-5)
        assert "are they in one frame and one unit?" in mismatch(grid(), other)
    assert mismatch(grid(), grid(height=3.0)) == ""


def test_pymeshlab_measures_the_same_and_refuses_what_it_would_search_for_minutes() -> None:
    by_embree, by_pymeshlab = (vertex_distances(sphere(1.0), sphere(1.3, 40), by) for by in MeasuredBy)
    np.testing.assert_allclose(by_embree, by_pymeshlab, atol=1e-6)
    one_point = Mesh(vertices=np.ones((3, 3)), faces=[[0, 1, 2]])
    for first, second in ((one_point, grid()), (grid(), grid(height=1e4))):
        with pytest.raises(BadMesh, match=r"one frame and one unit.*measure by embree"):
            vertex_distances(first, second, MeasuredBy.PYMESHLAB)


def test_a_cloud_is_as_far_as_its_nearest_points() -> None:
    cloud = PointCloud(points=grid().vertices)
    assert mesh_distance(grid(height=0.25), cloud).mean == pytest.approx(0.25)
    off = PointCloud(points=grid().vertices + np.array([0.5, 0.5, 0.0]))  # amid the quads, so on the faces
    assert vertex_distances(off, grid(size=7)).max() == pytest.approx(0.0, abs=1e-6)
    assert vertex_distances(off, PointCloud(points=grid(size=7).vertices)) == pytest.approx(np.sqrt(0.5))


def test_meshes_without_faces_are_refused() -> None:
    points = Mesh(vertices=np.zeros((3, 3)), faces=np.zeros((0, 3), int))
    with pytest.raises(BadMesh, match="reference mesh: no triangle"):
        mesh_distance(grid(), points)
    with pytest.raises(BadMesh, match="all its vertices lie in one point"):
        mesh_distance(grid(), Mesh(vertices=np.ones((3, 3)), faces=[[0, 1, 2]]))
    with pytest.raises(BadMesh, match="no triangle to judge"):
        mesh_quality(points)

import numpy as np
import pytest

from vntoolkit.geometry.mesh import Mesh, MeshSequence, vertex_normals
from vntoolkit.geometry.point_cloud import PointCloud

# A tetrahedron whose triangles are counter-clockwise from outside.
VERTICES = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.fixture
def tetrahedron(rng: np.random.Generator) -> Mesh:
    return Mesh(
        vertices=VERTICES,
        faces=FACES,
        normals=vertex_normals(VERTICES, FACES),
        colours=(rng.integers(0, 256, (4, 3)) / 255).astype(np.float32),
    )


def test_vertex_normals_point_out() -> None:
    outwards = VERTICES - VERTICES.mean(axis=0)
    assert np.all(np.sum(vertex_normals(VERTICES, FACES) * outwards, axis=1) > 0)


def test_a_vertex_without_triangle_has_no_normal() -> None:
    lonely = np.vstack([VERTICES, [[9.0, 9, 9]]])
    np.testing.assert_array_equal(vertex_normals(lonely, FACES)[4], 0)


@pytest.mark.parametrize("library", ["open3d", "pymeshlab"])
def test_mesh_round_trip(tetrahedron: Mesh, library: str) -> None:
    native = getattr(tetrahedron, f"to_{library}")()
    again = getattr(Mesh, f"from_{library}")(native)
    np.testing.assert_array_equal(again.faces, tetrahedron.faces)
    np.testing.assert_allclose(again.vertices, tetrahedron.vertices)
    np.testing.assert_allclose(again.normals, tetrahedron.normals)
    np.testing.assert_allclose(again.colours, tetrahedron.colours, atol=1e-6)


def test_point_cloud_round_trip(tetrahedron: Mesh) -> None:
    cloud = PointCloud(points=tetrahedron.vertices, normals=tetrahedron.normals, colours=tetrahedron.colours)
    again = PointCloud.from_pymeshlab(cloud.to_pymeshlab())
    np.testing.assert_allclose(again.points, cloud.points)
    np.testing.assert_allclose(again.normals, cloud.normals)
    np.testing.assert_allclose(again.colours, cloud.colours, atol=1e-6)


def test_moving_a_mesh_turns_its_normals(tetrahedron: Mesh) -> None:
    half_turn = VERTICES * [-1, -1, 1]
    np.testing.assert_allclose(
        tetrahedron.with_vertices(half_turn).normals, tetrahedron.normals * [-1, -1, 1]
    )


def test_sequence_gives_meshes(tetrahedron: Mesh) -> None:
    moving = np.stack([VERTICES, VERTICES + 1])
    sequence = MeshSequence(template=tetrahedron, vertices=moving, frame_rate_hz=30)
    assert len(sequence) == 2
    np.testing.assert_array_equal(sequence[1].vertices, VERTICES + 1)
    assert [mesh.diagonal for mesh in sequence] == pytest.approx([np.sqrt(3)] * 2)

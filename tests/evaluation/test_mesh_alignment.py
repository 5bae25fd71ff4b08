import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vntoolkit.errors import BadMesh, SolverFailed
from vntoolkit.evaluation.mesh_comparison import align_mesh, mesh_distance, vertex_distances
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.options.evaluation import Alignment

SIMILARITY = Alignment.SIMILARITY


def relief(height: float = 1.0, size: int = 60) -> Mesh:
    v, u = np.mgrid[:size, :size] / size
    z = height * 0.15 * (np.sin(7 * u) * np.cos(5 * v) + 0.5 * np.sin(11 * u + 6 * v)) + 5
    index = np.arange(u.size).reshape(u.shape)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    faces = np.concatenate([np.stack([a, c, b], -1).reshape(-1, 3), np.stack([b, c, d], -1).reshape(-1, 3)])
    return Mesh(vertices=np.stack([u, v, z], axis=-1).reshape(-1, 3), faces=faces)


def moved(mesh: Mesh, scale: float) -> Mesh:
    rotation = Rotation.from_rotvec([0.05, -0.03, 0.04]).as_matrix()
    middle = mesh.vertices.mean(axis=0)
    return mesh.with_vertices(scale * (mesh.vertices - middle) @ rotation.T + middle + [0.02, -0.01, 0.03])


@pytest.mark.parametrize(("free", "scale"), [(Alignment.RIGID, 1.0), (Alignment.SIMILARITY, 1.06)])
def test_a_known_motion_is_undone(free: Alignment, scale: float, rng: np.random.Generator) -> None:
    mesh = relief()
    aligned, motion = align_mesh(moved(mesh, scale), mesh, rng, free)
    assert motion.scale == pytest.approx(1 / scale, rel=1e-3)
    assert np.abs(aligned.vertices - mesh.vertices).max() < 2e-3


def test_rigid_leaves_the_scale_and_none_leaves_everything(rng: np.random.Generator) -> None:
    mesh = relief()
    larger = moved(mesh, 1.06)
    _, rigid = align_mesh(larger, mesh, rng, Alignment.RIGID)
    same, _ = align_mesh(larger, mesh, rng, Alignment.NONE)
    assert rigid.scale == 1.0
    assert np.array_equal(same.vertices, larger.vertices)


def test_alignment_does_not_hide_another_shape(rng: np.random.Generator) -> None:
    flatter = relief(height=0.7)
    aligned, _ = align_mesh(flatter, relief(), rng, SIMILARITY)
    assert mesh_distance(aligned, relief()).mean_percent > 0.5


def test_distances_per_vertex_agree_with_their_mean() -> None:
    mesh, other = relief(), relief(height=1.2)
    assert vertex_distances(mesh, other).mean() == pytest.approx(
        mesh_distance(mesh, other).to_reference.mean, rel=1e-4
    )


def test_refusals(rng: np.random.Generator) -> None:
    points = Mesh(vertices=relief().vertices, faces=np.zeros((0, 3), int))
    with pytest.raises(BadMesh, match="reference mesh: has neither faces nor normals"):
        align_mesh(relief(), points, rng, SIMILARITY)
    for scale, shift in ((1000.0, 0.0), (1.0, 5.0)):  # of another unit, and far away
        with pytest.raises(BadMesh, match=r"align: one is .* are they in one frame and one unit"):
            align_mesh(relief().with_vertices(scale * relief().vertices + shift), relief(), rng, SIMILARITY)
    with pytest.raises(BadMesh, match="no triangle, so there is no surface"):
        vertex_distances(points, relief())
    one_point = relief().with_vertices(np.ones_like(relief().vertices))
    with pytest.raises(SolverFailed, match="lie in one point"):
        align_mesh(one_point, relief(), rng, SIMILARITY)
    with pytest.raises(SolverFailed, match="slide on each other"):
        align_mesh(relief(height=0.0), relief(height=0.0), rng, SIMILARITY)

"""One surface laid on another: the rigid motion, and the scale of depth, that reconstructions leave free.

Iterated closest points with distances to tangent planes (chen1992): each round pairs vertices with the
nearest ones of the reference and solves six or seven linear unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import Matrix3, Points, Vector3
from vntoolkit.errors import BadInput, BadMesh, SolverFailed
from vntoolkit.geometry.mesh import Mesh, vertex_normals

_FEWEST_VERTICES = 20


class Alignment(Enum):
    """What is free between two meshes."""

    NONE = "none"
    RIGID = "rigid"
    SIMILARITY = "similarity"  # and one scale: that of a perspective camera's depth


@dataclass(frozen=True, kw_only=True)
class AlignmentOptions:
    """How meshes are aligned.

    free: what may move: nothing, position and orientation (rigid), or the scale too (similarity).
    kept_share: share of the nearest pairs that count, 0 to 1; the others have no counterpart. rounds: largest
    number of repetitions. samples: vertices that are paired.
    """

    free: Alignment = Alignment.NONE
    kept_share: float = 0.95
    rounds: int = 60
    samples: int = 20000

    def __post_init__(self) -> None:
        """Refuse what leaves nothing to align by."""
        if not 0 < self.kept_share <= 1:
            raise BadInput(f"alignment: expected a share of pairs from 0 to 1, got {self.kept_share:g}")
        if self.rounds < 1 or self.samples < 3:
            raise BadInput("alignment: expected at least one round and 3 samples")


@dataclass(frozen=True, kw_only=True, eq=False)
class Similarity:
    """x_in_reference = scale · rotation @ x + translation."""

    scale: float = 1.0
    rotation: Matrix3
    translation: Vector3

    def apply(self, points: Points) -> Points:
        """Move points (n, 3)."""
        return self.scale * np.asarray(points) @ self.rotation.T + self.translation


def align_mesh(
    mesh: Mesh, reference: Mesh, rng: np.random.Generator, options: AlignmentOptions | None = None
) -> tuple[Mesh, Similarity]:
    """Move a mesh onto the reference, near to which it must lie; the reference stays.

    Raises `BadMesh` for a mesh without faces or with too few vertices, `SolverFailed` where the surfaces
    leave the motion undetermined.
    """
    options = options or AlignmentOptions()
    for name, each in (("mesh", mesh), ("reference mesh", reference)):
        if not len(each.faces) or len(each.vertices) < _FEWEST_VERTICES:
            raise BadMesh(
                f"{name}: {len(each.vertices)} vertices and {len(each.faces)} faces are too few to align by"
            )
    motion = Similarity(rotation=np.eye(3), translation=np.zeros(3))
    if options.free is Alignment.NONE:
        return mesh, motion
    targets = np.asarray(reference.vertices, dtype=np.float64)
    normals, tree = vertex_normals(targets, reference.faces), cKDTree(targets)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    sampled = vertices[rng.permutation(len(vertices))[: options.samples]]
    last = np.inf
    for _ in range(options.rounds):
        moved = motion.apply(sampled)
        distances, nearest = tree.query(moved)
        kept = distances <= np.quantile(distances, options.kept_share)
        step = _step(moved[kept], targets[nearest[kept]], normals[nearest[kept]], options.free)
        motion = _after(step, motion)
        cost = float(distances[kept].mean())
        if abs(last - cost) <= 1e-7 * cost:
            break
        last = cost
    return mesh.with_vertices(motion.apply(vertices)), motion


def _step(points: Points, targets: Points, normals: Points, free: Alignment) -> Similarity:
    """Small motion about the points' centre that takes them to the tangent planes of their targets."""
    centre = points.mean(axis=0)
    from_centre = points - centre
    size = float(np.sqrt((from_centre**2).sum(axis=1).mean()))
    if not size > 0:
        raise SolverFailed("align: all vertices of the mesh lie in one point")
    rows = np.column_stack([np.cross(from_centre / size, normals), normals])
    if free is Alignment.SIMILARITY:
        rows = np.column_stack([rows, ((from_centre / size) * normals).sum(axis=1)])
    values = ((targets - points) * normals).sum(axis=1)
    solution, _, rank, _ = np.linalg.lstsq(rows, values, rcond=1e-9)
    if rank < rows.shape[1] or not np.isfinite(solution).all():
        raise SolverFailed("align: the surfaces slide on each other (flat, or surfaces of revolution)")
    rotation = Rotation.from_rotvec(solution[:3] / size).as_matrix()
    scale = 1.0 + (float(solution[6]) / size if free is Alignment.SIMILARITY else 0.0)
    return Similarity(
        scale=scale, rotation=rotation, translation=centre + solution[3:6] - scale * rotation @ centre
    )


def _after(step: Similarity, before: Similarity) -> Similarity:
    """The motion that does `before` and then `step`."""
    return Similarity(
        scale=step.scale * before.scale,
        rotation=step.rotation @ before.rotation,
        translation=step.scale * step.rotation @ before.translation + step.translation,
    )

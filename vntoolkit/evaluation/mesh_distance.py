"""Distance between two surfaces, measured by pymeshlab from the vertices of one to the faces of the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_pymeshlab

_FARTHEST = 1000.0  # times the size of the smaller mesh: beyond it distances say nothing of shape


@dataclass(frozen=True, kw_only=True)
class OneWayDistance:
    """Distances from the vertices of one mesh to the nearest point of another, in its length unit."""

    mean: float
    root_mean_square: float
    largest: float
    samples: int


@dataclass(frozen=True, kw_only=True)
class MeshDistance:
    """Distances both ways.

    diagonal: of the reference's bounding box. mean: the larger of the two mean distances, the value to
    quote. hausdorff: the larger of the two largest distances. *_percent: of the diagonal.
    """

    to_reference: OneWayDistance
    from_reference: OneWayDistance
    diagonal: float

    @property
    def mean(self) -> float:
        """The larger mean of the two ways."""
        return max(self.to_reference.mean, self.from_reference.mean)

    @property
    def hausdorff(self) -> float:
        """The larger maximum of the two ways."""
        return max(self.to_reference.largest, self.from_reference.largest)

    @property
    def mean_percent(self) -> float:
        """`mean` in percent of the reference's diagonal."""
        return 100.0 * self.mean / self.diagonal

    @property
    def hausdorff_percent(self) -> float:
        """`hausdorff` in percent of the reference's diagonal."""
        return 100.0 * self.hausdorff / self.diagonal


def mesh_distance(mesh: Mesh, reference: Mesh) -> MeshDistance:
    """Measure the distance between two meshes in one frame.

    Raises `BadMesh` for a mesh without faces, and for meshes too far apart for their sizes.
    """
    require_comparable(mesh, reference)
    meshes = import_pymeshlab().MeshSet(verbose=False)
    meshes.add_mesh(mesh.to_pymeshlab())
    meshes.add_mesh(reference.to_pymeshlab())
    return MeshDistance(
        to_reference=_one_way(meshes, 0, 1),
        from_reference=_one_way(meshes, 1, 0),
        diagonal=reference.diagonal,
    )


def require_comparable(mesh: Mesh, reference: Mesh) -> None:
    """Raise `BadMesh` unless both have faces and sizes that suit their distance.

    pymeshlab looks for the nearest face in steps as small as the mesh that it searches: for one that is a
    point it would never end.
    """
    for name, each in (("mesh", mesh), ("reference mesh", reference)):
        if not len(each.faces):
            raise BadMesh(f"{name}: no triangle, so there is no surface to measure the distance to")
    corners = np.stack([pick(m.vertices, axis=0) for m in (mesh, reference) for pick in (np.min, np.max)])
    reach = float(np.linalg.norm(np.ptp(corners, axis=0)))
    if not 0 < reach <= _FARTHEST * min(mesh.diagonal, reference.diagonal):
        raise BadMesh(
            f"meshes: one is {mesh.diagonal:.3g} across, the reference {reference.diagonal:.3g}, both "
            f"together {reach:.3g}, which is too far apart to compare: are they in one frame and one unit?"
        )


def _one_way(meshes: object, sampled: int, target: int) -> OneWayDistance:
    unlimited = import_pymeshlab().PureValue(float("inf"))  # the default ignores far samples
    found = meshes.get_hausdorff_distance(  # type: ignore[attr-defined]
        sampledmesh=sampled, targetmesh=target, samplevert=True, maxdist=unlimited
    )
    return OneWayDistance(
        mean=found["mean"], root_mean_square=found["RMS"], largest=found["max"], samples=found["n_samples"]
    )

"""Distance between two surfaces, measured by pymeshlab from the vertices of one to the faces of the other."""

from __future__ import annotations

from dataclasses import dataclass

from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_pymeshlab


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
    """Measure the distance between two meshes in one frame; raises `BadMesh` for a mesh without faces."""
    for name, each in (("mesh", mesh), ("reference mesh", reference)):
        if not len(each.faces):
            raise BadMesh(f"{name}: no triangle, so there is no surface to measure the distance to")
    meshes = import_pymeshlab().MeshSet(verbose=False)
    meshes.add_mesh(mesh.to_pymeshlab())
    meshes.add_mesh(reference.to_pymeshlab())
    return MeshDistance(
        to_reference=_one_way(meshes, 0, 1),
        from_reference=_one_way(meshes, 1, 0),
        diagonal=reference.diagonal,
    )


def _one_way(meshes: object, sampled: int, target: int) -> OneWayDistance:
    unlimited = import_pymeshlab().PureValue(float("inf"))  # the default ignores far samples
    found = meshes.get_hausdorff_distance(  # type: ignore[attr-defined]
        sampledmesh=sampled, targetmesh=target, samplevert=True, maxdist=unlimited
    )
    return OneWayDistance(
        mean=found["mean"], root_mean_square=found["RMS"], largest=found["max"], samples=found["n_samples"]
    )

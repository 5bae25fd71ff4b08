"""The distance of every vertex of one mesh from the surface of another."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.evaluation.mesh_distance import require_comparable
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_pymeshlab


def vertex_distances(mesh: Mesh, reference: Mesh) -> FloatArray:
    """Return (n,) distances, measured by pymeshlab; raises `BadMesh` as `mesh_distance` does."""
    require_comparable(mesh, reference)
    pymeshlab = import_pymeshlab()
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(mesh.to_pymeshlab())
    meshes.add_mesh(reference.to_pymeshlab())
    meshes.compute_scalar_by_distance_from_another_mesh_per_vertex(
        measuremesh=0, refmesh=1, signeddist=False, maxdist=pymeshlab.PureValue(float("inf"))
    )
    return np.abs(np.array(meshes.mesh(0).vertex_scalar_array()))

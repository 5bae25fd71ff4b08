"""What a mesh's next user stumbles over: slivers, non-manifold edges, holes, self-intersections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_pymeshlab


@dataclass(frozen=True, kw_only=True)
class MeshQuality:
    """Counts and shapes.

    median_aspect, worst_aspect: longest edge over twice √3 times the inscribed circle's radius: 1 for an
    equilateral triangle, infinite for a degenerate one. pieces: connected components. holes: boundary loops.
    """

    vertices: int
    faces: int
    pieces: int
    holes: int
    boundary_edges: int
    non_manifold_edges: int
    non_manifold_vertices: int
    isolated_vertices: int
    self_intersecting_faces: int
    median_aspect: float
    worst_aspect: float


def mesh_quality(mesh: Mesh) -> MeshQuality:
    """Measure a mesh; raises `BadMesh` where it has no triangle."""
    if not len(mesh.faces):
        raise BadMesh("mesh: no triangle to judge")
    meshes = import_pymeshlab().MeshSet(verbose=False)
    meshes.add_mesh(mesh.to_pymeshlab())
    topology = meshes.get_topological_measures()
    meshes.compute_selection_by_self_intersections_per_face()
    aspect = triangle_aspects(mesh)
    return MeshQuality(
        vertices=len(mesh.vertices),
        faces=len(mesh.faces),
        pieces=topology["connected_components_number"],
        holes=topology["number_holes"],  # -1 where non-manifold edges leave it undefined
        boundary_edges=topology["boundary_edges"],
        non_manifold_edges=topology["non_two_manifold_edges"],
        non_manifold_vertices=topology["non_two_manifold_vertices"],
        isolated_vertices=topology["unreferenced_vertices"],
        self_intersecting_faces=meshes.current_mesh().selected_face_number(),
        median_aspect=float(np.median(aspect)),
        worst_aspect=float(aspect.max()),
    )


def triangle_aspects(mesh: Mesh) -> FloatArray:
    """Return (m,) longest edge / (2√3 · inradius) of each triangle."""
    corners = np.asarray(mesh.vertices, dtype=np.float64)[mesh.faces]
    edges = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    double_area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    perimeter, longest = edges.sum(axis=1), edges.max(axis=1)
    infinite = np.full(len(edges), np.inf)
    return np.divide(
        longest * perimeter, 2.0 * np.sqrt(3.0) * double_area, out=infinite, where=double_area > 0
    )

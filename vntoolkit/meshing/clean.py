"""Mesh cleaning by pymeshlab: removes small pieces, closes small holes, reduces triangles on request."""

from dataclasses import dataclass

from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_pymeshlab


@dataclass(frozen=True, kw_only=True)
class CleanOptions:
    """What to clean.

    smallest_piece: connected pieces with fewer triangles are removed; 0 for none. largest_hole: holes with at
    most this many boundary edges are closed; 0 for none. most_faces: reduce to this many triangles by quadric
    edge collapse; default: keep all.
    """

    smallest_piece: int = 100
    largest_hole: int = 30
    most_faces: int | None = None

    def __post_init__(self) -> None:
        if min(self.smallest_piece, self.largest_hole) < 0:
            raise BadInput("cleaning: expected smallest piece and largest hole of 0 or more")
        if self.most_faces is not None and self.most_faces < 1:
            raise BadInput(f"cleaning: expected at least one triangle to remain, got {self.most_faces}")


def clean_mesh(mesh: Mesh, options: CleanOptions | None = None) -> Mesh:
    """Return a cleaned copy with area-weighted normals; texture coordinates do not survive.

    Raises `BadMesh` where the mesh has no triangle, or none is left.
    """
    options = options or CleanOptions()
    if not len(mesh.faces):
        raise BadMesh("mesh: no triangle to clean")
    meshes = import_pymeshlab().MeshSet(verbose=False)
    meshes.add_mesh(mesh.to_pymeshlab())
    if options.smallest_piece:
        meshes.meshing_remove_connected_component_by_face_number(mincomponentsize=options.smallest_piece)
    if not meshes.current_mesh().face_number():
        raise BadMesh(f"mesh: every piece has fewer than {options.smallest_piece} triangles, none is left")
    if options.largest_hole:
        # holes can only be closed along two-manifold edges
        meshes.meshing_repair_non_manifold_edges()
        meshes.meshing_close_holes(maxholesize=options.largest_hole)
    if options.most_faces is not None and meshes.current_mesh().face_number() > options.most_faces:
        # what closed a hole is selected, and a selection alone would be reduced
        meshes.meshing_decimation_quadric_edge_collapse(
            targetfacenum=options.most_faces, preservenormal=True, preserveboundary=True, selected=False
        )
    meshes.meshing_remove_unreferenced_vertices()
    return Mesh.from_pymeshlab(meshes.current_mesh())

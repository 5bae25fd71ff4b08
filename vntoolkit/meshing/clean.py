"""Mesh cleaning by pymeshlab: removes small pieces, closes small holes, reduces triangles on request."""

from vntoolkit.errors import BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.libraries import import_pymeshlab
from vntoolkit.options.export import CleanOptions


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

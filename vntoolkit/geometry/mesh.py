"""Triangle meshes, and their conversion to and from Open3D and pymeshlab."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Colours, Faces, FloatArray, Points, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.display import Displayed, Facts, Picture, picture_of_points
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.point_cloud import rgba_from_rgb
from vntoolkit.native import import_open3d, import_pymeshlab

if TYPE_CHECKING:
    import open3d as o3d
    import pymeshlab


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Mesh(Displayed):
    """A triangle mesh.

    vertices: (n, 3) in the camera frame unless named otherwise. faces: (m, 3) int32, counter-clockwise
    from outside. normals: (n, 3) unit vertex normals or None. colours: (n, 3) float32 RGB 0 to 1 or None.
    uv: (n, 2) texture coordinates, (0, 0) at the bottom left of the texture (OBJ's), or None. error_deg: (n,)
    float32, angle in degrees that nine of ten normals stay within, or None.
    """

    vertices: Points
    faces: Faces
    normals: Points | None = None
    colours: Colours | None = None
    uv: FloatArray | None = None
    error_deg: FloatArray | None = None

    def __post_init__(self) -> None:
        vertices = np.asarray(self.vertices)
        faces = np.asarray(self.faces)
        require_shape(vertices, (None, 3), "vertices", BadMesh)
        require_finite(vertices, "vertices", BadMesh)
        require_shape(faces, (None, 3), "faces", BadMesh)
        if faces.size and not (faces.min() >= 0 and faces.max() < len(vertices)):
            raise BadMesh(f"faces: an index lies outside the {len(vertices)} vertices")
        object.__setattr__(self, "vertices", read_only(vertices))
        object.__setattr__(self, "faces", read_only(faces.astype(np.int32, copy=False)))
        for name, width in (("normals", (3,)), ("colours", (3,)), ("uv", (2,)), ("error_deg", ())):
            if getattr(self, name) is not None:
                values = np.asarray(getattr(self, name))
                require_shape(values, (len(vertices), *width), name, BadMesh)
                require_finite(values, name, BadMesh)
                object.__setattr__(self, name, read_only(values))

    def with_vertices(self, vertices: Points) -> Mesh:
        """Return the same topology at other positions, normals recomputed if there were any."""
        normals = None if self.normals is None else vertex_normals(vertices, self.faces)
        return replace(self, vertices=vertices, normals=normals)

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0))) if len(self.vertices) else 0.0

    def _facts(self) -> Facts:
        has = [name for name in ("normals", "colours", "uv") if getattr(self, name) is not None]
        return {
            "vertices": str(len(self.vertices)),
            "faces": str(len(self.faces)),
            "diagonal": f"{self.diagonal:.4g}",
            "has": " ".join(has) or "no more",
        }

    def _picture(self) -> Picture:
        normals = self.normals
        if normals is None and len(self.faces):
            normals = vertex_normals(self.vertices, self.faces)
        return picture_of_points(self.vertices, normals)

    def to_open3d(self) -> o3d.geometry.TriangleMesh:
        """Return a copy as an Open3D triangle mesh (without texture coordinates)."""
        o3d = import_open3d()
        mesh = o3d.geometry.TriangleMesh(
            o3d.utility.Vector3dVector(np.array(self.vertices, dtype=np.float64)),
            o3d.utility.Vector3iVector(np.array(self.faces)),
        )
        if self.normals is not None:
            mesh.vertex_normals = o3d.utility.Vector3dVector(np.array(self.normals, dtype=np.float64))
        if self.colours is not None:
            mesh.vertex_colors = o3d.utility.Vector3dVector(np.array(self.colours, dtype=np.float64))
        return mesh

    @classmethod
    def from_open3d(cls, mesh: o3d.geometry.TriangleMesh) -> Mesh:
        """Copy an Open3D triangle mesh."""
        return cls(
            vertices=np.array(mesh.vertices),
            faces=np.array(mesh.triangles, dtype=np.int32).reshape(-1, 3),
            normals=np.array(mesh.vertex_normals) if mesh.has_vertex_normals() else None,
            colours=np.array(mesh.vertex_colors, dtype=np.float32) if mesh.has_vertex_colors() else None,
        )

    def to_pymeshlab(self) -> pymeshlab.Mesh:
        """Return a copy as a pymeshlab mesh (without texture coordinates).

        pymeshlab replaces the normals of a mesh with faces by its own, so none are passed.
        """
        extra: dict[str, Any] = {}
        if self.colours is not None:
            extra["v_color_matrix"] = rgba_from_rgb(self.colours)
        if self.error_deg is not None:
            extra["v_scalar_array"] = self.error_deg.astype(np.float64)  # MeshLab's quality
        vertices = np.array(self.vertices, dtype=np.float64)
        return import_pymeshlab().Mesh(vertex_matrix=vertices, face_matrix=np.array(self.faces), **extra)

    @classmethod
    def from_pymeshlab(cls, mesh: pymeshlab.Mesh) -> Mesh:
        """Copy a pymeshlab mesh; its normals become unit vectors, weighted by area."""
        vertices = np.array(mesh.vertex_matrix())
        faces = np.array(mesh.face_matrix(), dtype=np.int32).reshape(-1, 3)
        return cls(
            vertices=vertices,
            faces=faces,
            normals=vertex_normals(vertices, faces),
            colours=np.array(mesh.vertex_color_matrix()[:, :3], dtype=np.float32)
            if mesh.has_vertex_color()
            else None,
        )


def face_normals(vertices: Points, faces: Faces) -> Points:
    """Return (m, 3) face normals whose length is twice the triangle's area."""
    a, b, c = (np.asarray(vertices)[faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def vertex_normals(vertices: Points, faces: Faces) -> Points:
    """Return (n, 3) unit vertex normals, area-weighted; 0 at vertices without a triangle."""
    normals = np.zeros((len(vertices), 3))
    with np.errstate(over="ignore", invalid="ignore"):  # of coordinates near float's limit: `Mesh` refuses
        per_face = face_normals(vertices, faces)
        for axis in range(3):
            for corner in range(3):
                normals[:, axis] += np.bincount(faces[:, corner], per_face[:, axis], minlength=len(vertices))
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)


def isosurface(values: FloatArray) -> tuple[Points, Faces]:
    """Return the zero surface of a grid (nx, ny, nz), positive inside, by marching cubes (lorensen1987).

    Vertices (n, 3) in cells, counted from the first value; faces (m, 3) counter-clockwise from outside. The
    surface is open where it leaves the grid.
    """
    o3d = import_open3d()
    field = o3d.core.Tensor(np.ascontiguousarray(values.transpose(2, 1, 0), dtype=np.float32))
    surface = o3d.t.geometry.TriangleMesh.create_isosurfaces(field, [0.0]).to_legacy()
    surface.remove_duplicated_vertices()
    surface.remove_degenerate_triangles()
    surface.remove_unreferenced_vertices()
    return np.asarray(surface.vertices), np.asarray(surface.triangles, dtype=np.int32)


def triangles_from_polygons(
    polygons: npt.NDArray[Any] | Sequence[npt.NDArray[Any]], vertex_count: int, name: str
) -> Faces:
    """Cut polygons into fans: an (m, k) array or a list of index arrays to (n, 3) int32.

    Raises `BadMesh` for fewer than three corners or an index outside the vertices.
    """
    if len(polygons) == 0:
        return np.empty((0, 3), dtype=np.int32)
    by_length: dict[int, list[npt.NDArray[Any]]] = {}
    if isinstance(polygons, np.ndarray):
        groups = {polygons.shape[1]: polygons}
    else:
        for polygon in polygons:
            by_length.setdefault(len(polygon), []).append(polygon)
        groups = {length: np.stack(group) for length, group in by_length.items()}
    triangles = []
    for length, group in groups.items():
        if length < 3:
            raise BadMesh(f"{name}: a face has {length} corners, expected at least 3")
        if not np.issubdtype(group.dtype, np.integer):
            raise BadMesh(f"{name}: a face's corners are numbers of vertices, got {group.dtype}")
        strange = group[(group < 0) | (group >= vertex_count)]
        if strange.size:
            raise BadMesh(f"{name}: a face names vertex {strange[0]}, there are {vertex_count}")
        fans = [group[:, [0, i, i + 1]] for i in range(1, length - 1)]
        triangles.append(np.stack(fans, axis=1).reshape(-1, 3))
    return np.concatenate(triangles).astype(np.int32)

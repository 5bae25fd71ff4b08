"""Triangle meshes, at rest and moving: their Laplacians, and conversion to and from Open3D and pymeshlab."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp

from vntoolkit.arrays import (
    Array,
    Colours,
    Faces,
    FloatArray,
    Int32Array,
    Int64Array,
    IntArray,
    Points,
    read_only,
)
from vntoolkit.checks import require_finite, require_shape, set_arrays
from vntoolkit.display import Displayed, Facts, Picture, picture_of_points
from vntoolkit.errors import BadMesh

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
        set_arrays(self, {"vertices": (None, 3)}, error=BadMesh)
        faces, count = np.asarray(self.faces), len(self.vertices)
        require_shape(faces, (None, 3), "faces", BadMesh)
        if faces.size and not (faces.min() >= 0 and faces.max() < count):
            raise BadMesh(f"faces: an index lies outside the {count} vertices")
        object.__setattr__(self, "faces", read_only(faces.astype(np.int32, copy=False)))
        shapes = {"normals": (count, 3), "colours": (count, 3), "uv": (count, 2), "error_deg": (count,)}
        set_arrays(self, shapes, error=BadMesh)

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
        from vntoolkit.libraries import import_open3d

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
        from vntoolkit.geometry.point_cloud import rgba_from_rgb
        from vntoolkit.libraries import import_pymeshlab

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
    from vntoolkit.libraries import import_open3d

    o3d = import_open3d()
    field = o3d.core.Tensor(np.ascontiguousarray(values.transpose(2, 1, 0), dtype=np.float32))
    surface = o3d.t.geometry.TriangleMesh.create_isosurfaces(field, [0.0]).to_legacy()
    surface.remove_duplicated_vertices()
    surface.remove_degenerate_triangles()
    surface.remove_unreferenced_vertices()
    return np.asarray(surface.vertices), np.asarray(surface.triangles, dtype=np.int32)


def triangles_from_polygons(polygons: Array | Sequence[Array], vertex_count: int, name: str) -> Faces:
    """Cut polygons into fans: an (m, k) array or a list of index arrays to (n, 3) int32.

    Raises `BadMesh` for fewer than three corners or an index outside the vertices.
    """
    if len(polygons) == 0:
        return np.empty((0, 3), dtype=np.int32)
    by_length: dict[int, list[Array]] = {}
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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MeshSequence(Displayed):
    """A moving mesh.

    template: topology, colours and texture coordinates. vertices: (frames, n, 3), possibly a memory map,
    so that a long sequence is read in slices. uncertainty_px: (frames, n) the error to expect of a
    vertex in the image, pixels, or None. frame_rate_hz: frames per second. times_s: (frames,) when each frame
    was filmed, rising; None for one every 1 / frame_rate_hz seconds.
    """

    template: Mesh
    vertices: FloatArray
    frame_rate_hz: float = 60.0
    times_s: FloatArray | None = None
    uncertainty_px: FloatArray | None = None

    def __post_init__(self) -> None:
        require_shape(self.vertices, (None, len(self.template.vertices), 3), "moving vertices", BadMesh)
        if not 0 < self.frame_rate_hz < np.inf:
            raise BadMesh(f"frame rate: expected a positive number, got {self.frame_rate_hz}")
        if self.times_s is not None:
            require_times(self.times_s, len(self.vertices), "times of a moving mesh")
            object.__setattr__(self, "times_s", read_only(self.times_s))
        object.__setattr__(self, "vertices", read_only(self.vertices))
        if self.uncertainty_px is not None:
            require_shape(self.uncertainty_px, self.vertices.shape[:2], "uncertainty in pixels", BadMesh)
            object.__setattr__(self, "uncertainty_px", read_only(self.uncertainty_px))

    def _facts(self) -> Facts:
        facts = {
            "frames": str(len(self)),
            "vertices": str(len(self.template.vertices)),
            "faces": str(len(self.template.faces)),
            "rate": f"{self.frame_rate_hz:g} Hz",
        }
        if self.uncertainty_px is not None and len(self):
            facts["expected error, last frame"] = f"{np.median(self.uncertainty_px[-1]):.2f} px"
        return facts

    def _picture(self) -> Picture | None:
        return self[0]._picture() if len(self) else None

    def __len__(self) -> int:
        return int(self.vertices.shape[0])

    @property
    def instants_s(self) -> FloatArray:
        """(frames,) seconds of each frame from the first."""
        if self.times_s is None:
            return np.arange(len(self)) / self.frame_rate_hz
        return np.asarray(self.times_s - self.times_s[:1])

    def require_finite(self, name: str) -> None:
        """Raise `BadMesh` for a frame with NaN or infinity; reads them one after the other."""
        for frame, vertices in enumerate(self.vertices):
            require_finite(vertices, f"{name}: frame {frame}", BadMesh)

    def __getitem__(self, frame: int) -> Mesh:
        """Return the mesh of one frame, read into memory."""
        return self.template.with_vertices(np.array(self.vertices[frame]))

    def __iter__(self) -> Iterator[Mesh]:
        return (self[frame] for frame in range(len(self)))


def require_times(times_s: FloatArray, count: int, name: str) -> None:
    """Raise `BadMesh` unless there is a finite time for each of `count` frames, and they rise."""
    require_shape(times_s, (count,), name, BadMesh)
    require_finite(times_s, name, BadMesh)
    if (np.diff(times_s) <= 0).any():
        raise BadMesh(f"{name}: expected seconds that rise from frame to frame")


_SMALLEST_SINE = 1e-9  # of a triangle's angle: below it the triangle has no area and its cotangent no value


def edges_from_faces(faces: Faces) -> Int32Array:
    """Return the (e, 2) undirected edges of the triangles, each once, lower index first, sorted."""
    corners = np.asarray(faces, dtype=np.int64)
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    pairs.sort(axis=1)
    width = int(pairs.max(initial=0)) + 1
    codes = np.unique(pairs[:, 0] * width + pairs[:, 1])
    return np.stack([codes // width, codes % width], axis=1).astype(np.int32)


def graph_laplacian(edges: IntArray, vertex_count: int, weights: FloatArray | None = None) -> sp.csr_array:
    """Return the (n, n) symmetric Laplacian of weighted edges: (L x)_i = Σ_j w_ij (x_i − x_j).

    edges: (e, 2), each once. weights: (e,) or None for 1. Rows sum to 0. float64.
    """
    weight = np.ones(len(edges)) if weights is None else np.asarray(weights, dtype=np.float64)
    first, second = np.asarray(edges, dtype=np.int64).reshape(-1, 2).T
    degree = np.bincount(first, weight, vertex_count) + np.bincount(second, weight, vertex_count)
    diagonal = np.arange(vertex_count)
    rows = np.concatenate([first, second, diagonal])
    columns = np.concatenate([second, first, diagonal])
    values = np.concatenate([-weight, -weight, degree])
    return sp.csr_array((values, (rows, columns)), shape=(vertex_count, vertex_count))


def factored(matrix: sp.sparray) -> Any:
    """Factor a symmetric matrix (n, n) without pivoting; all of its leading minors are regular."""
    from scipy.sparse.linalg import splu  # few runs need it

    return splu(
        sp.csc_array(matrix),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


def cotangent_laplacian(vertices: Points, faces: Faces) -> sp.csr_array:
    """Return the (n, n) cotangent Laplacian, w_ij = (cot a_ij + cot b_ij) / 2, symmetric.

    The stiffness matrix of linear elements, not divided by areas: it has no unit and keeps its value when
    the mesh is scaled. Zero in the interior of a plane, however it is triangulated. Raises BadMesh where a
    triangle has no area.
    """
    pairs, cosines, sines = edge_cotangents(vertices, faces)
    flat = sines <= _SMALLEST_SINE
    if flat.any():
        raise BadMesh(
            f"cotangent Laplacian: {int(flat.reshape(3, -1).any(axis=0).sum())} triangles have no area; use "
            "the uniform Laplacian"
        )
    return graph_laplacian(pairs, len(np.asarray(vertices)), 0.5 * cosines / sines)


def edge_cotangents(vertices: Points, faces: Faces) -> tuple[Int64Array, FloatArray, FloatArray]:
    """Return every triangle's edges (3 m, 2), lower index first, and cosine and sine of the angles opposite.

    Cosines and sines, (3 m,), are those of the first, of the second, then of the third corners; both are 0
    where a side has no length.
    """
    points = np.asarray(vertices, dtype=np.float64)
    pairs, cosines, sines = [], [], []
    for apex, left, right in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        to_left = points[faces[:, left]] - points[faces[:, apex]]
        to_right = points[faces[:, right]] - points[faces[:, apex]]
        lengths = np.linalg.norm(to_left, axis=1) * np.linalg.norm(to_right, axis=1)
        per_length = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
        pairs.append(np.sort(np.asarray(faces, dtype=np.int64)[:, [left, right]], axis=1))
        cosines.append(np.sum(to_left * to_right, axis=1) * per_length)
        sines.append(np.linalg.norm(np.cross(to_left, to_right), axis=1) * per_length)
    return np.concatenate(pairs), np.concatenate(cosines), np.concatenate(sines)

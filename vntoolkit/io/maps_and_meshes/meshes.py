"""Meshes and point clouds on disk: PLY, OBJ, STL. Camera frame in memory, graphics frame on disk."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array, ByteArray, Int64Array
from vntoolkit.checks import checks_kinds
from vntoolkit.errors import BadMesh, CannotWrite
from vntoolkit.geometry.mesh import Mesh, face_normals, triangles_from_polygons
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.io.atomic import write_bytes, write_text
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.files import require_mesh_file, require_vertices, text_lines
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.ply import read_ply, write_ply
from vntoolkit.options.export import MeshUpAxis


@checks_kinds
def write_mesh(
    path: Path | str,
    mesh: Mesh,
    *,
    texture: ByteArray | None = None,
    up: MeshUpAxis = MeshUpAxis.Y,
    material: str | None = None,
) -> None:
    """Write a mesh in the camera frame: `.ply`, `.stl` (binary, float32), `.obj` (texture `.png`).

    texture: (h, w, 3) uint8 RGB for an OBJ whose mesh has texture coordinates. Colours are stored as
    value·255, without a curve. up: the axis that points up in the file; `read_mesh` expects y. material: of
    an OBJ, the name of an .mtl beside it that `write_material` wrote, instead of a texture.
    """
    turned = _flip(mesh, up)
    match Path(path).suffix.lower():
        case ".ply":
            if texture is not None or material is not None:
                raise CannotWrite(f"{path}: a PLY carries no texture; write .obj, or give vertex colours")
            write_ply(
                path,
                turned.vertices,
                turned.faces,
                normals=turned.normals,
                colours=turned.colours,
                uv=turned.uv,
                quality=turned.error_deg,
                comment=up.meaning,
            )
        case ".obj":
            write_obj(path, turned, texture, up.meaning, material)
        case ".stl":
            write_stl(path, turned)
        case suffix:
            raise CannotWrite(f"{path}: a mesh is written as .ply, .obj or .stl, not '{suffix}'")


def read_mesh(path: Path | str) -> Mesh:
    """Read a triangle mesh from `.ply` or `.obj` into the camera frame; polygons are cut into triangles.

    One of more vertices than `reading_limits` allows is refused before it is read. Raises `BadMesh`.
    """
    require_mesh_file(path)
    match Path(path).suffix.lower():
        case ".ply":
            return _flip(read_ply(path))
        case ".obj":
            return _flip(read_obj(path))
        case suffix:
            raise BadMesh(f"{path}: a mesh is read from .ply or .obj, not '{suffix}'; export it as .ply")


def write_point_cloud(path: Path | str, cloud: PointCloud, *, up: MeshUpAxis = MeshUpAxis.Y) -> None:
    """Write a point cloud in the camera frame as binary `.ply`, in the axes of files."""
    if Path(path).suffix.lower() != ".ply":
        raise CannotWrite(f"{path}: a point cloud is written as .ply")
    normals = None if cloud.normals is None else graphics_from_camera(cloud.normals, up)
    write_ply(path, graphics_from_camera(cloud.points, up), normals=normals, colours=cloud.colours)


def _flip(mesh: Mesh, up: MeshUpAxis = MeshUpAxis.Y) -> Mesh:
    normals = None if mesh.normals is None else graphics_from_camera(mesh.normals, up)
    return replace(mesh, vertices=graphics_from_camera(mesh.vertices, up), normals=normals)


def write_obj(
    path: Path | str,
    mesh: Mesh,
    texture: ByteArray | None = None,
    comment: str = "x right, y up, z towards the viewer",
    material: str | None = None,
) -> None:
    """Write `v` (colours behind, as MeshLab does), `vt`, `vn`, `f`; NAME.mtl and NAME.png for a texture."""
    path = Path(path)
    lines = [f"# {comment}"]
    if texture is not None:
        if mesh.uv is None:
            raise BadMesh(f"{path}: a texture needs texture coordinates (uv) in the mesh")
        picture, material = path.with_suffix(".png"), f"{path.stem}.mtl"
        write_png(picture, texture)
        write_material(path.with_name(material), picture)
    if material is not None:
        lines += [f"mtllib {material}", "usemtl surface"]
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    if mesh.colours is not None:
        vertices = np.column_stack([vertices, mesh.colours])
    lines += _rows("v", vertices)
    if mesh.uv is not None:
        lines += _rows("vt", mesh.uv)
    if mesh.normals is not None:
        lines += _rows("vn", mesh.normals)
    corner = {(False, False): "{0}", (True, False): "{0}/{0}", (False, True): "{0}//{0}"}.get(
        (mesh.uv is not None, mesh.normals is not None), "{0}/{0}/{0}"
    )
    names = [corner.format(i) for i in range(1, len(vertices) + 1)]
    lines += [f"f {names[a]} {names[b]} {names[c]}" for a, b, c in mesh.faces.tolist()]
    write_text(path, "\n".join(lines) + "\n")


def write_stl(path: Path | str, mesh: Mesh) -> None:
    """Write the triangles of a mesh in the frame of files, each with its normal, as a binary STL."""
    kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.zeros(len(mesh.faces), kind)
    triangles["corners"] = mesh.vertices[mesh.faces]
    normals = face_normals(mesh.vertices, mesh.faces)
    triangles["normal"] = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    count = np.array([len(triangles)], "<u4")
    write_bytes(path, b"vntoolkit".ljust(80) + count.tobytes() + triangles.tobytes())


def write_material(path: Path | str, albedo: Path | None, normal: Path | None = None) -> None:
    """Write the `.mtl` of a matte surface with its textures, images beside it.

    normal: in tangent space, as `norm`, and as `map_Bump`, which is what Blender reads.
    """
    lines = ["newmtl surface", "Ka 0 0 0", "Kd 1 1 1", "Ks 0 0 0", "illum 1"]
    lines += [] if albedo is None else [f"map_Kd {albedo.name}"]
    lines += [] if normal is None else [f"norm {normal.name}", f"map_Bump -bm 1 {normal.name}"]
    write_text(path, "\n".join(lines) + "\n")


def read_obj(path: Path | str) -> Mesh:
    """Read an OBJ; corners that share a position but not its texture coordinate become vertices apart.

    Groups, materials, lines and curves are skipped. Raises `BadMesh` with the number of the bad line.
    """
    tables: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    polygons: list[list[tuple[int, int, int]]] = []
    for number, line in enumerate(text_lines(path, BadMesh), start=1):
        key, *words = line.split() or [""]
        try:
            if key in tables:
                tables[key].append([float(word) for word in words])
                require_vertices(len(tables[key]), str(path))
            elif key == "f" and not words:
                raise ValueError(key)
            elif key == "f":
                counts = (len(tables["v"]), len(tables["vt"]), len(tables["vn"]))
                polygons.append([_corner(word, counts) for word in words])
        except (ValueError, IndexError) as problem:
            raise BadMesh(f"{path}: line {number} is malformed: '{line[:60]}'") from problem
    if not tables["v"] or not polygons:
        raise BadMesh(f"{path}: holds no mesh (vertices and faces)")
    return _mesh(str(path), tables, polygons)


def _mesh(
    name: str, tables: dict[str, list[list[float]]], polygons: list[list[tuple[int, int, int]]]
) -> Mesh:
    corners = np.array([corner for polygon in polygons for corner in polygon], dtype=np.int64)
    kept, first, index = _vertices_of_corners(corners, len(tables["v"]), len(tables["vt"]))
    ends = np.cumsum([len(polygon) for polygon in polygons])[:-1]
    faces = triangles_from_polygons(np.split(index, ends), len(kept), name)
    try:
        v = np.array(tables["v"], dtype=np.float64)
        uv = np.array(tables["vt"])[kept[:, 1], :2] if (corners[:, 1] >= 0).all() else None
        vn = None
        if (corners[:, 2] >= 0).all():
            vn = np.zeros((len(kept), 3))
            vn[index[first]] = np.array(tables["vn"])[corners[first, 2]]
    except (IndexError, ValueError) as problem:
        raise BadMesh(f"{name}: rows of differing length") from problem
    if v.shape[1] not in (3, 4, 6, 7):
        raise BadMesh(f"{name}: a vertex has {v.shape[1]} numbers, expected x y z and perhaps r g b")
    with np.errstate(over="ignore"):  # a number beyond float's range becomes infinite, which `Mesh` refuses
        colours = v[kept[:, 0], -3:].astype(np.float32) if v.shape[1] >= 6 else None
    try:
        return Mesh(vertices=v[kept[:, 0], :3], faces=faces, normals=vn, colours=colours, uv=uv)
    except BadMesh as problem:
        raise BadMesh(f"{name}: {problem}") from problem


def _vertices_of_corners(
    corners: Int64Array, v_count: int, vt_count: int
) -> tuple[Int64Array, Int64Array, Int64Array]:
    """Return (position, texture coordinate) of each vertex, a corner of each used one, a vertex per corner.

    Where texture coordinates follow the positions one to one, as in our own files, every vertex keeps its
    place, used or not. A normal that differs per corner makes no new vertex: the first one seen wins.
    """
    has_uv = bool((corners[:, 1] >= 0).all())
    if not has_uv or (vt_count == v_count and (corners[:, 0] == corners[:, 1]).all()):
        every = np.arange(v_count)
        _, first = np.unique(corners[:, 0], return_index=True)
        return np.column_stack([every, every]), first, corners[:, 0]
    kept, first, index = np.unique(corners[:, :2], axis=0, return_index=True, return_inverse=True)
    return kept, first, index.ravel()


def _corner(word: str, counts: tuple[int, int, int]) -> tuple[int, int, int]:
    """Turn `v/vt/vn`, counted from 1 or backwards from the end, into indices; -1 for a part left out."""
    parts = [*word.split("/"), "", ""][:3]
    indices: list[int] = []
    for part, count in zip(parts, counts, strict=True):
        number = int(part) if part else 0
        index = number - 1 if number > 0 else count + number if number < 0 else -1
        if part and not 0 <= index < count:
            raise IndexError(word)
        if not part and not indices:
            raise ValueError(word)
        indices.append(index)
    return indices[0], indices[1], indices[2]


def _rows(key: str, values: Array) -> list[str]:
    return [f"{key} " + " ".join(f"{x:.7g}" for x in row) for row in np.asarray(values).tolist()]

"""Meshes and point clouds on disk, by suffix: PLY and OBJ. Camera frame in memory, graphics frame on disk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import BadMesh, CannotWrite
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.io.conventions import UpAxis, graphics_from_camera
from vntoolkit.io.limits import require_mesh_file
from vntoolkit.io.obj import read_obj, write_obj
from vntoolkit.io.ply import PlyContent, bytes_from_colours, read_ply, write_ply


def write_mesh(
    path: Path | str,
    mesh: Mesh,
    *,
    texture: npt.NDArray[np.uint8] | None = None,
    up: UpAxis = UpAxis.Y,
) -> None:
    """Write a mesh in the camera frame as `.ply` (binary, float32) or `.obj` (with `.mtl`, texture `.png`).

    texture: (h, w, 3) uint8 RGB for an OBJ whose mesh has texture coordinates. Colours are stored as
    value·255, without a curve. up: the axis that points up in the file; `read_mesh` expects y.
    """
    flipped = _flip(mesh, up)
    match Path(path).suffix.lower():
        case ".ply":
            if texture is not None:
                raise CannotWrite(f"{path}: a PLY carries no texture; write .obj, or give vertex colours")
            write_ply(path, _content(flipped), up.meaning)
        case ".obj":
            write_obj(path, flipped, texture, up.meaning)
        case suffix:
            raise CannotWrite(f"{path}: a mesh is written as .ply or .obj, not '{suffix}'")


def read_mesh(path: Path | str) -> Mesh:
    """Read a triangle mesh from `.ply` or `.obj` into the camera frame; polygons are cut into triangles.

    One of more vertices than `reading_limits` allows is refused before it is read. Raises `BadMesh`.
    """
    require_mesh_file(path)
    match Path(path).suffix.lower():
        case ".ply":
            content = read_ply(path)
            if content.faces is None:
                raise BadMesh(f"{path}: holds points but no faces; read it as a point cloud")
            mesh = Mesh(
                vertices=content.vertices,
                faces=content.faces,
                normals=content.normals,
                colours=_colours(content),
                uv=content.uv,
            )
        case ".obj":
            mesh = read_obj(path)
        case suffix:
            raise BadMesh(f"{path}: a mesh is read from .ply or .obj, not '{suffix}'; export it as .ply")
    return _flip(mesh)


def write_point_cloud(path: Path | str, cloud: PointCloud) -> None:
    """Write a point cloud in the camera frame as binary `.ply`."""
    if Path(path).suffix.lower() != ".ply":
        raise CannotWrite(f"{path}: a point cloud is written as .ply")
    content = PlyContent(
        vertices=graphics_from_camera(cloud.points),
        normals=None if cloud.normals is None else graphics_from_camera(cloud.normals),
        colours=bytes_from_colours(cloud.colours),
    )
    write_ply(path, content)


def read_point_cloud(path: Path | str) -> PointCloud:
    """Read the vertices of a `.ply` into the camera frame; limits and errors as `read_mesh`."""
    content = read_ply(require_mesh_file(path))
    return PointCloud(
        points=graphics_from_camera(content.vertices),
        normals=None if content.normals is None else graphics_from_camera(content.normals),
        colours=_colours(content),
    )


def _flip(mesh: Mesh, up: UpAxis = UpAxis.Y) -> Mesh:
    normals = None if mesh.normals is None else graphics_from_camera(mesh.normals, up)
    return replace(mesh, vertices=graphics_from_camera(mesh.vertices, up), normals=normals)


def _content(mesh: Mesh) -> PlyContent:
    return PlyContent(
        vertices=mesh.vertices,
        faces=mesh.faces,
        normals=mesh.normals,
        colours=bytes_from_colours(mesh.colours),
        uv=mesh.uv,
    )


def _colours(content: PlyContent) -> npt.NDArray[np.float32] | None:
    return None if content.colours is None else content.colours.astype(np.float32) / np.float32(255)

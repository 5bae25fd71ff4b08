"""A triangle mesh or a point cloud from depth, with one vertex per valid pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces, FloatArray, IntArray, LinearImage, Mask, Points
from vntoolkit.checks import checks_kinds, require_same_size, require_some
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.point_cloud import PointCloud


@dataclass(frozen=True, kw_only=True)
class MeshOptions:
    """How depth becomes triangles.

    largest_step: a triangle whose depths differ by more than this many pixel widths (at its distance) spans
    a jump and is left out. stride: use every stride-th pixel in both directions.
    """

    largest_step: float = 10.0
    stride: int = 1

    def __post_init__(self) -> None:
        if not self.largest_step > 0:
            raise BadInput(f"largest step: expected a positive number of pixels, got {self.largest_step:g}")
        if self.stride < 1:
            raise BadInput(f"stride: expected 1 or more, got {self.stride}")


@checks_kinds
def mesh_from_depth(
    depth_map: DepthMap,
    camera: Camera,
    *,
    rgb: LinearImage | None = None,
    normal_map: NormalMap | None = None,
    options: MeshOptions | None = None,
) -> Mesh:
    """Join neighbouring valid pixels to triangles that face the camera.

    depth_map: (h, w). rgb: (h, w, 3) becomes the vertex colours, clipped to 0 … 1. normal_map: its normals
    become the vertex normals, and its errors the vertices'; without, the normals are the mesh's own. Returns
    a mesh in the camera frame with texture coordinates that place the image on it. Raises `BadInput` for maps
    of different sizes or an empty mask, `BadMesh` where no three neighbouring pixels are valid, or jumps part
    them all.
    """
    options = options or MeshOptions()
    _require_match(depth_map, camera, rgb, normal_map)
    rows, columns, index = _vertex_pixels(depth_map.mask, options.stride)
    points = _points_at(depth_map, camera, rows, columns)
    faces = _faces_of_grid(index)
    if not len(faces):
        raise BadMesh("mesh: no three neighbouring pixels are valid, so there is no triangle")
    faces = faces[~_spans_jump(faces, points, camera, options)]
    if not len(faces):
        raise BadMesh(
            f"mesh: depth jumps by more than {options.largest_step:g} pixel widths in every triangle; raise "
            "the largest step"
        )
    used, faces = _compact(faces, len(points))
    rows, columns, points = rows[used], columns[used], points[used]
    return Mesh(
        vertices=points,
        faces=faces,
        normals=_normals_at(normal_map, rows, columns, points, faces),
        colours=None if rgb is None else np.clip(rgb[rows, columns], 0.0, 1.0).astype(np.float32),
        error_deg=_errors_at(normal_map, rows, columns),
        uv=np.stack([(columns + 0.5) / camera.width, 1.0 - (rows + 0.5) / camera.height], axis=-1),
    )


@checks_kinds
def point_cloud_from_depth(
    depth_map: DepthMap,
    camera: Camera,
    *,
    rgb: LinearImage | None = None,
    normal_map: NormalMap | None = None,
) -> PointCloud:
    """Return one point a valid pixel, in the camera frame, with normals and colours where given."""
    _require_match(depth_map, camera, rgb, normal_map)
    rows, columns = np.nonzero(depth_map.mask)
    return PointCloud(
        points=_points_at(depth_map, camera, rows, columns),
        normals=None if normal_map is None else normal_map.normals_in_camera[rows, columns],
        colours=None if rgb is None else np.clip(rgb[rows, columns], 0.0, 1.0).astype(np.float32),
    )


def _require_match(
    depth_map: DepthMap, camera: Camera, rgb: LinearImage | None, normal_map: NormalMap | None
) -> None:
    require_some(depth_map.mask, "depth map")
    if depth_map.shape != (camera.height, camera.width):
        h, w = depth_map.shape
        raise BadInput(f"depth map is {w}×{h} but the camera is {camera.width}×{camera.height}")
    if rgb is not None:
        require_same_size(depth_map.depth, "depth map", rgb, "colour image")
    if normal_map is not None:
        require_same_size(depth_map.depth, "depth map", normal_map.mask, "normal map")


def _vertex_pixels(mask: Mask, stride: int) -> tuple[IntArray, IntArray, IntArray]:
    """Rows and columns of the vertices, and the (h', w') vertex index of each grid node (-1: none)."""
    coarse = mask[::stride, ::stride]
    rows, columns = np.nonzero(coarse)
    index = np.full(coarse.shape, -1, dtype=np.int32)
    index[rows, columns] = np.arange(len(rows), dtype=np.int32)
    return rows * stride, columns * stride, index


def _points_at(depth_map: DepthMap, camera: Camera, rows: IntArray, columns: IntArray) -> Points:
    pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
    return camera.unproject(pixels, depth_map.depth[rows, columns].astype(np.float64))


def _faces_of_grid(index: IntArray) -> Faces:
    """Split each quad of four valid nodes into two triangles, a quad of three into one."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    # x right, y down, z away: (top left, bottom left, top right) turns counter-clockwise for the camera
    corners = [(a, c, b), (b, c, d), (a, c, d), (a, d, b)]
    whole = (a >= 0) & (b >= 0) & (c >= 0) & (d >= 0)
    kept = [
        whole | (d < 0),  # the triangle without d, also when d alone is missing
        whole | (a < 0),
        ~whole & (b < 0),
        ~whole & (c < 0),
    ]
    faces = []
    for nodes, keep in zip(corners, kept, strict=True):
        triangle = np.stack([node[keep] for node in nodes], axis=-1)
        faces.append(triangle[(triangle >= 0).all(axis=1)])
    return np.concatenate(faces).astype(np.int32)


def _spans_jump(faces: Faces, points: Points, camera: Camera, options: MeshOptions) -> npt.NDArray[np.bool_]:
    z = points[:, 2][faces]
    pixel_width = options.stride / camera.matrix[0, 0]
    if camera.is_perspective:
        pixel_width = pixel_width * np.abs(z).mean(axis=1)
    return np.ptp(z, axis=1) > options.largest_step * pixel_width


def _compact(faces: Faces, count: int) -> tuple[IntArray, Faces]:
    """Drop vertices that no triangle uses: the kept indices, and the faces renumbered."""
    used = np.zeros(count, dtype=bool)
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    return np.nonzero(used)[0], renumbered[faces].astype(np.int32)


def _normals_at(
    normal_map: NormalMap | None, rows: IntArray, columns: IntArray, points: Points, faces: Faces
) -> Points:
    own = vertex_normals(points, faces)
    if normal_map is None:
        return own
    measured = normal_map.mask[rows, columns]
    return np.where(measured[:, None], normal_map.normals_in_camera[rows, columns], own)


def _errors_at(normal_map: NormalMap | None, rows: IntArray, columns: IntArray) -> FloatArray | None:
    if normal_map is None or normal_map.error_deg is None:
        return None
    return normal_map.error_deg[rows, columns]

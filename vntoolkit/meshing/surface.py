"""A triangle mesh or a point cloud from depth, with one vertex per valid pixel.

A mesh's outline follows that of its surface between the pixels: in a window around each pixel of the rim, the
share of the pixels that belong to the same surface, and where it falls, tell how far the edge is. The vertex
goes there, on the plane of its normal. Else the outline would have the steps of the pixels.
"""

from typing import Any

import numpy as np
from numba import prange

from vntoolkit.arrays import (
    Array,
    Colours,
    Depth,
    Faces,
    FloatArray,
    IntArray,
    LinearImage,
    Mask,
    Points,
    box_of,
)  # fmt: skip
from vntoolkit.checks import checks_kinds, require_same_size, require_some
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.native import njit
from vntoolkit.options.depth import MeshOptions


@checks_kinds
def mesh_from_depth(
    depth_map: DepthMap,
    camera: Camera,
    *,
    rgb: LinearImage | None = None,
    normal_map: NormalMap | None = None,
    options: MeshOptions | None = None,
) -> Mesh:
    """Join neighbouring valid pixels to triangles that face the camera; the rim lies between pixels.

    depth_map: (h, w). rgb: (h, w, 3) becomes the vertex colours, clipped to 0 … 1. normal_map: its normals
    become the vertex normals, and its errors the vertices'; without, the normals are the mesh's own. Returns
    a mesh in the camera frame with texture coordinates that place the image on it. Raises `BadInput` for maps
    of different sizes or an empty mask, `BadMesh` where no three neighbouring pixels are valid, or jumps part
    them all.
    """
    options = options or MeshOptions()
    _require_match(depth_map, camera, rgb, normal_map)
    rows, columns, faces, moves = _grid_of(depth_map, camera, options)
    pixels = rows * camera.width + columns
    grid = np.stack([columns, rows], axis=-1).astype(np.float64)
    depth = _values_at(depth_map.depth, pixels)
    points = camera.unproject(grid, depth)
    normals = _normals_at(normal_map, pixels, points, faces)
    moves = _without_folds(grid, moves, faces)
    places, moved = grid + moves, np.flatnonzero((moves[:, 0] != 0) | (moves[:, 1] != 0))
    points[moved] = _on_planes(points[moved], normals[moved], places[moved], depth[moved], camera)
    return Mesh(
        vertices=points,
        faces=faces,
        normals=normals,
        colours=_colours_at(rgb, pixels),
        error_deg=None if normal_map is None else _values_at(normal_map.error_deg, pixels),
        uv=_uv_at(camera, places),
    )


def _without_folds(grid: FloatArray, moves: FloatArray, faces: Faces) -> FloatArray:
    """Return moves (n, 2) in pixels; none of a triangle that would lose most of its area, or turn over."""
    moved = (moves[:, 0] != 0) | (moves[:, 1] != 0)
    at_rim = faces[moved[faces[:, 0]] | moved[faces[:, 1]] | moved[faces[:, 2]]]
    while len(at_rim):
        a, b, c = ((grid + moves)[at_rim[:, i]] for i in range(3))
        first, second = b - a, c - a
        twice = first[:, 1] * second[:, 0] - first[:, 0] * second[:, 1]
        a, b, c = (grid[at_rim[:, i]] for i in range(3))
        first, second = b - a, c - a
        bad = twice < _LEAST_AREA * (first[:, 1] * second[:, 0] - first[:, 0] * second[:, 1])
        bad &= (moves[at_rim] != 0).any(axis=(1, 2))
        if not bad.any():
            break
        moves[at_rim[bad]] = 0.0
    return moves


def _on_planes(
    points: Points, normals: Points, places: FloatArray, depth: FloatArray, camera: Camera
) -> Points:
    """Return where the rays of other places (n, 2) meet the planes of points and normals (n, 3).

    Where the plane is seen at a grazing angle, depth stays.
    """
    here = camera.unproject(places, depth)
    ray = camera.unproject(places, depth + 1.0) - here
    facing = np.einsum("ni,ni->n", normals, ray) / np.linalg.norm(ray, axis=1)
    along = np.einsum("ni,ni->n", normals, points - here)
    way = np.where(facing < -_LEAST_FACING, along / np.minimum(facing, -_LEAST_FACING), 0.0)
    return here + way[:, None] * ray / np.linalg.norm(ray, axis=1, keepdims=True)


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
    pixels = rows * camera.width + columns
    return PointCloud(
        points=camera.unproject(np.stack([columns, rows], axis=-1), _values_at(depth_map.depth, pixels)),
        normals=None if normal_map is None else _values_at(normal_map.normals_in_camera, pixels),
        colours=_colours_at(rgb, pixels),
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


def _grid_of(
    depth_map: DepthMap, camera: Camera, options: MeshOptions
) -> tuple[IntArray, IntArray, Faces, FloatArray]:
    """Return rows and columns of the pixels that become vertices, triangles, and moves (n, 2) to the edge."""
    step = options.stride
    mask = depth_map.mask[::step, ::step]
    box, whole = box_of(mask), mask.shape
    mask = np.ascontiguousarray(mask[box])
    depth = np.ascontiguousarray(depth_map.depth[::step, ::step][box])
    kept = np.zeros(mask.shape, np.uint8)
    largest = options.largest_step * step / camera.matrix[0, 0]
    _triangles_kernel(mask, depth, largest, camera.is_perspective, kept)
    if not kept.any():
        _triangles_kernel(mask, depth, np.inf, False, kept)
        if not kept.any():
            raise BadMesh("mesh: no three neighbouring pixels are valid, so there is no triangle")
        raise BadMesh(
            f"mesh: depth jumps by more than {options.largest_step:g} pixel widths in every triangle; raise "
            "the largest step"
        )
    counts = np.empty((2, mask.shape[0]), np.int64)
    _counts_kernel(kept, counts)
    first = np.concatenate([np.zeros((2, 1), np.int64), np.cumsum(counts, axis=1)], axis=1)
    rows, columns = np.empty((2, first[0, -1]), np.int64)
    corner = box[0].start, box[1].start
    faces = np.empty((first[1, -1], 3), np.int32)
    index = np.empty(mask.shape, np.int32)
    moves = np.zeros((len(rows), 2))
    _vertices_kernel(kept, first[0], corner, step, index, rows, columns)
    _faces_kernel(kept, first[1], index, faces)
    frame = (*(corner[i] == 0 for i in range(2)), *(box[i].stop == whole[i] for i in range(2)))
    _moves_kernel(mask, depth, kept, index, largest, camera.is_perspective, frame, moves)
    return rows, columns, faces, moves * step


def _uv_at(camera: Camera, places: FloatArray) -> FloatArray:
    uv = np.empty((len(places), 2))
    uv[:, 0] = (places[:, 0] + 0.5) / camera.width
    uv[:, 1] = 1.0 - (places[:, 1] + 0.5) / camera.height
    return uv


def _normals_at(normal_map: NormalMap | None, pixels: IntArray, points: Points, faces: Faces) -> Points:
    if normal_map is None:
        return vertex_normals(points, faces)
    normals = _values_at(normal_map.normals_in_camera, pixels)
    measured = _values_at(normal_map.mask, pixels)
    if measured.all():
        return normals
    return np.where(measured[:, None], normals, vertex_normals(points, faces))


def _colours_at(rgb: LinearImage | None, pixels: IntArray) -> Colours | None:
    colours = _values_at(rgb, pixels)
    return None if colours is None else np.clip(colours, 0.0, 1.0).astype(np.float32, copy=False)


def _values_at(image: Array | None, pixels: IntArray) -> Any:
    """Return the values (n, …) of an image (h, w, …) at pixels by number, row after row; None for None."""
    if image is None:
        return None
    return image.reshape(-1, *image.shape[2:]).take(pixels, axis=0)  # half the time of [rows, columns]


_LEAST_AREA = 0.1  # of a triangle at the rim, beside what it had
_LEAST_FACING = 0.2  # cosine between normal and ray below which a plane tells no depth
_SMOOTHED_PX = 2.0  # standard deviation of the Gaussian that smooths the outline: steps are a pixel high …
_WINDOW = 4  # … and its reach
_FARTHEST_MOVE = 1.0  # pixels: the edge is before the next

# Compiled loops. A pixel stands for the quad whose upper left corner it is: corners a, b (right), c (below)
# and d (below right). Four valid corners make two triangles; three, or four of which one lies beyond a jump,
# make one.

# x right, y down, z away: (top left, bottom left, top right) turns counter-clockwise for the camera
_CORNERS = ((0, 2, 1), (1, 2, 3), (0, 2, 3), (0, 3, 1))


@njit(cache=True, parallel=True)
def _triangles_kernel(mask: Mask, depth: Depth, largest: float, times_depth: bool, kept: Mask) -> None:
    """Set bit i of kept (h, w) where triangle i of `_CORNERS` spans no jump: largest + times_depth × z."""
    h, w = mask.shape
    for v in prange(h - 1):
        for u in range(w - 1):
            valid = (mask[v, u], mask[v, u + 1], mask[v + 1, u], mask[v + 1, u + 1])
            count = int(valid[0]) + int(valid[1]) + int(valid[2]) + int(valid[3])
            bits = 0
            if count >= 3:
                z = (depth[v, u], depth[v, u + 1], depth[v + 1, u], depth[v + 1, u + 1])
                for i in range(4):
                    a, b, c = _CORNERS[i]
                    if not (valid[a] and valid[b] and valid[c]) or (count == 4 and i > 1 and bits & 3):
                        continue
                    step = max(z[a], z[b], z[c]) - min(z[a], z[b], z[c])
                    mean = (abs(z[a]) + abs(z[b]) + abs(z[c])) / 3.0 if times_depth else 1.0
                    if step <= largest * mean:
                        bits |= 1 << i
            kept[v, u] = bits


@njit(cache=True, inline="always")
def _is_used(kept: Mask, v: int, u: int) -> bool:
    """True where a triangle of the four quads around a pixel has it for a corner."""
    used = kept[v, u] & 0b1101 != 0
    if u > 0:
        used |= kept[v, u - 1] & 0b1011 != 0
    if v > 0:
        used |= kept[v - 1, u] & 0b0111 != 0
        if u > 0:
            used |= kept[v - 1, u - 1] & 0b1110 != 0
    return used


@njit(cache=True, parallel=True)
def _counts_kernel(kept: Mask, counts: IntArray) -> None:
    """Fill counts (2, h): vertices and triangles of each row."""
    h, w = kept.shape
    for v in prange(h):
        vertices, triangles = 0, 0
        for u in range(w):
            vertices += _is_used(kept, v, u)
            for i in range(4):
                triangles += (kept[v, u] >> i) & 1
        counts[0, v], counts[1, v] = vertices, triangles


@njit(cache=True, parallel=True)
def _vertices_kernel(
    kept: Mask,
    first: IntArray,
    corner: tuple[int, int],
    step: int,
    index: IntArray,
    rows: IntArray,
    columns: IntArray,
) -> None:
    """Number vertices by rows: index (h, w), rows, columns (n,). corner: of kept, after the stride."""
    h, w = kept.shape
    for v in prange(h):
        number = first[v]
        for u in range(w):
            if _is_used(kept, v, u):
                index[v, u] = number
                rows[number], columns[number] = (corner[0] + v) * step, (corner[1] + u) * step
                number += 1


@njit(cache=True, parallel=True)
def _faces_kernel(kept: Mask, first: IntArray, index: IntArray, faces: Faces) -> None:
    h, w = kept.shape
    for v in prange(h - 1):
        number = first[v]
        for u in range(w - 1):
            for i in range(4):
                if (kept[v, u] >> i) & 1:
                    for j in range(3):
                        corner = _CORNERS[i][j]
                        faces[number, j] = index[v + (corner >> 1), u + (corner & 1)]
                    number += 1


@njit(cache=True, inline="always")
def _is_of_surface(
    mask: Mask,
    depth: Depth,
    v: int,
    u: int,
    j: int,
    i: int,
    step: float,
    frame: tuple[bool, bool, bool, bool],
) -> bool:
    """True where the pixel j rows and i columns on lies on the surface of pixel (v, u).

    step: the largest of depth from pixel to pixel. Beyond a side of the picture the surface goes on.
    """
    h, w = mask.shape
    y, x = v + j, u + i
    if (y < 0 and frame[0]) or (y >= h and frame[2]):
        y = v
    if (x < 0 and frame[1]) or (x >= w and frame[3]):
        x = u
    if y < 0 or y >= h or x < 0 or x >= w or not mask[y, x]:
        return False
    return abs(depth[y, x] - depth[v, u]) <= step * max(abs(i), abs(j), 1)


@njit(cache=True, parallel=True)
def _moves_kernel(
    mask: Mask,
    depth: Depth,
    kept: Mask,
    index: IntArray,
    largest: float,
    times_depth: bool,
    frame: tuple[bool, bool, bool, bool],
    moves: FloatArray,
) -> None:
    """Fill moves (n, 2), along u and v, of the pixels of the rim. frame: whether a side is the picture's."""
    h, w = mask.shape
    for row in prange(h):
        v = np.int64(row)  # signed, for what lies beyond the border
        for u in range(w):
            if not _is_used(kept, v, u):
                continue
            step = largest * (abs(depth[v, u]) if times_depth else 1.0)
            inside = _is_of_surface(mask, depth, v, u, 0, -1, step, frame)
            inside &= _is_of_surface(mask, depth, v, u, 0, 1, step, frame)
            inside &= _is_of_surface(mask, depth, v, u, -1, 0, step, frame)
            inside &= _is_of_surface(mask, depth, v, u, 1, 0, step, frame)
            if inside:
                continue
            total, share, fall_u, fall_v = 0.0, 0.0, 0.0, 0.0
            for j in range(-_WINDOW, _WINDOW + 1):
                for i in range(-_WINDOW, _WINDOW + 1):
                    weight = np.exp(-0.5 * (i * i + j * j) / _SMOOTHED_PX**2)
                    total += weight
                    if _is_of_surface(mask, depth, v, u, j, i, step, frame):
                        share += weight
                        fall_u += weight * i
                        fall_v += weight * j
            length = np.hypot(fall_u, fall_v)
            if length == 0.0:
                continue
            way = _SMOOTHED_PX**2 * (share - 0.5 * total) / length
            way = max(min(way, _FARTHEST_MOVE), -_FARTHEST_MOVE)
            moves[index[v, u], 0] = -way * fall_u / length
            moves[index[v, u], 1] = -way * fall_v / length

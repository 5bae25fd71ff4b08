"""A triangle mesh or a point cloud from depth, with one vertex per valid pixel.

Centres of the outermost pixels lie up to a pixel within the edge of their surface, each by another amount.
Joined as they are, they make saw teeth in the picture. Seen from the side these are longer, where the surface
turns away and depth falls by many pixels within that one. So a mesh ends between pixels. In a window around
each pixel of the rim, the share that belongs to the same surface, and where it falls, tell how far the edge
is; the plane that fits the window's depth best tells the depth there.
"""

from typing import Any, NamedTuple, TypeAlias

import numpy as np

from vntoolkit.arrays import (
    Array,
    Colours,
    Depth,
    Faces,
    FloatArray,
    Int64Array,
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

_Sides: TypeAlias = tuple[bool, bool, bool, bool]  # upper, left, lower, right


class _Rim(NamedTuple):
    """Pixels at the rim of a mesh.

    chosen: (m,) which ones of those asked for. moves: (m, 2) to the edge, along u and v, in pixels. planes:
    (m, 3), depth at the pixel, and how much it changes per pixel along u and v.
    """

    chosen: IntArray
    moves: FloatArray
    planes: FloatArray


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
    rows, columns, faces, rim = _grid_of(depth_map, camera, options)
    pixels = rows * camera.width + columns
    places: FloatArray = np.stack([columns, rows], axis=-1).astype(np.float64)
    depth = _values_at(depth_map.depth, pixels).astype(np.float64)
    moves = np.zeros_like(places)
    moves[rim.chosen] = rim.moves * options.stride
    moves = _without_folds(places, moves, faces)[rim.chosen]
    places[rim.chosen] += moves
    depth[rim.chosen] = rim.planes[:, 0] + (rim.planes[:, 1:] * moves).sum(axis=1) / options.stride
    points = camera.unproject(places, depth)
    return Mesh(
        vertices=points,
        faces=faces,
        normals=_normals_at(normal_map, pixels, points, faces),
        colours=_colours_at(rgb, pixels),
        error_deg=None if normal_map is None else _values_at(normal_map.error_deg, pixels),
        uv=_uv_at(camera, places),
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
) -> tuple[IntArray, IntArray, Faces, _Rim]:
    """Return rows and columns of the pixels that become vertices, triangles, and the rim, by vertices."""
    step = options.stride
    mask = depth_map.mask[::step, ::step]
    box, whole = box_of(mask), mask.shape
    mask = np.ascontiguousarray(mask[box])
    depth = np.ascontiguousarray(depth_map.depth[::step, ::step][box])
    kept: IntArray = np.zeros(mask.shape, np.uint8)
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
    used = np.zeros(mask.shape, bool)
    for (down, right), triangles in _TRIANGLES_OF.items():
        used[down:, right:] |= (kept[: len(kept) - down, : kept.shape[1] - right] & triangles) != 0
    rows, columns = np.nonzero(used)
    index = np.empty(mask.shape, np.int32)
    index[used] = np.arange(len(rows))
    first = np.cumsum([0, *np.bitwise_count(kept).sum(axis=1, dtype=np.int64)])
    faces = np.empty((first[-1], 3), np.int32)
    _faces_kernel(kept, first, index, faces)
    corner = box[0].start, box[1].start
    frame = (*(corner[i] == 0 for i in range(2)), *(box[i].stop == whole[i] for i in range(2)))
    v, u = _beside_gaps(kept, used, frame)
    steps = largest * np.abs(depth[v, u]) if camera.is_perspective else largest
    rim = _fit_rim(mask, depth, v, u, steps, frame)
    rows, columns = (rows + corner[0]) * step, (columns + corner[1]) * step
    return rows, columns, faces, rim._replace(chosen=index[v, u][rim.chosen])


def _beside_gaps(kept: IntArray, used: Mask, sides: _Sides) -> tuple[IntArray, IntArray]:
    """Return rows and columns of vertices where one of the four quads around has less than two triangles."""
    whole = np.pad((kept[:-1, :-1] == _BOTH[0]) | (kept[:-1, :-1] == _BOTH[1]), 1)
    whole[0] |= sides[0]
    whole[:, 0] |= sides[1]
    whole[-1] |= sides[2]
    whole[:, -1] |= sides[3]
    rows, columns = np.nonzero(used & ~(whole[:-1, :-1] & whole[:-1, 1:] & whole[1:, :-1] & whole[1:, 1:]))
    return rows, columns


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


# The rim.

_SMOOTHED_PX = 2.0  # standard deviation of the Gaussian that smooths the outline: steps are a pixel high …
_REACH = 4  # … and the window's
_FARTHEST_MOVE = 1.0  # pixels: the edge is before the next
_HOLD = 1e-9  # of a window's weight: holds the plane of pixels that lie on one line
_LEAST_AREA = 0.1  # of a triangle at the rim, beside what it had


def _window() -> tuple[Int64Array, list[tuple[slice, list[Int64Array]]]]:
    """Return offsets (81, 2), along u and v, ring after ring, and for each ring the next two inwards."""
    side = np.arange(-_REACH, _REACH + 1)
    offsets = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    ring = np.abs(offsets).max(axis=1)
    offsets, ring = offsets[np.argsort(ring, kind="stable")], np.sort(ring)
    rings = []
    for r in range(1, _REACH + 1):
        here = np.flatnonzero(ring == r)
        straight = offsets[here] * (r - 1) / r
        ends = (np.trunc(straight), np.sign(straight) * np.ceil(np.abs(straight)))
        inwards = [(offsets == end[:, None]).all(axis=-1).argmax(axis=1) for end in ends]
        rings.append((slice(int(here[0]), int(here[-1]) + 1), inwards))
    return offsets, rings


_OFFSETS, _RINGS = _window()
_WEIGHTS = np.exp(-0.5 * (_OFFSETS**2).sum(axis=1) / _SMOOTHED_PX**2)
_PLANE = np.column_stack([np.ones(len(_OFFSETS)), _OFFSETS])
_PRODUCTS = (_PLANE[:, :, None] * _PLANE[:, None, :]).reshape(-1, 9)


def _fit_rim(
    mask: Mask, depth: Depth, rows: IntArray, columns: IntArray, largest: FloatArray | float, sides: _Sides
) -> _Rim:
    """Find the edge of the surface, and the depth there, at those of n pixels that lie at the rim.

    mask, depth: (h, w). rows, columns: (n,). largest: (n,) or one number, the step of depth from pixel to
    pixel beyond which surfaces part. sides: which are the picture's: the surface goes on beyond these.
    """
    width = mask.shape[1] + 2 * _REACH
    kind, z = _padded(mask, sides).ravel(), np.pad(depth, _REACH, mode="edge").ravel()
    pixels = (rows + _REACH) * width + columns + _REACH
    largest = np.broadcast_to(largest, rows.shape)
    amid = np.ones(len(rows), bool)
    for step in (-width, -1, 1, width):
        amid &= (kind[pixels + step] > 0) & (np.abs(z[pixels + step] - z[pixels]) <= largest)
    chosen = np.flatnonzero(~amid)
    places = pixels[chosen] + (_OFFSETS @ [1, width])[:, None]  # (81, m)
    kinds, values = kind.take(places), z.take(places)
    joined = kinds > 0
    for ring, inwards in _RINGS:
        reached = np.zeros_like(joined[ring])
        for inner in inwards:
            reached |= joined[inner] & (np.abs(values[ring] - values[inner]) <= largest[chosen])
        joined[ring] &= reached
    weights = joined * _WEIGHTS[:, None]
    fall = _OFFSETS.T @ weights
    length = np.maximum(np.hypot(*fall), _HOLD)
    way = _SMOOTHED_PX**2 * (weights.sum(axis=0) - 0.5 * _WEIGHTS.sum()) / length
    way = np.clip(way, -_FARTHEST_MOVE, _FARTHEST_MOVE)
    # depth falls fastest at the edge, where least of it is seen: a pixel counts by its distance from it
    weights *= np.maximum(_OFFSETS @ (fall / length) + way, 0.0) * (kinds == 1)
    normal = (_PRODUCTS.T @ weights).T.reshape(-1, 3, 3) + _HOLD * np.eye(3)
    own = values[0].astype(np.float64)
    planes = np.linalg.solve(normal, (_PLANE.T @ (weights * (values - own))).T[..., None])[..., 0]
    planes[:, 0] += own
    return _Rim(chosen, (-way * fall / length).T, planes)


def _padded(mask: Mask, sides: _Sides) -> IntArray:
    """Return (h + 8, w + 8): 0 outside, 1 inside, more beyond a side of the picture, where it goes on."""
    kind: IntArray = np.pad(mask.astype(np.uint8), _REACH, mode="edge")
    borders = (kind[:_REACH], kind[:, :_REACH], kind[-_REACH:], kind[:, -_REACH:])
    for border, is_picture in zip(borders, sides, strict=True):
        border[:] *= 2 if is_picture else 0
    return kind


def _without_folds(grid: FloatArray, moves: FloatArray, faces: Faces) -> FloatArray:
    """Return moves (n, 2) in pixels, halved until no triangle loses most of its area, or turns over."""
    moved = (moves[:, 0] != 0) | (moves[:, 1] != 0)
    at_rim = faces[moved[faces[:, 0]] | moved[faces[:, 1]] | moved[faces[:, 2]]]
    corners = grid[at_rim]
    least = _LEAST_AREA * _twice_area(corners)
    folded = at_rim
    while len(folded):
        folded = at_rim[_twice_area(corners + moves[at_rim]) < least]
        moves[folded] *= 0.5
    return moves


def _twice_area(corners: FloatArray) -> FloatArray:
    """Return (n,), twice the areas of triangles (n, 3, 2) that face the camera."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.asarray(first[:, 1] * second[:, 0] - first[:, 0] * second[:, 1])


# Compiled loops. A pixel stands for the quad whose upper left corner it is: corners a, b (right), c (below)
# and d (below right). Four valid corners make two triangles; three, or four of which one lies beyond a jump,
# make one.

# x right, y down, z away: (top left, bottom left, top right) turns counter-clockwise for the camera
_CORNERS = ((0, 2, 1), (1, 2, 3), (0, 2, 3), (0, 3, 1))
_TRIANGLES_OF = {(0, 0): 0b1101, (0, 1): 0b1011, (1, 0): 0b0111, (1, 1): 0b1110}  # bits, by corner
_BOTH = (0b0011, 0b1100)  # two of them make a quad


@njit
def _triangles_kernel(mask: Mask, depth: Depth, largest: float, times_depth: bool, kept: Mask) -> None:
    """Set bit i of kept (h, w) where triangle i of `_CORNERS` spans no jump: largest + times_depth × z."""
    h, w = mask.shape
    for v in range(h - 1):
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


@njit
def _faces_kernel(kept: Mask, first: IntArray, index: IntArray, faces: Faces) -> None:
    h, w = kept.shape
    for v in range(h - 1):
        number = first[v]
        for u in range(w - 1):
            for i in range(4):
                if (kept[v, u] >> i) & 1:
                    for j in range(3):
                        corner = _CORNERS[i][j]
                        faces[number, j] = index[v + (corner >> 1), u + (corner & 1)]
                    number += 1

"""Where a mesh ends between the pixels, and at what depth.

Centres of the outermost pixels lie up to a pixel within the edge of their surface, each by another amount.
Joined as they are, they make saw teeth in the picture; and longer ones seen from the side, where the surface
turns away and depth falls by many pixels within that one. What is smooth is taken instead, in a window around
each pixel of the rim: the share of the window that belongs to the surface, and where it falls, tell how far
the edge is; the plane that fits the window's depth best tells the depth there.
"""

from typing import NamedTuple, TypeAlias

import numpy as np

from vntoolkit.arrays import Depth, Faces, FloatArray, Int64Array, IntArray, Mask

Sides: TypeAlias = tuple[bool, bool, bool, bool]  # upper, left, lower, right

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


class Rim(NamedTuple):
    """Pixels at the rim of a mesh.

    chosen: (m,) which ones of those asked for. moves: (m, 2) to the edge, along u and v, in pixels. planes:
    (m, 3), depth at the pixel, and how much it changes per pixel along u and v.
    """

    chosen: IntArray
    moves: FloatArray
    planes: FloatArray


def fit_rim(
    mask: Mask, depth: Depth, rows: IntArray, columns: IntArray, largest: FloatArray | float, sides: Sides
) -> Rim:
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
    return Rim(chosen, (-way * fall / length).T, planes)


def _padded(mask: Mask, sides: Sides) -> IntArray:
    """Return (h + 8, w + 8): 0 outside, 1 inside, more beyond a side of the picture, where it goes on."""
    kind: IntArray = np.pad(mask.astype(np.uint8), _REACH, mode="edge")
    borders = (kind[:_REACH], kind[:, :_REACH], kind[-_REACH:], kind[:, -_REACH:])
    for border, is_picture in zip(borders, sides, strict=True):
        border[:] *= 2 if is_picture else 0
    return kind


def without_folds(grid: FloatArray, moves: FloatArray, faces: Faces) -> FloatArray:
    """Return moves (n, 2) in pixels; none of a triangle that would lose most of its area, or turn over."""
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

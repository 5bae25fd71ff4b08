"""Truncated signed distances of all depth maps, averaged in the hull's cells (curless1996)."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.calibration.head.hull import DistanceGrid, View, largest_part
from vntoolkit.calibration.head.shape import FusionOptions, confirmed_maps
from vntoolkit.calibration.head.stereo import OrientedPoints

_REACH_CELLS = 4.0  # distances are cut off beyond; further behind a surface its view says nothing
_DEEPEST = 0.12  # of the diagonal: stereo carves no deeper into the hull
_PRIOR_WEIGHT = 0.15  # of the shape before, in views
_HOLE_PX = 15  # width of the holes in a half-size depth map that are bridged
_COVERED = 0.6  # share of a half-size pixel's neighbours that must have a depth
_ROW = 256  # OpenCV resamples images, no lists: points are laid out in rows


def fuse_depths(
    maps: Sequence[OrientedPoints],
    views: Sequence[View],
    before: DistanceGrid,
    hull: DistanceGrid,
    diagonal: float,
    options: FusionOptions,
) -> DistanceGrid:
    """Average the views' distances to their depths, cut off at a few cells; where no view tells, `before`.

    maps, views: one each. before: the shape that the maps were searched about. hull: bounds it. diagonal:
    of the hull's mesh. Returns a grid like the hull's; its surface is closed.
    """
    kept = confirmed_maps(maps, diagonal, hull, options)
    reach = _REACH_CELLS * hull.cell
    near = (hull.values > -reach) & (hull.values < _DEEPEST * diagonal)
    points = np.stack(np.nonzero(near), axis=1) * hull.cell + hull.low
    total = np.full(len(points), _PRIOR_WEIGHT)
    sum_of = total * np.clip(before.values[near], -reach, reach)
    for each, view in zip(kept, views, strict=True):
        if not len(each.points):
            continue
        distance, weight = _distance_to_map(each, view, points, reach)
        total += weight
        sum_of += weight * distance
    values = np.array(hull.values)
    values[near] = np.minimum(sum_of / total, values[near])
    return DistanceGrid(low=hull.low, cell=hull.cell, values=largest_part(values, hull.cell))


def _distance_to_map(
    each: OrientedPoints, view: View, points: Points, reach: float
) -> tuple[FloatArray, FloatArray]:
    """Return each point's distance behind the view's surface, cut off before it, and its weight (n,) each."""
    depth, facing, known, first = _half_size_maps(each, view)
    moved = view.camera_from_head.apply(points)
    pixels = np.full((-(-len(points) // _ROW), _ROW, 2), -9.0, dtype=np.float32)
    pixels.reshape(-1, 2)[: len(points)] = (view.camera.project(moved) - first) / 2.0
    u, v = np.ascontiguousarray(pixels[..., 0]), np.ascontiguousarray(pixels[..., 1])
    share, level, cosine = (
        cv2.remap(image, u, v, cv2.INTER_LINEAR, borderValue=0).ravel()[: len(points)]
        for image in (known, depth * known, facing * known)
    )
    covered = share > _COVERED
    safe = np.maximum(share, _COVERED)
    distance = (moved[:, 2] - level / safe) * cosine / safe
    weight = np.where(covered & (distance < reach), cosine / safe, 0.0)
    return np.clip(distance, -reach, reach), weight


def _half_size_maps(
    each: OrientedPoints, view: View
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Put the points, taken at every second pixel, back into images: depth, cosine, 1 where known.

    Also returns the pixel (2,) of the images' first entry.
    """
    moved = view.camera_from_head.apply(each.points)
    pixels = np.round(view.camera.project(moved))
    first = pixels.min(axis=0)
    column, row = ((pixels - first) / 2.0).astype(int).T
    shape = (row.max() + 1, column.max() + 1)
    depth, facing, known = (np.zeros(shape, np.float32) for _ in range(3))
    normals = view.camera_from_head.rotate(each.normals)
    depth[row, column] = moved[:, 2]
    facing[row, column] = -(normals * moved).sum(axis=1) / np.linalg.norm(moved, axis=1)
    known[row, column] = 1.0
    return *_bridged(depth, facing, known), first


def _bridged(
    depth: FloatArray, facing: FloatArray, known: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fill small holes from their surroundings: a ray that no depth stops would leave hull standing."""
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (_HOLE_PX, _HOLE_PX))
    closed = cv2.morphologyEx(known, cv2.MORPH_CLOSE, kernel)
    around = cv2.GaussianBlur(known, (0, 0), _HOLE_PX / 4.0)
    holes = (closed > 0) & (known == 0) & (around > 0.02)
    filled = []
    for image in (depth, facing):
        smooth = cv2.GaussianBlur(image, (0, 0), _HOLE_PX / 4.0) / np.maximum(around, 0.02)
        filled.append(np.where(holes, smooth, image).astype(np.float32))
    return filled[0], filled[1], np.where(holes, 1.0, known).astype(np.float32)

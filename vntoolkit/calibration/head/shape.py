"""The head's shape from silhouettes and stereo, in passes from coarse to fine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.calibration.head.hull import DistanceGrid, View, largest_part, mesh_of_grid, spread_over_turn
from vntoolkit.calibration.head.stereo import OrientedPoints, StereoOptions, stereo_points
from vntoolkit.errors import BadCalibration, BadInput
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.native import import_open3d

_LEAST_POINTS = 500
_REACH_CELLS = 4.0  # distances are cut off beyond; further behind a surface its view says nothing
_DEEPEST = 0.12  # of the diagonal: stereo carves no deeper into the hull
_PRIOR_WEIGHT = 0.15  # of the shape before, in views
_HOLE_PX = 15  # width of the holes in a half-size depth map that are bridged
_COVERED = 0.6  # share of a half-size pixel's neighbours that must have a depth
_ROW = 256  # OpenCV resamples images, no lists: points are laid out in rows


def fit_shape(
    views: Sequence[View],
    contrasts: Sequence[npt.NDArray[np.uint8]],
    hull: DistanceGrid,
    stereo: StereoOptions,
    fusion: FusionOptions,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Mesh:
    """Search depths about the hull, fuse, search again closely about the result; returns a closed mesh.

    contrasts: (h, w) local contrast of every view, 8 bits. on_progress is told depth maps done and in all.
    Raises `BadCalibration` where hardly two views agree on a depth.
    """
    references = spread_over_turn(views, stereo.references)
    mesh, volume = mesh_of_grid(hull), hull
    diagonal = mesh.diagonal
    for number in range(stereo.passes):
        maps = []
        for done, k in enumerate(references.tolist(), start=1):
            search = stereo if number == 0 else stereo.closely()
            maps.append(stereo_points(views, contrasts, mesh, k, search))
            on_progress(number * len(references) + done, stereo.passes * len(references))
        if fusion.surface is Surface.POISSON:
            mesh = fuse_points(maps, mesh, hull, fusion)
        else:
            volume = fuse_depths(maps, [views[k] for k in references], volume, hull, diagonal, fusion)
            mesh = mesh_of_grid(volume)
    return mesh


class Surface(Enum):
    """How depths become a surface."""

    POISSON = "poisson"  # screened Poisson over points and normals
    TSDF = "tsdf"  # truncated signed distances, averaged over the views


@dataclass(frozen=True, kw_only=True)
class FusionOptions:
    """How depths become a mesh.

    surface: Poisson's, or truncated signed distances averaged in the hull's cells. fusion_depth: levels of
    Poisson's octree; 7 resolves about a 100th of the head. agreement: distance, as a share
    of the hull's diagonal, within which points of another view must confirm a point. confirmations: how many
    other views must confirm a point for it to be kept; raise it to 2 or 3 where single wrong points leave
    bumps, lower it to 0 where parts that few views saw are missing. hull_gap: distance, as a share of the
    diagonal, from the places of the hull whose depth stereo corrected, beyond which the hull itself is
    surface.
    """

    surface: Surface = Surface.POISSON
    fusion_depth: int = 7
    agreement: float = 0.004
    confirmations: int = 1
    hull_gap: float = 0.008

    def __post_init__(self) -> None:
        if not 4 <= self.fusion_depth <= 12 or self.confirmations < 0:
            raise BadInput("fusion: expected a depth of 4 to 12 and no negative number of confirmations")
        if min(self.agreement, self.hull_gap) <= 0:
            raise BadInput("fusion: expected a positive agreement and hull gap")


def fuse_points(
    maps: Sequence[OrientedPoints], hull: Mesh, grid: DistanceGrid, options: FusionOptions
) -> Mesh:
    """Fuse: points that other views confirm, the hull where there are none, screened Poisson over both.

    Points outside the hull are dropped: no silhouette allows them. Returns a closed mesh in the head frame.
    Raises `BadCalibration` where hardly a point is confirmed.
    """
    points = _joined(confirmed_maps(maps, hull.diagonal, grid, options))
    distance, _ = cKDTree(points.on_hull).query(hull.vertices, workers=1)
    rest = distance > options.hull_gap * hull.diagonal
    normals = vertex_normals(hull.vertices, hull.faces)
    return _poisson(
        np.concatenate([points.points, hull.vertices[rest]]),
        np.concatenate([points.normals, normals[rest]]),
        options.fusion_depth,
    )


def confirmed_maps(
    maps: Sequence[OrientedPoints], diagonal: float, grid: DistanceGrid, options: FusionOptions
) -> list[OrientedPoints]:
    """Keep of every map the points inside the hull that lie close, along their normals, to enough others'.

    diagonal: the hull's. Raises `BadCalibration` where hardly a point remains.
    """
    trees = [cKDTree(each.points) if len(each.points) else None for each in maps]
    kept = []
    for k, each in enumerate(maps):
        votes = np.zeros(len(each.points), dtype=np.int64)
        for j, tree in enumerate(trees):
            if j == k or tree is None or not len(each.points):
                continue
            distance, nearest = tree.query(
                each.points, distance_upper_bound=2.0 * options.agreement * diagonal, workers=1
            )
            found = np.isfinite(distance)
            gap = np.full(len(votes), np.inf)
            step = maps[j].points[nearest[found]] - each.points[found]
            gap[found] = np.abs((step * each.normals[found]).sum(axis=1))
            votes += gap < options.agreement * diagonal
        kept.append(each.chosen((votes >= options.confirmations) & (grid.at(each.points) > -grid.cell)))
    count = sum(len(each.points) for each in kept)
    if count < _LEAST_POINTS:
        raise BadCalibration(
            f"stereo: only {count} depths agree between views; film more sharply, closer, slower"
        )
    return kept


def _joined(maps: Sequence[OrientedPoints]) -> OrientedPoints:
    return OrientedPoints(
        points=np.concatenate([each.points for each in maps]),
        normals=np.concatenate([each.normals for each in maps]),
        on_hull=np.concatenate([each.on_hull for each in maps]),
        correlation=np.concatenate([each.correlation for each in maps]),
    )


def _poisson(points: np.ndarray, normals: np.ndarray, depth: int) -> Mesh:
    o3d = import_open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    surface, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud, depth=depth, linear_fit=False, n_threads=1
    )
    clusters, sizes, _ = surface.cluster_connected_triangles()
    largest = int(np.argmax(np.asarray(sizes)))
    surface.remove_triangles_by_mask(np.asarray(clusters) != largest)
    surface.remove_unreferenced_vertices()
    vertices, faces = np.asarray(surface.vertices), np.asarray(surface.triangles, dtype=np.int32)
    return Mesh(vertices=vertices.copy(), faces=faces.copy(), normals=vertex_normals(vertices, faces))


# Truncated signed distances of all depth maps, averaged in the hull's cells (curless1996).


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

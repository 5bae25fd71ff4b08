"""The head's shape from silhouettes and stereo."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from vntoolkit import progress
from vntoolkit.arrays import ByteArray
from vntoolkit.calibration.head.hull import DistanceGrid, SilhouetteView, mesh_of_grid, spread_over_turn
from vntoolkit.calibration.head.stereo import OrientedPoints, stereo_points
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.libraries import import_open3d
from vntoolkit.options.head import HeadSteps

_LEAST_POINTS = 500


def fit_shape(
    views: Sequence[SilhouetteView],
    contrasts: Sequence[ByteArray],
    hull: DistanceGrid,
    steps: HeadSteps,
    about: Mesh | None = None,
) -> Mesh:
    """Search depths of evenly spread views about the hull, or a mesh, and fuse them.

    contrasts: (h, w) local contrast of every view, 8 bits. Raises `BadCalibration` where hardly two views
    agree on a depth.
    """
    references = spread_over_turn(views, steps.references)
    mesh = mesh_of_grid(hull) if about is None else about
    counted = progress.counted(references.tolist(), "depth maps", len(references))
    maps = [stereo_points(views, contrasts, mesh, k, steps) for k in counted]
    return fuse_points(maps, mesh, hull, steps)


# One closed mesh from the stereo points of many views and the hull behind them (kazhdan2013).


def fuse_points(maps: Sequence[OrientedPoints], hull: Mesh, grid: DistanceGrid, steps: HeadSteps) -> Mesh:
    """Fuse: points that other views confirm, the hull where there are none, screened Poisson over both.

    Points outside the hull are dropped: no silhouette allows them. Raises `BadCalibration` where
    hardly a point is confirmed.
    """
    kept = confirmed_maps(maps, hull.diagonal, grid, steps)
    found = np.concatenate([each.points for each in kept])
    corrected = np.concatenate([each.on_hull for each in kept])
    distance, _ = cKDTree(corrected).query(hull.vertices, workers=1)
    rest = distance > steps.hull_gap * hull.diagonal
    normals = vertex_normals(hull.vertices, hull.faces)
    rest &= normals.any(axis=1)  # vertices of slivers have none
    cloud = PointCloud(
        points=np.concatenate([found, hull.vertices[rest]]),
        normals=np.concatenate([*(each.normals for each in kept), normals[rest]]),
    )
    return _poisson(cloud, steps.fusion_depth)


def confirmed_maps(
    maps: Sequence[OrientedPoints], diagonal: float, grid: DistanceGrid, steps: HeadSteps
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
                each.points, distance_upper_bound=2.0 * steps.agreement * diagonal, workers=1
            )
            found = np.isfinite(distance)
            gap = np.full(len(votes), np.inf)
            step = maps[j].points[nearest[found]] - each.points[found]
            gap[found] = np.abs((step * each.normals[found]).sum(axis=1))
            votes += gap < steps.agreement * diagonal
        kept.append(each.chosen((votes >= steps.confirmations) & (grid.at(each.points) > -grid.cell)))
    count = sum(len(each.points) for each in kept)
    if count < _LEAST_POINTS:
        raise BadCalibration(
            f"stereo: only {count} depths agree between views; film more sharply, closer, slower"
        )
    return kept


def _poisson(cloud: PointCloud, depth: int) -> Mesh:
    """Return the largest part of the surface through oriented points."""
    surface, _ = import_open3d().geometry.TriangleMesh.create_from_point_cloud_poisson(
        cloud.to_open3d(), depth=depth, linear_fit=False, n_threads=1
    )
    clusters, sizes, _ = surface.cluster_connected_triangles()
    largest = int(np.argmax(np.asarray(sizes)))
    surface.remove_triangles_by_mask(np.asarray(clusters) != largest)
    surface.remove_unreferenced_vertices()
    mesh = Mesh.from_open3d(surface)
    return replace(mesh, normals=vertex_normals(mesh.vertices, mesh.faces), colours=None)

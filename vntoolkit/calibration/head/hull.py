"""The visual hull of all silhouettes (laurentini1994), as signed distances and as a mesh."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from vntoolkit.arrays import Float32Array, FloatArray, IntArray, Mask, Points, Vector3, read_only
from vntoolkit.calibration.head.samples import sampled
from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadCalibration
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, isosurface, vertex_normals
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.options.head import HeadSteps

_SHARE_OF_VIEWS = 3  # a point that fewer than one view in so many shows was never filmed: it is outside


@dataclass(frozen=True, kw_only=True, eq=False)
class SilhouetteView:
    """One silhouette with its camera.

    mask: (h, w) bool. camera_from_head: pose.
    """

    camera: Camera
    camera_from_head: RigidTransform
    mask: Mask

    def __post_init__(self) -> None:
        size = np.empty((self.camera.height, self.camera.width))
        require_same_size(self.mask, "silhouette", size, "the camera's image")


@dataclass(frozen=True, kw_only=True, eq=False)
class Box:
    """A box in the head frame, axes parallel to it. low, high: (3,)."""

    low: Vector3
    high: Vector3

    @property
    def diagonal(self) -> float:
        """Length from corner to corner."""
        return float(np.linalg.norm(self.high - self.low))


@dataclass(frozen=True, kw_only=True, eq=False)
class DistanceGrid:
    """Signed distance, positive inside, at the points low + cell · (i, j, k); values: (nx, ny, nz)."""

    low: Vector3
    cell: float
    values: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", read_only(np.asarray(self.values)))

    def at(self, points: Points) -> FloatArray:
        """Interpolate the distance at points (n, 3); beyond the grid its border counts."""
        places = ((np.asarray(points) - self.low) / self.cell).T
        return ndimage.map_coordinates(self.values, places, order=1, mode="nearest")


def fit_hull(views: Sequence[SilhouetteView], box: Box, steps: HeadSteps) -> DistanceGrid:
    """Carve the box by all silhouettes: the least signed distance to the outline over the views.

    Distances in pixels become lengths at the point's own depth. Outside a view nothing is known and nothing
    is carved; the box closes the hull where no view does. Raises `BadCalibration` where nothing remains.
    """
    cell = float(np.max(box.high - box.low)) / steps.hull_cells
    low = box.low - cell
    counts = np.ceil((box.high - low) / cell).astype(int) + 2
    outlines = [signed_distance_px(view.mask) for view in views]
    values = np.empty(counts, np.float32)
    for slab, places in zip(values, np.moveaxis(np.indices(values.shape), 0, -1), strict=True):
        slab.ravel()[:] = _carved(views, outlines, box, places.reshape(-1, 3) * cell + low)
    return DistanceGrid(low=low, cell=cell, values=largest_part(values, cell))


def mesh_of_grid(grid: DistanceGrid) -> Mesh:
    """Return the zero surface: triangles face outwards, unit normals."""
    vertices, faces = isosurface(np.pad(grid.values, 1, constant_values=-grid.cell))
    vertices = (vertices - 1.0) * grid.cell + grid.low
    return Mesh(vertices=vertices, faces=faces, normals=vertex_normals(vertices, faces))


def largest_part(values: FloatArray, cell: float) -> FloatArray:
    """Turn all but the largest connected inside into outside; raise `BadCalibration` where there is none."""
    labels, count = ndimage.label(values > 0)
    if not count:
        raise BadCalibration(
            "hull: no point lies inside all silhouettes; check that the head alone is bright and that poses "
            "and focal length are right"
        )
    largest = 1 + int(np.argmax(np.bincount(labels.ravel())[1:]))
    return np.where((labels > 0) & (labels != largest), np.float32(-cell), values)


def _carved(
    views: Sequence[SilhouetteView], outlines: Sequence[Float32Array], box: Box, points: Points
) -> FloatArray:
    """Return the signed distance (n,) of points (n, 3)."""
    distances = np.stack(
        [_distance_in_view(view, outline, points) for view, outline in zip(views, outlines, strict=True)]
    )
    shown = np.isfinite(distances).sum(axis=0)
    inside = np.where(shown >= max(1, len(views) // _SHARE_OF_VIEWS), distances.min(axis=0), -box.diagonal)
    return np.minimum(inside, np.minimum(points - box.low, box.high - points).min(axis=1))


def _distance_in_view(view: SilhouetteView, outline: Float32Array, points: Points) -> FloatArray:
    """Signed distance (n,) in length units; infinite where the view does not show the point."""
    moved = view.camera_from_head.apply(points)
    distance = sampled(outline, view.camera.project(moved), outside=np.inf)
    known = np.isfinite(distance) & (moved[:, 2] > 0)
    return np.where(known, distance * moved[:, 2] / view.camera.matrix[0, 0], np.inf)


def signed_distance_px(mask: Mask) -> Float32Array:
    """Distance to the outline in pixels, positive inside; the image's edge is no outline."""
    inner = cv2.copyMakeBorder(mask.astype(np.uint8), 1, 1, 1, 1, cv2.BORDER_REPLICATE)
    inside = cv2.distanceTransform(inner, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    outside = cv2.distanceTransform(1 - inner, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)[1:-1, 1:-1]
    # the outline runs half-way between the last pixel inside and the first outside
    return np.asarray(np.where(mask, inside - 0.5, 0.5 - outside), dtype=np.float32)


def box_about_points(points: Points) -> Box:
    """Return the box in which a head lies whose face shows these points (n, 3), head frame, y down.

    Silhouettes bound it to all sides but behind and below: behind, where the hair shows no points, the skull
    is about as deep again; below, the neck does not turn with the head and is cut at the lowest points.
    """
    low, high = np.quantile(points, 0.005, axis=0), np.quantile(points, 0.995, axis=0)
    size = high - low
    return Box(
        low=low - size * [0.4, 0.5, 0.4], high=high + np.array([0.4 * size[0], 0.0, max(size[2], size[0])])
    )


# Choice of views by the turn of the head: evenly spread ones, and neighbours.


def spread_over_turn(views: Sequence[SilhouetteView], count: int) -> IntArray:
    """Choose views (count,) spread evenly over the turn, by their angle from the first one's end."""
    angles = turn_angles_deg([view.camera_from_head for view in views])
    wanted = np.linspace(angles.min(), angles.max(), count) if count > 1 else [np.median(angles)]
    return np.unique([int(np.argmin(np.abs(angles - angle))) for angle in wanted])


def turn_angles_deg(poses: Sequence[RigidTransform], reference: int = 0) -> FloatArray:
    """Return the turn (f,) of every pose from the reference, signed, about the axis most turning is about."""
    turns = np.array([(pose @ poses[reference].inverse()).rotation_vector for pose in poses])
    _, _, right = np.linalg.svd(turns, full_matrices=False)
    return np.rad2deg(turns @ right[0])


def neighbours_of(views: Sequence[SilhouetteView], reference: int, angles_deg: Sequence[float]) -> list[int]:
    """Return the views nearest to the given turns to both sides of the reference, at least half as far."""
    apart = turn_angles_deg([view.camera_from_head for view in views], reference)
    chosen: list[int] = []
    for angle in angles_deg:
        for signed in (-angle, angle):
            k = int(np.argmin(np.abs(apart - signed)))
            if 0.5 * angle < apart[k] * np.sign(signed) < 2.0 * angle and k not in chosen:
                chosen.append(k)
    return chosen

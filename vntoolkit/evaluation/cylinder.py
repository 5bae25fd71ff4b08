"""A cylinder seen by a camera: rays, silhouette distance, and the errors of normals measured on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import angles_between_deg
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rays import pixel_rays

_FEWEST_PIXELS = 200
_SIDE_DEG = 45.0  # an end's normals are 90 degrees from the side's


@dataclass(frozen=True, kw_only=True, eq=False)
class Cylinder:
    """An endless cylinder in the camera frame.

    axis: (3,) unit vector. centre: (3,) the axis' point nearest to the camera centre (orthographic: to the
    image centre's ray at z = 0). radius: length unit of the camera (orthographic: pixels / K[0, 0]). A
    perspective camera sees only ratios: there the radius is 1 and the centre is in radii.
    """

    axis: Vector3
    centre: Vector3
    radius: float = 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Intersection:
    """Where rays meet the near side: normals (..., 3), position along the axis (...), and whether they do."""

    normals: FloatArray
    along: FloatArray
    hit: Mask


def intersect(cylinder: Cylinder, origins: FloatArray, rays: FloatArray) -> Intersection:
    """Meet rays (..., 3) with the cylinder; normals are 0 where a ray misses."""
    across = np.eye(3) - np.outer(cylinder.axis, cylinder.axis)
    from_centre, step = (origins - cylinder.centre) @ across, rays @ across
    a = np.sum(step**2, axis=-1)
    b = np.sum(step * from_centre, axis=-1)
    c = np.sum(from_centre**2, axis=-1) - cylinder.radius**2
    discriminant = b * b - a * c
    hit = (discriminant > 0) & (a > 1e-12)
    distance = (-b - np.sqrt(np.where(hit, discriminant, 0))) / np.where(hit, a, 1)
    normals = (from_centre + distance[..., None] * step) / cylinder.radius
    along = (origins - cylinder.centre) @ cylinder.axis + distance * (rays @ cylinder.axis)
    return Intersection(normals=np.where(hit[..., None], normals, 0), along=np.where(hit, along, 0), hit=hit)


def distance_from_touching_px(
    cylinder: Cylinder, origins: FloatArray, rays: FloatArray, camera: Camera
) -> FloatArray:
    """How far, in pixels, each ray (n, 3) passes outside (+) or inside (−) the cylinder."""
    plane = np.stack(across_axis(cylinder.axis, least_aligned(cylinder.axis)))
    offsets, steps = (cylinder.centre - origins) @ plane.T, rays @ plane.T
    distance = np.abs(plane_cross(offsets, steps)) / np.linalg.norm(steps, axis=1)
    angle_or_length = distance - cylinder.radius
    if camera.is_perspective:  # an angle seen from the camera centre
        angle_or_length = angle_or_length / np.linalg.norm(offsets, axis=1)
    return angle_or_length * camera.matrix[0, 0]


def across_axis(axis: Vector3, near: Vector3) -> tuple[Vector3, Vector3]:
    """Return two unit vectors that span the plane across the axis, the first as near as can be to `near`."""
    first = near - (near @ axis) * axis
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def least_aligned(axis: Vector3) -> Vector3:
    """Return the coordinate axis that is farthest from `axis`."""
    return np.eye(3)[int(np.argmin(np.abs(axis)))]


def plane_cross(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the scalar cross product of plane vectors (n, 2)."""
    return first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]


@dataclass(frozen=True, kw_only=True, eq=False)
class SideAngles:
    """Angles in degrees (h, w) between measured normals and the cylinder's, and where its side is seen."""

    angles_deg: FloatArray
    side: Mask


def side_angles(cylinder: Cylinder, normal_map: NormalMap, camera: Camera, name: str = "frame") -> SideAngles:
    """Measure the normals of the cylinder's side.

    The ends' discs are left out by where they lie along the axis, not pixel by pixel, so that bad normals on
    the side still count. Raises `BadInput` where too little of the side is seen.
    """
    met = intersect(cylinder, *pixel_rays(camera, camera.pixel_grid()))
    seen = normal_map.mask & met.hit
    angles = np.where(seen, angles_between_deg(normal_map.normals_in_camera, met.normals), 0.0)
    low, high = _extent(met.along[seen], angles[seen] < _SIDE_DEG)
    side = seen & (met.along >= low) & (met.along <= high)
    count = int(np.count_nonzero(side))
    if count < _FEWEST_PIXELS:
        raise BadInput(
            f"cylinder: {name} shows {count} valid pixels of the side, at least {_FEWEST_PIXELS} are needed"
        )
    return SideAngles(angles_deg=np.where(side, angles, 0.0), side=side)


def axis_error_deg(cylinder: Cylinder, axis: Vector3) -> float:
    """Angle in degrees between the fitted and the true axis, whichever way round."""
    unit = axis / np.linalg.norm(axis)
    return float(min(angles_between_deg(cylinder.axis, unit), angles_between_deg(cylinder.axis, -unit)))


def radius_from_distance(cylinder: Cylinder, camera: Camera, point: Vector3) -> float:
    """Return the fitted radius in the unit of `point`, a point (3,) on the true axis.

    A perspective camera sees the ratio of radius to distance; the true distance makes it a length.
    """
    if not camera.is_perspective:
        return cylinder.radius
    across = point - (point @ cylinder.axis) * cylinder.axis
    return float(np.linalg.norm(across) / np.linalg.norm(cylinder.centre) * cylinder.radius)


def _extent(along: FloatArray, agrees: Mask) -> tuple[float, float]:
    """Interval of positions along the axis that holds most pixels that agree and fewest that do not."""
    if not len(along):
        return 0.0, 0.0
    order = np.argsort(along)
    positions, votes = along[order], np.where(agrees[order], 1, -1)
    middle = len(votes) // 2
    above = np.cumsum(votes[middle:])
    below = np.cumsum(votes[:middle][::-1])
    high = middle + int(np.argmax(above))
    low = middle - 1 - int(np.argmax(below)) if len(below) else 0
    return float(positions[low]), float(positions[high])

"""A cylinder seen by a camera: its pose, its normals, and how far silhouette rays miss touching it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Vector3
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap


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


def camera_rays(camera: Camera, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return origins and directions (..., 3) of the rays of pixels (..., 2) in the camera frame."""
    points = camera.unproject(pixels, np.ones(pixels.shape[:-1]))
    if camera.is_perspective:
        return np.zeros_like(points), points
    return points * [1.0, 1.0, 0.0], np.broadcast_to([0.0, 0.0, 1.0], points.shape)


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


def cylinder_normals(cylinder: Cylinder, camera: Camera) -> NormalMap:
    """Return the normals (h, w, 3) of the cylinder's side, ends open, wherever a pixel's ray meets it."""
    met = intersect(cylinder, *camera_rays(camera, camera.pixel_grid()))
    return NormalMap(normals_in_camera=met.normals, mask=met.hit)


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

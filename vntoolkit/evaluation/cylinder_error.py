"""Measured normals against those of a fitted cylinder, on its side; and the fit itself against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import angles_between_deg
from vntoolkit.evaluation.cylinder import Cylinder, camera_rays, intersect
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap

_FEWEST_PIXELS = 200
_SIDE_DEG = 45.0  # an end's normals are 90 degrees from the side's


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
    met = intersect(cylinder, *camera_rays(camera, camera.pixel_grid()))
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

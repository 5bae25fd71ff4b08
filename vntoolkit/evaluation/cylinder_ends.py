"""The two ends of a cylinder's silhouette: how far their arcs bulge tells how far it leans in depth.

The sides of a silhouette converge so little under a long lens that a tilt of a degree moves them by a
fraction of a pixel. The rim of an end is a circle seen at a slant, whose image is as deep as the tilt is
large: the same degree moves it by pixels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.evaluation.cylinder import Cylinder, across_axis, camera_rays, least_aligned
from vntoolkit.geometry.camera import Camera

_RIM_POINTS = 180
_LEAST_FACING = 0.35  # sine of the angle to the sides from which the outline belongs to an end
_FEWEST_POINTS = 15
_REACH_SHARE = 0.25  # of the silhouette's length: where an end's rim can lie


@dataclass(frozen=True, kw_only=True, eq=False)
class EndPoints:
    """Outline of one end: points (n, 2) in pixels and their outward unit normals (n, 2).

    direction: (2,) unit vector in the image from the cylinder's middle to this end. along: where the end
    lies on the axis, from the cylinder's centre, to begin with.
    """

    points: Points2
    outward: FloatArray
    direction: FloatArray
    along: float


def end_points(
    contour: Points2, outward: FloatArray, cylinder: Cylinder, camera: Camera
) -> tuple[EndPoints, ...]:
    """Return the outlines of the ends that the silhouette shows, two, one or none."""
    middle = along_axis(cylinder, contour.mean(axis=0), camera)
    near = camera.project(
        cylinder.centre + (middle + np.array([[0.0], [0.01 * cylinder.radius]])) * cylinder.axis
    )
    image_axis = near[1] - near[0]
    length = np.linalg.norm(image_axis)
    if length < 1e-6:  # the axis points at the camera
        return ()
    image_axis /= length
    facing = outward @ image_axis
    position = contour @ image_axis
    reach = _REACH_SHARE * np.ptp(position)
    ends = []
    for sign in (-1.0, 1.0):
        farthest = float(np.max(sign * position))
        chosen = (sign * facing > _LEAST_FACING) & (sign * position > farthest - reach)
        if np.count_nonzero(chosen) < _FEWEST_POINTS:
            continue
        end = EndPoints(
            points=contour[chosen],
            outward=outward[chosen],
            direction=sign * image_axis,
            along=along_axis(cylinder, np.median(contour[chosen], axis=0), camera),
        )
        ends.append(replace(end, along=_best_place(cylinder, end, camera)))
    return tuple(ends)


def along_axis(cylinder: Cylinder, pixel: FloatArray, camera: Camera) -> float:
    """Where the axis passes nearest to a pixel's ray, from the centre, in the cylinder's unit of length."""
    origin, ray = camera_rays(camera, pixel)
    ray = ray / np.linalg.norm(ray)
    offset = origin - cylinder.centre
    slant = float(cylinder.axis @ ray)
    return float(offset @ (cylinder.axis - slant * ray)) / max(1e-9, 1.0 - slant**2)


def _best_place(cylinder: Cylinder, end: EndPoints, camera: Camera) -> float:
    """Where the rim fits the outline best: the arc's middle lies up to a radius beyond its plane."""
    place, step = end.along, 0.1 * cylinder.radius
    for _ in range(2):
        tried = place + step * np.arange(-12, 13)
        misfits = [np.median(np.abs(distance_from_rim_px(cylinder, t, end, camera))) for t in tried]
        place, step = float(tried[int(np.argmin(misfits))]), step / 12
    return place


def distance_from_rim_px(cylinder: Cylinder, along: float, end: EndPoints, camera: Camera) -> FloatArray:
    """How far, in pixels, each outline point (n,) lies outside (+) or inside (−) the rim's outer half.

    along: where the end's plane cuts the axis, from the centre, in the cylinder's unit of length.
    """
    middle = cylinder.centre + along * cylinder.axis
    first, second = across_axis(cylinder.axis, least_aligned(cylinder.axis))
    angle = np.linspace(0, 2 * np.pi, _RIM_POINTS, endpoint=False)
    circle = middle + cylinder.radius * (np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second)
    rim, centre = camera.project(circle), camera.project(middle[None])[0]
    after = np.roll(rim, -1, axis=0)
    outer = ((rim + after) / 2 - centre) @ end.direction >= 0
    start, step = rim[outer], (after - rim)[outer]
    offset = end.points[:, None] - start
    share = np.clip(np.sum(offset * step, axis=2) / np.maximum(np.sum(step**2, axis=1), 1e-12), 0.0, 1.0)
    apart = offset - share[..., None] * step
    nearest = np.argmin(np.sum(apart**2, axis=2), axis=1)
    chosen = apart[np.arange(len(nearest)), nearest]
    return np.asarray(np.sum(chosen * end.outward, axis=1))

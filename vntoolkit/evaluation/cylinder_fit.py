"""Fit of one cylinder to a sequence of normal maps and silhouettes (brostow2011, Figure 7).

Normals find the axis from nothing. Then the silhouette is the convex hull of the two rims in the image: least
squares with Cauchy's robust loss brings it to the silhouette's outline. The normals' axis stays in as one
measurement, since normals have errors in common, which no number of pixels averages out.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial import ConvexHull

from vntoolkit.arrays import FloatArray, Points, Points2, Vector3
from vntoolkit.errors import BadInput, SolverFailed
from vntoolkit.evaluation.cylinder import (
    FEWEST_PIXELS,
    Cylinder,
    across_axis,
    contour_of,
    intersect,
    least_aligned,
    plane_cross,
)
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rays import pixel_rays

_MOST_SAMPLES = 20000  # normals
_MOST_OUTLINE_POINTS = 800
_FEWEST_OUTLINE_POINTS = 40
_PAIRS = 300
_LEAST_SUPPORT = 0.3  # share of the normals that must agree on the axis
_SUPPORT_DEG = 8.0  # a normal this close to the perpendicular to an axis supports it
_OUTLINE_PX = 0.3  # spread of contour points
_COMMON_DEG = 4.0  # error that a frame's good normals have in common
_RIM_POINTS = 90


@dataclass(frozen=True, kw_only=True, eq=False)
class _Observation:
    """One frame: normals (n, 3), points of the outline (k, 2) in pixels, and their origins and rays."""

    normals: Points
    outline: Points2
    origins: Points
    rays: Points
    name: str


def fit_cylinder(
    frames: Iterable[tuple[NormalMap, FloatArray]], camera: Camera, rng: np.random.Generator
) -> tuple[Cylinder, ...]:
    """Fit a common radius and a pose per frame to (normal map, silhouette) pairs.

    A silhouette (h, w) is the share of each pixel that is covered, 0 to 1, or a mask; with coverage the
    outline is known to a fraction of a pixel.

    Raises `BadInput` for a frame with too few normals or contour points, `SolverFailed` where a frame's
    normals agree on no axis.
    """
    observations = (
        _observe(normal_map, silhouette, camera, rng, f"frame {number}")
        for number, (normal_map, silhouette) in enumerate(frames)
    )
    if camera.is_perspective:  # a radius of 1 for all: every frame stands alone
        fits = [_solve(seen, start_of(seen, camera, rng), camera, 1.0) for seen in observations]
    else:
        kept = list(observations)
        free = [_solve(seen, start_of(seen, camera, rng), camera, None) for seen in kept]
        radius = float(np.median([fit.radius for fit in free])) if free else 1.0
        fits = [_solve(seen, fit, camera, radius) for seen, fit in zip(kept, free, strict=True)]
    if not fits:
        raise BadInput("cylinder: the sequence has no frame")
    return tuple(replace(fit, axis=fit.axis * _sign(fit.axis)) for fit in fits)


def _observe(
    normal_map: NormalMap, silhouette: FloatArray, camera: Camera, rng: np.random.Generator, name: str
) -> _Observation:
    rows, columns = np.nonzero(normal_map.mask & (silhouette > 0.5))
    if len(rows) < FEWEST_PIXELS:
        raise BadInput(f"cylinder: {name} has {len(rows)} valid normals, at least {FEWEST_PIXELS} are needed")
    outline, _ = contour_of(silhouette)
    if len(outline) < _FEWEST_OUTLINE_POINTS:
        raise BadInput(f"cylinder: {name} has no usable silhouette ({len(outline)} contour points)")
    outline = rng.permutation(outline)[:_MOST_OUTLINE_POINTS]
    chosen = rng.permutation(len(rows))[:_MOST_SAMPLES]
    normals = normal_map.normals_in_camera[rows[chosen], columns[chosen]].astype(np.float64)
    origins, rays = pixel_rays(camera, outline)
    return _Observation(normals=normals, outline=outline, origins=origins, rays=rays, name=name)


def start_of(seen: _Observation, camera: Camera, rng: np.random.Generator) -> Cylinder:
    """Return a cylinder near to that of a frame: its axis from the normals, the rest from its width."""
    axis = axis_from_normals(seen.normals, float(np.sin(np.deg2rad(_SUPPORT_DEG))), rng, seen.name)
    plane = np.stack(across_axis(axis, least_aligned(axis)))
    origins, rays = seen.origins @ plane.T, seen.rays @ plane.T
    if camera.is_perspective:  # an angle between two rays
        middle = rays.mean(axis=0)
        angles = np.arctan2(plane_cross(np.broadcast_to(middle, rays.shape), rays), rays @ middle)
        low, high = angles.min(), angles.max()
        turn = np.arctan2(middle[1], middle[0]) + (low + high) / 2
        centre = np.array([np.cos(turn), np.sin(turn)]) / np.sin((high - low) / 2)
        return Cylinder(axis=axis, centre=centre @ plane)
    ray = rays[0] / np.linalg.norm(rays[0])
    offsets = origins @ [-ray[1], ray[0]]
    centre = (offsets.min() + offsets.max()) / 2 * np.array([-ray[1], ray[0]])
    return Cylinder(axis=axis, centre=centre @ plane, radius=float(np.ptp(offsets)) / 2)


def axis_from_normals(normals: Points, limit: float, rng: np.random.Generator, name: str) -> Vector3:
    """Return the direction that most normals are perpendicular to: the best of many pairs'.

    limit: sine of the angle within which a normal counts as perpendicular.
    """
    pairs = rng.integers(0, len(normals), (_PAIRS, 2))
    axes = np.cross(normals[pairs[:, 0]], normals[pairs[:, 1]])
    lengths = np.linalg.norm(axes, axis=1)
    axes = axes[lengths > 0.2] / lengths[lengths > 0.2, None]
    if not len(axes):
        raise SolverFailed(f"cylinder: {name} shows a plane, its normals span no axis")
    residuals = np.abs(normals @ axes.T)
    axis = axes[int(np.argmin(np.minimum(residuals, limit).sum(axis=0)))]
    if np.mean(np.abs(normals @ axis) < limit) < _LEAST_SUPPORT:
        raise SolverFailed(
            f"cylinder: in {name} less than a third of the normals agree on an axis; is a cylinder in sight, "
            "and nothing else inside the mask?"
        )
    for _ in range(10):
        weights = 1.0 / (1.0 + (normals @ axis / limit) ** 2) ** 2
        axis = np.linalg.eigh((normals * weights[:, None]).T @ normals)[1][:, 0]
    return axis


def _solve(seen: _Observation, start: Cylinder, camera: Camera, radius: float | None) -> Cylinder:
    """Least squares over axis, centre, the ends' places on the axis and, where it is None, radius."""
    met = intersect(start, seen.origins, seen.rays)
    if not met.hit.any():
        raise SolverFailed(f"cylinder: in {seen.name} the cylinder of the normals lies beside the silhouette")
    first, second = across_axis(start.axis, least_aligned(start.axis))

    def cylinder(unknown: FloatArray) -> Cylinder:
        axis = start.axis + unknown[0] * first + unknown[1] * second
        axis /= np.linalg.norm(axis)
        centre = unknown[2:4] @ np.stack(across_axis(axis, first))
        return Cylinder(axis=axis, centre=centre, radius=float(unknown[6]) if radius is None else radius)

    def residuals(unknown: FloatArray) -> FloatArray:
        outline = outline_px(cylinder(unknown), unknown[4:6], first, camera)
        return np.append(
            distances_px(seen.outline, outline) / _OUTLINE_PX, unknown[:2] / np.deg2rad(_COMMON_DEG)
        )

    ends = np.percentile(met.along[met.hit], [2, 98])
    free = [start.radius] if radius is None else []
    begin = np.array([0.0, 0.0, start.centre @ first, start.centre @ second, *ends, *free])
    for loss in ("soft_l1", "cauchy"):  # the first leads there, the second passes over an end in the dark
        begin = least_squares(residuals, begin, loss=loss, x_scale="jac").x
    return cylinder(begin)


def outline_px(cylinder: Cylinder, ends: FloatArray, near: Vector3, camera: Camera) -> Points2:
    """Return the outline (k, 2) in the image of a cylinder whose ends lie at two places along its axis.

    near: about across the axis, where the rims begin: they must not jump when the axis turns a little.
    """
    turn = np.linspace(0, 2 * np.pi, _RIM_POINTS, endpoint=False)[:, None]
    first, second = across_axis(cylinder.axis, near)
    rim = cylinder.centre + cylinder.radius * (np.cos(turn) * first + np.sin(turn) * second)
    rims = camera.project(np.concatenate([rim + end * cylinder.axis for end in ends]))
    return rims[ConvexHull(rims).vertices]


def distances_px(points: Points2, outline: Points2) -> FloatArray:
    """Return how far each point (n, 2) lies outside (+) or inside (−) a convex outline (k, 2)."""
    step = np.roll(outline, -1, axis=0) - outline
    away = points[:, None] - outline
    share = np.clip(np.sum(away * step, axis=2) / np.sum(step**2, axis=1), 0.0, 1.0)
    nearest = np.linalg.norm(away - share[..., None] * step, axis=2).min(axis=1)
    inside = (step[:, 0] * away[..., 1] - step[:, 1] * away[..., 0] >= 0).all(axis=1)  # counter-clockwise
    return np.where(inside, -nearest, nearest)


def _sign(axis: FloatArray) -> float:
    """Of the two directions of an axis, the one whose largest component is positive."""
    return float(np.sign(axis[int(np.argmax(np.abs(axis)))]))

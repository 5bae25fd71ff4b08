"""A first cylinder from normals alone: the axis that most are perpendicular to, then a linear solve."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, Points, Vector3
from vntoolkit.errors import SolverFailed
from vntoolkit.evaluation.cylinder import Cylinder, across_axis, least_aligned, plane_cross

_PAIRS = 300
_LEAST_SUPPORT = 0.3  # share of the normals that must agree on the axis


def start_from_normals(
    normals: Points,
    origins: Points,
    rays: Points,
    support_deg: float,
    is_perspective: bool,
    rng: np.random.Generator,
    name: str,
) -> Cylinder:
    """Return a cylinder near to that of the normals, all (n, 3); `name` stands in errors.

    The surface point centre + R n lies on its ray, so (centre + R n − origin) × ray = 0 across the axis.
    Raises `SolverFailed` where the normals span no axis.
    """
    limit = float(np.sin(np.deg2rad(support_deg)))
    axis = axis_from_normals(normals, limit, rng, name)
    plane = np.stack(across_axis(axis, least_aligned(axis)))
    side = np.abs(normals @ axis) < limit
    flat_normals, flat_origins, flat_rays = (x[side] @ plane.T for x in (normals, origins, rays))
    flat_rays /= np.linalg.norm(flat_rays, axis=1, keepdims=True)
    rows = np.stack([flat_rays[:, 1], -flat_rays[:, 0], plane_cross(flat_normals, flat_rays)], axis=-1)
    if is_perspective:  # only the ratio of centre to radius is seen
        return Cylinder(axis=axis, centre=_robust_solve(rows[:, :2], -rows[:, 2]) @ plane)
    *centre, radius = _robust_solve(rows, plane_cross(flat_origins, flat_rays))
    return Cylinder(axis=axis, centre=np.array(centre) @ plane, radius=abs(float(radius)))


def axis_from_normals(normals: Points, limit: float, rng: np.random.Generator, name: str) -> Vector3:
    """Return the direction that most normals are perpendicular to: best of many pairs, then least squares.

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


def _robust_solve(rows: FloatArray, values: FloatArray) -> FloatArray:
    solution = np.linalg.lstsq(rows, values, rcond=None)[0]
    for _ in range(15):
        residuals = rows @ solution - values
        spread = 1.4826 * np.median(np.abs(residuals)) + 1e-12
        weights = 1.0 / (1.0 + (residuals / (2 * spread)) ** 2)
        solution = np.linalg.lstsq(rows * weights[:, None], values * weights, rcond=None)[0]
    return solution

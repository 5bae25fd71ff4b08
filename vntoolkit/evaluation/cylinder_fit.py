"""Fit of one cylinder to a sequence of normal maps and silhouettes (brostow2011, Figure 7).

Normals find the axis from nothing. Then silhouettes and normals are weighed against each other: outlines are
sharp, their sides tell the axis in the image and their ends its tilt in depth; normals tell
both directly, but have errors in common, which no number of pixels averages out.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from vntoolkit.arrays import FloatArray, Matrix3, Points, Points2, Vector3
from vntoolkit.errors import BadInput, SolverFailed
from vntoolkit.evaluation.cylinder import (
    Cylinder,
    across_axis,
    contour_of,
    distance_from_touching_px,
    intersect,
    least_aligned,
    plane_cross,
)
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rays import pixel_rays
from vntoolkit.native import njit

_MOST_SAMPLES = 20000
_FEWEST_PIXELS = 200
_FEWEST_CONTOUR_POINTS = 40
_ROUNDS = 8
_ROUNDS_WITHOUT_ENDS = 3  # the first cylinders are too far off to tell which rim is which
_GATE = 3  # spreads of one component; beyond it a normal does not count
_STRIPS = 72  # round the whole cylinder, half of which is seen
_NARROWEST_SPREAD = 0.01  # radians: normals are never so good that a finer gate would help

# Degrees: a normal this close to perpendicular to an axis supports it.
_SUPPORT_DEG = 8.0
# Degrees: contour points whose tangent is this close to the axis' image lie on the sides, not on the ends.
_PARALLEL_DEG = 12.0
_SILHOUETTE_PX = 0.3  # spread of contour points
_CORRELATED_POINTS = 4.0  # neighbouring contour points that err together
_COMMON_DEG = 4.0  # error that a frame's good normals have in common


@dataclass(frozen=True, kw_only=True, eq=False)
class _Observation:
    """One frame, thinned: pixels (n, 2) and normals (n, 3) of the surface, and the contour."""

    pixels: Points2
    normals: Points
    contour: Points2
    outward: FloatArray
    name: str


def fit_cylinder(
    frames: Iterable[tuple[NormalMap, FloatArray]],
    camera: Camera,
    rng: np.random.Generator,
) -> tuple[Cylinder, ...]:
    """Fit a common radius and a pose per frame to (normal map, silhouette) pairs.

    A silhouette (h, w) is the share of each pixel that is covered, 0 to 1, or a mask; with coverage the
    outline is known to a fraction of a pixel.

    Raises `BadInput` for a frame with too few normals or contour points, `SolverFailed` where a frame's
    normals agree on no axis.
    """
    observations = (
        _observe(normal_map, silhouette, rng, f"frame {number}")
        for number, (normal_map, silhouette) in enumerate(frames)
    )
    if camera.is_perspective:  # a radius of 1 for all: every frame stands alone
        fits = [_fit_frame(seen, camera, rng) for seen in observations]
    else:
        kept = list(observations)
        free = [_fit_frame(seen, camera, rng) for seen in kept]
        radius = float(np.median([fit.radius for fit in free])) if free else 1.0
        fits = [
            _refine(seen, replace(fit, radius=radius), camera, radius)
            for seen, fit in zip(kept, free, strict=True)
        ]
    if not fits:
        raise BadInput("cylinder: the sequence has no frame")
    return tuple(replace(fit, axis=fit.axis * _sign(fit.axis)) for fit in fits)


def _fit_frame(seen: _Observation, camera: Camera, rng: np.random.Generator) -> Cylinder:
    normals = seen.normals.astype(np.float64)
    start = start_from_normals(
        normals, *pixel_rays(camera, seen.pixels), _SUPPORT_DEG, camera.is_perspective, rng, seen.name
    )
    return _refine(seen, start, camera, 1.0 if camera.is_perspective else None)


def _observe(
    normal_map: NormalMap, silhouette: FloatArray, rng: np.random.Generator, name: str
) -> _Observation:
    rows, columns = np.nonzero(normal_map.mask & (silhouette > 0.5))
    if len(rows) < _FEWEST_PIXELS:
        raise BadInput(
            f"cylinder: {name} has {len(rows)} valid normals, at least {_FEWEST_PIXELS} are needed"
        )
    chosen = rng.permutation(len(rows))[:_MOST_SAMPLES]
    pixels = np.stack([columns[chosen], rows[chosen]], axis=-1).astype(np.float32)
    contour, outward = contour_of(silhouette)
    if len(contour) < _FEWEST_CONTOUR_POINTS:
        raise BadInput(f"cylinder: {name} has no usable silhouette ({len(contour)} contour points)")
    return _Observation(
        pixels=pixels,
        normals=normal_map.normals_in_camera[rows[chosen], columns[chosen]],
        contour=contour,
        outward=outward,
        name=name,
    )


def _refine(seen: _Observation, start: Cylinder, camera: Camera, radius: float | None) -> Cylinder:
    """Fit silhouette and normals together, in rounds of what counts as side; radius None: free."""
    for round_ in range(_ROUNDS):
        tolerance_deg = _PARALLEL_DEG * (2.5 if round_ == 0 else 1.0)
        origins, rays = pixel_rays(camera, _side_points(seen, start, camera, tolerance_deg))
        ends = end_points(seen.contour, seen.outward, start, camera) if round_ >= _ROUNDS_WITHOUT_ENDS else ()
        scatter = _scatter(seen, start, camera)
        start = _solve(start, origins, rays, ends, scatter, camera, radius)
    return start


def _scatter(seen: _Observation, cylinder: Cylinder, camera: Camera) -> Matrix3:
    """Mean of n nᵀ over strips along the cylinder, n a strip's mean normal, (3, 3); wrong normals left out.

    A wrong normal may happen to be perpendicular to the axis, but it seldom fits its place as well: Tukey's
    weights of the angle between measured and expected normal, whose median is 1.18 spreads of a component.
    And wrong normals err together, where a light is blocked or mirrored: Cauchy's weights of whole strips.
    """
    met = intersect(cylinder, *pixel_rays(camera, seen.pixels))
    if not met.hit.any():
        raise SolverFailed(f"cylinder: in {seen.name} the cylinder of the normals lies beside the silhouette")
    normals, expected = seen.normals[met.hit].astype(np.float64), met.normals[met.hit]
    apart = np.linalg.norm(normals - expected, axis=1)
    spread = max(_NARROWEST_SPREAD, float(np.median(apart)) / 1.18)
    weights = np.maximum(1.0 - (apart / (_GATE * spread)) ** 2, 0.0) ** 2
    plane = np.stack(across_axis(cylinder.axis, least_aligned(cylinder.axis)))
    turn = np.arctan2(*(expected @ plane.T).T)  # round the axis
    strips = ((turn + np.pi) / (2 * np.pi) * _STRIPS).astype(int) % _STRIPS
    total = np.bincount(strips, weights, _STRIPS)
    means = np.stack([np.bincount(strips, weights * normals[:, i], _STRIPS) for i in range(3)], axis=1)
    kept = total > 0.1 * total.mean()
    means, total = means[kept] / total[kept, None], total[kept]
    tilt = means @ cylinder.axis
    tilt_spread = 1.48 * np.median(np.abs(tilt)) + 1e-6
    total /= 1.0 + (tilt / (2.0 * tilt_spread)) ** 2
    return (means * total[:, None]).T @ means / total.sum()


def _solve(
    start: Cylinder,
    origins: Points,
    rays: Points,
    ends: "tuple[EndPoints, ...]",
    scatter: Matrix3,
    camera: Camera,
    radius: float | None,
) -> Cylinder:
    """Least squares over axis, centre, the ends' places on the axis and, where it is free, radius."""
    first, second = across_axis(start.axis, least_aligned(start.axis))
    squared, vectors = np.linalg.eigh(scatter)
    root = np.sqrt(np.maximum(squared, 0))[:, None] * vectors.T / np.deg2rad(_COMMON_DEG)

    def cylinder(unknown: FloatArray) -> Cylinder:
        axis = start.axis + unknown[0] * first + unknown[1] * second
        axis /= np.linalg.norm(axis)
        centre = unknown[2:4] @ np.stack(across_axis(axis, first))
        return Cylinder(axis=axis, centre=centre, radius=float(unknown[-1]) if radius is None else radius)

    def residuals(unknown: FloatArray) -> FloatArray:
        now = cylinder(unknown)
        missed = [distance_from_touching_px(now, origins, rays, camera)]
        missed += [
            distance_from_rim_px(now, along, end, camera)
            for along, end in zip(unknown[4:], ends, strict=False)
        ]
        outline = _cauchy(np.concatenate(missed) / _SILHOUETTE_PX)
        return np.concatenate([outline / np.sqrt(_CORRELATED_POINTS), root @ now.axis])

    begin = [0.0, 0.0, start.centre @ first, start.centre @ second, *(end.along for end in ends)]
    solved = least_squares(residuals, begin + ([start.radius] if radius is None else []), x_scale="jac")
    return cylinder(solved.x)


def _cauchy(residuals: FloatArray) -> FloatArray:
    """Residuals whose squares are Cauchy's robust loss of the given ones."""
    return np.sign(residuals) * np.sqrt(np.log1p(residuals**2))


_ENDS_PERCENT = 10.0  # of the sides' length, at each end, where the ends' arcs round the corner


def _side_points(seen: _Observation, start: Cylinder, camera: Camera, tolerance_deg: float) -> Points2:
    """Contour points whose tangent runs along the image of the axis."""
    centre = start.centre if camera.is_perspective else start.centre * [1, 1, 0]
    ends = camera.project(np.stack([centre - 0.1 * start.axis, centre + 0.1 * start.axis]))
    along = ends[1] - ends[0]
    length = np.linalg.norm(along)
    if length < 1e-9:
        raise SolverFailed(f"cylinder: in {seen.name} the axis points at the camera, its sides are not seen")
    facing_sideways = np.abs(seen.outward @ (along / length)) < np.sin(np.deg2rad(tolerance_deg))
    if np.count_nonzero(facing_sideways) < _FEWEST_CONTOUR_POINTS:
        raise SolverFailed(f"cylinder: the silhouette of {seen.name} shows no two straight sides")
    sides = seen.contour[facing_sideways]
    position = sides @ along
    low, high = np.percentile(position, [_ENDS_PERCENT, 100 - _ENDS_PERCENT])
    return sides[(position > low) & (position < high)]


def _sign(axis: FloatArray) -> float:
    """Of the two directions of an axis, the one whose largest component is positive."""
    return float(np.sign(axis[int(np.argmax(np.abs(axis)))]))


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


_PAIRS = 300
_LEAST_SUPPORT = 0.3  # share of the normals that must agree on the axis


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


# The ends of the silhouette: how far their arcs bulge gives the tilt of the cylinder in depth.


_LEAST_FACING = 0.35  # sine of the angle to the sides from which the outline belongs to an end
_FEWEST_POINTS = 15
_REACH_SHARE = 0.25  # of the silhouette's length: where an end's rim can lie


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
    origin, ray = pixel_rays(camera, pixel)
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


_RIM_POINTS = 180


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
    return _distance_from_line(end.points, end.outward, start, step)


@njit(cache=True)
def _distance_from_line(points: Points2, outward: Points2, start: Points2, step: Points2) -> FloatArray:
    """How far each point (n, 2) lies from the nearest of the segments (m, 2), along its outward direction."""
    found = np.empty(len(points))
    for i in range(len(points)):
        least = np.inf
        for k in range(len(start)):
            u, v = points[i, 0] - start[k, 0], points[i, 1] - start[k, 1]
            along = u * step[k, 0] + v * step[k, 1]
            share = min(max(along / max(step[k, 0] ** 2 + step[k, 1] ** 2, 1e-12), 0.0), 1.0)
            u -= share * step[k, 0]
            v -= share * step[k, 1]
            if u * u + v * v < least:
                least = u * u + v * v
                found[i] = u * outward[i, 0] + v * outward[i, 1]
    return found

"""A cylinder seen by a camera: rays, the errors of normals on it, and its outline with subpixel accuracy."""

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import FloatArray, LinearImage, Mask, Points2, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rays import pixel_rays
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.spread import robust_deviation

FEWEST_PIXELS = 200
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


def side_angles(
    cylinder: Cylinder, normal_map: NormalMap, camera: Camera, name: str = "frame"
) -> tuple[FloatArray, Mask]:
    """Return the angles in degrees (h, w) to the cylinder's normals, and where its side is seen.

    The ends' discs are left out by where they lie along the axis, not pixel by pixel, so that bad normals on
    the side still count. Raises `BadInput` where too little of the side is seen.
    """
    met = intersect(cylinder, *pixel_rays(camera, camera.pixel_grid()))
    seen = normal_map.mask & met.hit
    angles = np.where(seen, angles_deg(normal_map.normals_in_camera, met.normals), 0.0)
    low, high = _extent(met.along[seen], angles[seen] < _SIDE_DEG)
    side = seen & (met.along >= low) & (met.along <= high)
    count = int(np.count_nonzero(side))
    if count < FEWEST_PIXELS:
        raise BadInput(
            f"cylinder: {name} shows {count} valid pixels of the side, at least {FEWEST_PIXELS} are needed"
        )
    return np.where(side, angles, 0.0), side


def axis_error_deg(cylinder: Cylinder, axis: Vector3) -> float:
    """Angle in degrees between the fitted and the true axis, whichever way round."""
    return float(min(angles_deg(cylinder.axis, axis), angles_deg(cylinder.axis, -axis)))


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


_BACKGROUND_SHARE = 0.02  # border of the image, as a share of its width, that is taken as background
_SIGMAS = 6.0
_CERTAIN_PX = 6
_INWARD_PX = (3.0, 5.0)  # from the edge, where the surface's own brightness is read
_SMOOTHING_PX = 1.5


def silhouette_from_image(rgb: LinearImage) -> FloatArray:
    """Return how much of each pixel (h, w) the subject covers, 0 to 1: the largest bright region, no holes.

    rgb: (h, w, 3) linear. The image's border gives level and noise of the background. Along the outline a
    pixel's brightness over that of its brightest neighbours is the share that is covered. Raises `BadInput`
    where nothing stands out from the background.
    """
    brightness = ndimage.gaussian_filter(rgb.sum(axis=2, dtype=np.float64), 0.7)
    rim = max(2, round(_BACKGROUND_SHARE * rgb.shape[1]))
    border = np.ones(brightness.shape, dtype=np.bool_)
    border[rim:-rim, rim:-rim] = False
    level = np.median(brightness[border])
    noise = robust_deviation(brightness[border] - level)
    floor = 0.004 * (np.percentile(brightness, 99) - level)  # a noiseless background has no spread
    lifted = brightness - level
    regions, count = ndimage.label(lifted > max(_SIGMAS * noise, floor))
    if not count:
        raise BadInput("silhouette: nothing is brighter than the background")
    sizes = np.bincount(regions.ravel())[1:]
    region = ndimage.binary_fill_holes(regions == 1 + int(np.argmax(sizes)))
    # blur carries light some three pixels out: only well inside is a pixel covered for certain
    inner = ndimage.binary_erosion(region, iterations=_CERTAIN_PX, border_value=1)
    rim = ndimage.binary_dilation(region, iterations=2) & ~inner
    share = np.clip(lifted / np.maximum(ndimage.maximum_filter(lifted, size=5), 1e-12), 0.0, 1.0)
    for _ in range(2):  # an edge found gives the brightness there, which gives the edge
        share = _share_of_edge(lifted, inner | (rim & (share > 0.5)), rim)
    return np.where(inner, 1.0, np.where(rim, share, 0.0))


def _share_of_edge(lifted: FloatArray, inside: Mask, rim: Mask) -> FloatArray:
    """Return brightness over that of the surface at the edge (h, w), 0 to 1, on the rim; 0 elsewhere.

    A round surface darkens towards its edge. Its brightness there is a straight line through those a few
    pixels further in, where blur no longer mixes in the background.
    """
    depth = ndimage.distance_transform_edt(inside) - ndimage.distance_transform_edt(~inside)
    depth = depth - np.where(inside, 0.5, -0.5)
    slope_v, slope_u = np.gradient(ndimage.gaussian_filter(depth, 1.5))
    rows, columns = np.nonzero(rim)
    inward = np.stack([slope_v[rows, columns], slope_u[rows, columns]])
    inward /= np.maximum(np.linalg.norm(inward, axis=0), 1e-6)
    edge = np.stack([rows, columns]) - depth[rows, columns] * inward
    near, far = (
        ndimage.map_coordinates(lifted, edge + steps * inward, order=1, mode="nearest")
        for steps in _INWARD_PX
    )
    lever = _INWARD_PX[0] / (_INWARD_PX[1] - _INWARD_PX[0])
    level = np.clip(near - lever * (far - near), 0.3 * near, 1.3 * near)
    share = np.zeros(lifted.shape)
    share[rows, columns] = np.clip(lifted[rows, columns] / np.maximum(level, 1e-12), 0.0, 1.0)
    return share


def contour_of(coverage: FloatArray) -> tuple[Points2, FloatArray]:
    """Return the contour points (n, 2) in pixels and the outward unit normals (n, 2) there.

    coverage: (h, w) from 0 to 1, or a mask. A point lies where the line between neighbouring pixels crosses
    one half, after smoothing: that leaves a straight edge where it is and takes the staircase out of it. The
    image's border gives no points, since the silhouette is cut off there; an image of one row or column gives
    none at all.
    """
    if min(coverage.shape) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    smooth = ndimage.gaussian_filter(coverage.astype(np.float64), _SMOOTHING_PX, mode="nearest")
    above = smooth - 0.5
    points = []
    for axis in (0, 1):
        here = above[:-1] if axis == 0 else above[:, :-1]
        there = above[1:] if axis == 0 else above[:, 1:]
        rows, columns = np.nonzero((here > 0) != (there > 0))
        share = here[rows, columns] / (here[rows, columns] - there[rows, columns])
        step = np.array([0.0, 1.0]) if axis == 0 else np.array([1.0, 0.0])
        points.append(np.stack([columns, rows], axis=-1) + share[:, None] * step)
    contour = np.concatenate(points)
    slope_v, slope_u = np.gradient(smooth)
    at = contour[:, ::-1].T
    outward = -np.stack(
        [ndimage.map_coordinates(slope, at, order=1, mode="nearest") for slope in (slope_u, slope_v)], axis=-1
    )
    length = np.linalg.norm(outward, axis=1)
    kept = length > 1e-3
    return contour[kept], outward[kept] / length[kept, None]

"""The outline of a bright subject before a dark background, with subpixel accuracy."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from vntoolkit.arrays import FloatArray, LinearImage, Mask, Points2
from vntoolkit.errors import BadInput

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
    noise = 1.4826 * np.median(np.abs(brightness[border] - level))
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

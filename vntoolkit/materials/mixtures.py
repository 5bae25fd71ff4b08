"""Mixtures of materials beside seams, which lens and Bayer pattern blur.

Light adds, so that the map of reflectances is blurred as the picture.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.ndimage import correlate1d, maximum_filter, minimum_filter

from vntoolkit.arrays import FloatArray, Mask, MaterialLabels, Points
from vntoolkit.materials.reflectance import CAP, Lamps, lengths_of_normals

INDEPENDENT_PX = 64.0  # pixels that share their errors: lamps, gloss and ambient light change slowly
FIRST_SPREAD = 0.04  # standard deviation of normals' lengths before the footage tells it
SEAM_PRICE = 1.0  # nats, of two pixels of two materials side by side
_MOST_REACH_PX = 3  # to either side, over which a seam is blurred
_REACH_OF_BLUR = 2.5  # standard deviations
_BLURS_PX = (0.0, 0.5, 0.7, 1.0, 1.4)  # standard deviations that are tried
_BESIDE_PX = 2  # of a seam, where pixels tell the blur
_JUDGED = 4000  # pixels beside seams that tell the blur


class Spread(NamedTuple):
    """Standard deviation of normals' lengths beyond noise, which no other material explains.

    of_regions: from region to region: uneven dye, light between folds. of_pixels: within them: knit, gloss.
    """

    of_regions: float
    of_pixels: float


class Seams(NamedTuple):
    """What tells the light on a pixel in one of several materials, or in a mixture of two beside a seam.

    blur_px: standard deviation of the picture's blur. tolerance: variance of normals' lengths, with noise.
    steps: variance of the step of log light from pixel to pixel. noise: standard deviation of a pixel's
    contribution of each lamp.
    """

    blur_px: float
    tolerance: float
    steps: float
    noise: tuple[float, float, float]


def reach_of_blur(blur_px: float) -> int:
    """Pixels to either side that a blur takes light from, but for a hundredth."""
    return min(max(1, int(np.ceil(_REACH_OF_BLUR * blur_px))), _MOST_REACH_PX)


def blur_weights(blur_px: float, reach: int = _MOST_REACH_PX) -> FloatArray:
    """(n,), weights of a blur over the pixels of a window, `reach` to either side."""
    places = np.arange(-reach, reach + 1)
    found = np.exp(-0.5 * (places / max(blur_px, 1e-3)) ** 2)
    return np.asarray(found / found.sum())


def blurred_reflectances(labels: MaterialLabels, rho: Points, blur_px: float, reach: int) -> FloatArray:
    """(h, w, 3), mean reflectance that each pixel shows. rho: (m, 3)."""
    weights = blur_weights(blur_px, reach).astype(np.float32)
    mean = rho.astype(np.float32)[labels]
    for axis in range(2):
        mean = correlate1d(mean, weights, axis=axis, mode="nearest")
    return np.asarray(mean)


def near_seams(labels: MaterialLabels, reach: int) -> Mask:
    """True where another label is within a window, `reach` to either side."""
    side = 2 * reach + 1
    return np.asarray(maximum_filter(labels, side) != minimum_filter(labels, side))


def likeliest_blur_px(
    contributions: FloatArray, lit: Mask, lamps: Lamps, rho: Points, tolerance: float, labels: MaterialLabels
) -> float:
    """The standard deviation of the blur under which normals beside seams are most nearly of unit length.

    contributions: (h, w, 3). tolerance: variance of lengths beyond noise.
    """
    beside = np.flatnonzero(lit & near_seams(labels, _BESIDE_PX))
    beside = beside[:: max(1, len(beside) // _JUDGED)]
    if not len(beside):
        return 0.0
    s, costs = contributions.reshape(-1, 3)[beside], []
    for blur_px in _BLURS_PX:
        mean = blurred_reflectances(labels, rho, blur_px, _MOST_REACH_PX).reshape(-1, 3)[beside]
        error, variance, _ = lengths_of_normals(s, 1.0 / mean, lamps)
        t = error**2 / (variance + tolerance)
        costs.append(float((t / (1.0 + t / CAP**2)).sum()))
    return _BLURS_PX[int(np.argmin(costs))]

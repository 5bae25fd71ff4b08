"""Heights over the plane that fits a surface best; the Gaussian filter that parts them by wavelength.

The filter is the areal Gaussian regression filter of first order (ISO 16610-71 without its robust weights):
every pixel takes the value of the plane that fits its surroundings best, weighted by a Gaussian that lets
half of the amplitude pass at the cutoff wavelength. So a slope that runs over the rim of what is measured
stays a slope, where a plain mean would bend it.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.fft
from scipy.ndimage import fourier_gaussian, map_coordinates

from vntoolkit.arrays import Float64Array, FloatArray, Mask
from vntoolkit.checks import require_some
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap

# Standard deviation over the cutoff wavelength at which a Gaussian passes half of the amplitude.
_OF_CUTOFF = math.sqrt(math.log(2.0) / 2.0) / math.pi
_REACH = 4.0  # standard deviations, beyond which a Gaussian is nothing
_SMALLEST_COVER = 1e-6  # of the Gaussian's weight by measured pixels
_FLAT = 1e-6  # spread of the surroundings, in squared deviations, below which no slope is known


@dataclass(frozen=True, kw_only=True, eq=False)
class HeightMap:
    """Heights towards the viewer (h, w), in a length unit; mask: (h, w), where there is one.

    pitch: length from a column to the next, and from a row to the next.
    """

    heights: Float64Array
    mask: Mask
    pitch: tuple[float, float]

    def part(self, *, longest: float | None, shortest: float | None) -> "HeightMap":
        """Return the heights without wavelengths above `longest` and below `shortest`; None keeps them."""
        heights = self.heights
        if shortest is not None:
            heights = self._smoothed(heights, shortest)
        if longest is not None:
            heights = heights - self._smoothed(heights, longest)
        return replace(self, heights=np.where(self.mask, heights, 0.0))

    def deviations_px(self, cutoff: float) -> tuple[float, float]:
        """Return the Gaussian's deviations along columns and rows that part wavelengths at a cutoff."""
        return _OF_CUTOFF * cutoff / self.pitch[0], _OF_CUTOFF * cutoff / self.pitch[1]

    def _smoothed(self, values: FloatArray, cutoff: float) -> Float64Array:
        return regression_filtered(values, self.mask, self.deviations_px(cutoff))

    def along(
        self, start_px: tuple[float, float], end_px: tuple[float, float]
    ) -> tuple[FloatArray, FloatArray]:
        """Return lengths (n,) along a line of pixels (column, row), and its heights, NaN where none is."""
        (u0, v0), (u1, v1) = start_px, end_px
        height, width = self.mask.shape
        if not all(0 <= u <= width - 1 and 0 <= v <= height - 1 for u, v in (start_px, end_px)):
            raise BadInput(
                f"line: expected two pixels within {width}×{height}, got {u0:g},{v0:g},{u1:g},{v1:g}"
            )
        count = 1 + math.ceil(math.hypot(u1 - u0, v1 - v0))
        if count < 2:
            raise BadInput("line: expected two pixels apart from each other")
        at = np.linspace((v0, u0), (v1, u1), count).T
        lengths = np.hypot((at[1] - u0) * self.pitch[0], (at[0] - v0) * self.pitch[1])
        values = map_coordinates(np.where(self.mask, self.heights, 0.0), at, order=1)
        cover = map_coordinates(self.mask.astype(np.float64), at, order=1)
        return lengths, np.where(cover > 1.0 - 1e-9, values, np.nan)


def heights_from_depth(depth_map: DepthMap, camera: Camera, *, factor: float = 1.0) -> HeightMap:
    """Return the distances of a surface's points from the plane that fits them best.

    factor: what a length of 1 becomes. The pitch is the median distance of neighbouring points along that
    plane. Raises `BadInput` where fewer than three pixels hold a depth, or they are no plane's.
    """
    require_some(depth_map.mask, "depth map")
    points = factor * camera.points_from_depth(np.where(depth_map.mask, depth_map.depth, np.nan))
    measured = points[depth_map.mask]
    centre = measured.mean(axis=0)
    spread, axes = np.linalg.eigh(np.cov((measured - centre).T)) if len(measured) > 2 else (np.zeros(3), None)
    if axes is None or not spread[1] > 0:
        raise BadInput("heights: expected a surface, got pixels on a line")
    normal = axes[:, 0] * -np.sign(axes[2, 0] or 1.0)  # towards the viewer
    heights = np.where(depth_map.mask, (points - centre) @ normal, 0.0)
    pitch = []
    for axis in (1, 0):
        step = np.diff(points, axis=axis)
        step -= (step @ normal)[..., None] * normal
        length = np.linalg.norm(step, axis=-1)
        length = length[np.isfinite(length)]
        if not length.size:
            raise BadInput("heights: expected neighbouring pixels that hold a depth")
        pitch.append(float(np.median(length)))
    return HeightMap(heights=heights, mask=depth_map.mask, pitch=(pitch[0], pitch[1]))


def regression_filtered(values: FloatArray, mask: Mask, deviations_px: tuple[float, float]) -> Float64Array:
    """Return at each pixel (h, w) of the mask the value of the plane that fits its surroundings best.

    deviations_px: of the Gaussian, along columns and rows. 0 outside the mask.
    """
    height, width = mask.shape
    x = np.broadcast_to((np.arange(width) - 0.5 * width) / max(deviations_px[0], 1e-9), mask.shape)
    y = np.broadcast_to(
        ((np.arange(height) - 0.5 * height) / max(deviations_px[1], 1e-9))[:, None], mask.shape
    )
    weight = mask.astype(np.float64)
    known = np.where(mask, values, 0.0)
    products = (weight, weight * x, weight * y, weight * x * x, weight * x * y, weight * y * y)
    sums = [_blurred(image, deviations_px)[mask] for image in (*products, known, known * x, known * y)]
    total = np.maximum(sums[0], _SMALLEST_COVER)
    mean_x, mean_y, mean_z = sums[1] / total, sums[2] / total, sums[6] / total
    xx, xy, yy = sums[3] / total - mean_x**2, sums[4] / total - mean_x * mean_y, sums[5] / total - mean_y**2
    xz, yz = sums[7] / total - mean_x * mean_z, sums[8] / total - mean_y * mean_z
    xx, yy = xx + _FLAT, yy + _FLAT
    determinant = xx * yy - xy**2
    slope_x, slope_y = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
    out = np.zeros(mask.shape)
    out[mask] = mean_z + slope_x * (x[mask] - mean_x) + slope_y * (y[mask] - mean_y)
    return out


def _blurred(image: Float64Array, deviations_px: tuple[float, float]) -> Float64Array:
    """Return (h, w) blurred by a Gaussian; nothing lies beyond the border."""
    (height, width), (across, down) = image.shape, deviations_px
    shape = [
        scipy.fft.next_fast_len(n + math.ceil(2 * _REACH * s), real=True)
        for n, s in ((height, down), (width, across))
    ]
    spectrum = fourier_gaussian(scipy.fft.rfft2(image, s=shape), (down, across), n=shape[1])
    return np.asarray(scipy.fft.irfft2(spectrum, s=shape)[:height, :width])

"""Depth errors after the free scale or offset is removed, and analytic surfaces to measure them on."""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Normals
from vntoolkit.checks import require_same_size, require_some
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap

_PEAKS_RANGE = 14.7  # of the unscaled surface, from −6.55 to 8.11


@dataclass(frozen=True, kw_only=True)
class DepthError:
    """Distances along the optical axis over the pixels that both maps hold valid, in the reference's unit.

    diagonal: of the reference surface's bounding box, same unit.
    """

    pixels: int
    mean: float
    median: float
    p95: float
    diagonal: float

    @property
    def mean_percent(self) -> float:
        """Mean distance in per cent of the diagonal."""
        return 100.0 * self.mean / self.diagonal


def aligned_depth(measured: DepthMap, reference: DepthMap, camera: Camera) -> tuple[FloatArray, Mask]:
    """Return the measured depth (h, w) with its free constant set by the reference, and where both are valid.

    A perspective camera leaves a factor free, an orthographic one an offset: the median of the ratios or of
    the differences, which a few pixels that are far off do not move. 0 outside the common mask. Raises
    `BadInput` for maps of different size or without a common valid pixel.
    """
    require_same_size(measured.mask, "measured depth map", reference.mask, "reference depth map")
    both = measured.mask & reference.mask
    require_some(both, "common mask of the two depth maps")
    ours = measured.depth[both].astype(np.float64)
    theirs = reference.depth[both].astype(np.float64)
    aligned = np.zeros(both.shape)
    if camera.is_perspective:
        aligned[both] = ours * np.median(theirs / ours)
    else:
        aligned[both] = ours + np.median(theirs - ours)
    return aligned, both


def compare_depths(measured: DepthMap, reference: DepthMap, camera: Camera) -> DepthError:
    """Summarise the distances between two depth maps that one camera saw, free constant removed.

    Raises as `aligned_depth` does, and `BadInput` where they have but one pixel in common.
    """
    aligned, both = aligned_depth(measured, reference, camera)
    distances = np.abs(aligned[both] - reference.depth[both])
    points = camera.points_from_depth(np.where(both, reference.depth, np.nan))[both]
    diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
    if not diagonal > 0:
        raise BadInput("depth maps: a single pixel is valid in both, which has no extent to compare with")
    return DepthError(
        pixels=int(both.sum()),
        mean=float(distances.mean()),
        median=float(np.median(distances)),
        p95=float(np.percentile(distances, 95)),
        diagonal=diagonal,
    )


def peaks(size: int) -> tuple[FloatArray, Normals]:
    """Return depth (size, size) in pixels, range a quarter of the size, and normals of Matlab's `peaks`."""
    step = 6.0 / (size - 1)
    x, y = np.meshgrid(step * np.arange(size) - 3.0, step * np.arange(size) - 3.0)
    near, centre = np.exp(-(x**2) - (y + 1) ** 2), np.exp(-(x**2) - y**2)
    left, odd = np.exp(-((x + 1) ** 2) - y**2), x / 5 - x**3 - y**5
    z = 3 * (1 - x) ** 2 * near - 10 * odd * centre - left / 3
    z_x = (-6 * (1 - x) - 6 * x * (1 - x) ** 2) * near - 10 * (0.2 - 3 * x**2 - 2 * x * odd) * centre
    z_x += 2 * (x + 1) / 3 * left
    z_y = -6 * (1 - x) ** 2 * (y + 1) * near + 10 * (5 * y**4 + 2 * y * odd) * centre + 2 * y / 3 * left
    scale = size / 4 / _PEAKS_RANGE
    return z * scale, normals_from_gradient(z_x * step * scale, z_y * step * scale)


def tear(size: int, steepness: float) -> tuple[FloatArray, Normals]:
    """Return depth and normals of a plane with a ramp in its lower right quarter: a growing depth step."""
    v, u = np.mgrid[:size, :size]
    ramp = (u >= size // 2) & (v > size // 2)
    depth = np.where(ramp, steepness * (v - size // 2), 0.0)
    return depth, normals_from_gradient(np.zeros(ramp.shape), np.where(ramp, steepness, 0.0))


def disc_with_hole(size: int) -> Mask:
    """Return a round mask (size, size) with a round hole."""
    v, u = np.mgrid[:size, :size] / size
    disc = (u - 0.5) ** 2 + (v - 0.46) ** 2 < 0.43**2
    return disc & ((u - 0.5) ** 2 + (v - 0.33) ** 2 > 0.1**2)


def normals_from_gradient(p: FloatArray, q: FloatArray) -> Normals:
    """Return unit normals (h, w, 3) in the camera frame of a depth with slopes p along u and q along v."""
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
    return (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)

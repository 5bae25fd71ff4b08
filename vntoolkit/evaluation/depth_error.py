"""Distances between two depth maps, after the scale or offset that normals leave free is removed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_same_size, require_some
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap


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

"""Angular error between normal maps: maps, summaries, histograms."""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Mask
from vntoolkit.checks import require_finite, require_same_size, require_shape, require_some
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.photometry.fit_quality import angles_deg

_STEPS_PER_DEGREE = 100
_STEPS = 180 * _STEPS_PER_DEGREE


@dataclass(frozen=True, kw_only=True)
class AngularError:
    """Summary of the angles, in degrees, over the pixels that both maps hold valid.

    below_5, below_10, below_20: share of pixels, 0 to 1, under that many degrees.
    """

    pixels: int
    mean_deg: float
    median_deg: float
    std_deg: float
    p95_deg: float
    below_5: float
    below_10: float
    below_20: float


def angular_error_map(measured: NormalMap, reference: NormalMap) -> tuple[FloatArray, Mask]:
    """Return the angle in degrees per pixel (h, w), 0 where not compared, and where it was compared.

    Raises `BadInput` for maps of different size or without a common valid pixel.
    """
    require_same_size(measured.mask, "measured normal map", reference.mask, "reference normal map")
    both = measured.mask & reference.mask
    require_some(both, "common mask of the two normal maps")
    angles = np.zeros(both.shape)
    angles[both] = angles_deg(measured.normals_in_camera[both], reference.normals_in_camera[both])
    return angles, both


def evaluate_normals(measured: NormalMap | FloatArray, reference: NormalMap | FloatArray) -> AngularError:
    """Compare normals of a method of one's own with the truth, both in the camera frame, n_z < 0.

    measured, reference: normal maps, or arrays (h, w, 3) of unit vectors, 0 where there is none.
    """
    return compare_normals(_as_map(measured), _as_map(reference))


def _as_map(normals: NormalMap | FloatArray) -> NormalMap:
    if isinstance(normals, NormalMap):
        return normals
    given = np.asarray(normals, dtype=np.float32)
    require_shape(given, (None, None, 3), "normals")
    require_finite(given, "normals")
    return NormalMap(normals_in_camera=given, mask=np.linalg.norm(given, axis=2) > 0.5)


def summarise_angles(angles_deg: FloatArray) -> AngularError:
    """Summarise angles (n,) in degrees; raises `BadInput` for none."""
    angles_deg = np.asarray(angles_deg).ravel()
    require_some(np.ones(angles_deg.shape, dtype=np.bool_), "angles")
    return AngularError(
        pixels=angles_deg.size,
        mean_deg=float(angles_deg.mean()),
        median_deg=float(np.median(angles_deg)),
        std_deg=float(angles_deg.std()),
        p95_deg=float(np.percentile(angles_deg, 95)),
        below_5=float(np.mean(angles_deg < 5)),
        below_10=float(np.mean(angles_deg < 10)),
        below_20=float(np.mean(angles_deg < 20)),
    )


def compare_normals(measured: NormalMap, reference: NormalMap) -> AngularError:
    """Summarise the angle between two normal maps over their common valid pixels."""
    angles, both = angular_error_map(measured, reference)
    return summarise_angles(angles[both])


class AngleHistogram:
    """Histogram of angles over many frames; mean and deviation are exact, percentiles to 0.005 degrees."""

    def __init__(self) -> None:
        self._counts: IntArray = np.zeros(_STEPS + 1, dtype=np.int64)
        self._sum = self._sum_of_squares = 0.0

    def add(self, angles_deg: FloatArray) -> None:
        """Count angles (n,) in degrees."""
        angles = np.asarray(angles_deg, dtype=np.float64).ravel()
        steps = np.minimum(angles * _STEPS_PER_DEGREE, _STEPS).astype(np.int64)
        self._counts += np.bincount(steps, minlength=_STEPS + 1)
        self._sum += float(angles.sum())
        self._sum_of_squares += float((angles**2).sum())

    def summary(self) -> AngularError:
        """Summarise all angles so far; raises `BadInput` for none."""
        total = int(self._counts.sum())
        if not total:
            raise BadInput("angles: no valid pixel to summarise")
        mean = self._sum / total
        return AngularError(
            pixels=total,
            mean_deg=mean,
            median_deg=self._quantile(0.5),
            std_deg=float(np.sqrt(max(self._sum_of_squares / total - mean**2, 0.0))),
            p95_deg=self._quantile(0.95),
            below_5=self._share_below(5),
            below_10=self._share_below(10),
            below_20=self._share_below(20),
        )

    def values(self, count: int = 1000) -> FloatArray:
        """Return `count` angles in degrees spread evenly over the ranks, for a curve."""
        ranks = (np.arange(count) + 0.5) / count
        return np.array([self._quantile(rank) for rank in ranks])

    def _quantile(self, share: float) -> float:
        below = np.cumsum(self._counts)
        step = int(np.searchsorted(below, share * below[-1]))
        return (step + 0.5) / _STEPS_PER_DEGREE

    def _share_below(self, degrees: int) -> float:
        return float(self._counts[: degrees * _STEPS_PER_DEGREE].sum() / self._counts.sum())

"""Angles of a whole sequence summarised in constant memory: counted in steps of a hundredth of a degree."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import AngularError

_STEPS_PER_DEGREE = 100
_STEPS = 180 * _STEPS_PER_DEGREE


class AngleHistogram:
    """Counts angles frame by frame; mean and spread are exact, the rest to half a hundredth of a degree."""

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

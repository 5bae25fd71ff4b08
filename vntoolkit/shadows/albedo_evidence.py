"""What the albedo says about a weak light: missing, or only fading where the surface turns from it.

Plain inversion of a pixel that all three lights reach gives the albedo of its surroundings, however weak one
of them is. Where a light is missing the length |M⁻¹r| comes out different, by as much as that light
would have added: the predicted normal says by how much. Nearer to the one or to the other, and off from
both, as no light that arrives explains, speaks for light or for shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from vntoolkit.arrays import FloatArray, Mask, Matrix3
from vntoolkit.checks import require_in_range
from vntoolkit.shadows.shares import LightShares

_LARGEST_EXCESS = 0.8  # of log albedo: beyond, it is paint or gloss
_SMALLEST = 1e-3
_SHORTEST = 0.05  # of the length that a missing light leaves


@dataclass(frozen=True, kw_only=True)
class AlbedoEvidenceOptions:
    """Units of evidence, as `RobustOptions` has them.

    comparison: per squared log albedo, for being nearer to the albedo with or without the light; it is 1/2σ²
    of the log albedo's spread σ. departure: per squared log albedo, against light that arrives, for any
    departure from the surroundings. most: largest evidence either way. weak_share: only the weakest of a
    pixel's lights is judged, and only below this share of it.
    """

    comparison: float = 4.0
    departure: float = 3.0
    most: float = 2.0
    weak_share: float = 0.4

    def __post_init__(self) -> None:
        require_in_range(self.comparison, 0.0, 100.0, "albedo evidence: comparison")
        require_in_range(self.departure, 0.0, 100.0, "albedo evidence: departure")
        require_in_range(self.most, 0.0, 100.0, "albedo evidence: most")
        require_in_range(self.weak_share, -1.0, 1.0, "albedo evidence: weak share")


def evidence_from_albedo(
    measured: LightShares,
    shares: FloatArray,
    predicted: FloatArray,
    albedo: FloatArray,
    mask: Mask,
    options: AlbedoEvidenceOptions | None = None,
) -> FloatArray:
    """Return (h, w, 3) evidence, positive for light, 0 where it is not asked.

    shares, predicted: (h, w, 3), measured and to be expected where the light arrives. albedo: (h, w), that of
    the surroundings.
    """
    options = options or AlbedoEvidenceOptions()
    evidence: FloatArray = np.zeros(shares.shape, dtype=np.float32)
    _evidence_kernel(
        measured.length, albedo, mask, shares, predicted, np.linalg.inv(measured.directions),
        options.comparison, options.departure, options.most, options.weak_share, evidence,
    )  # fmt: skip
    return evidence


@njit(cache=True)
def _evidence_kernel(
    length: FloatArray, albedo: FloatArray, mask: Mask, shares: FloatArray, predicted: FloatArray,
    duals: Matrix3, comparison: float, departure: float, most: float, weak_share: float, out: FloatArray,
) -> None:  # fmt: skip
    """Fill out (h, w, 3) at each pixel's weakest light. duals: (3, 3), a normal is duals times its shares."""
    h, w = mask.shape
    for v in range(h):
        for u in range(w):
            k = 0
            for i in range(1, 3):
                if shares[v, u, i] < shares[v, u, k]:
                    k = i
            if not mask[v, u] or not shares[v, u, k] < weak_share:
                continue
            lost = max(predicted[v, u, k] - max(shares[v, u, k], 0.0), 0.0)
            squared = 0.0
            for i in range(3):
                part = -lost * duals[i, k]
                for j in range(3):
                    part += duals[i, j] * predicted[v, u, j]
                squared += part * part
            excess = _log(length[v, u] / max(albedo[v, u], _SMALLEST))
            expected = _log(max(np.sqrt(squared), _SHORTEST))
            found = comparison * expected * (expected - 2.0 * excess) - departure * excess * excess
            out[v, u, k] = min(max(found, -most), most)


@njit(cache=True, inline="always")
def _log(ratio: float) -> float:
    return min(max(np.log(max(ratio, _SMALLEST)), -_LARGEST_EXCESS), _LARGEST_EXCESS)

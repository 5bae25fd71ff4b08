"""What the albedo says about a weak light: missing, or only fading where the surface turns from it.

Plain inversion of a pixel that all three lights reach gives the albedo of its surroundings, however weak one
of them is. Where a light is missing the length |M⁻¹r| comes out different, by as much as that light
would have added: the predicted normal says by how much. Nearer to the one or to the other, and off from
both, as no light that arrives explains, speaks for light or for shadow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_in_range
from vntoolkit.shadows.lengths import lengths_of
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
    duals: FloatArray = np.linalg.inv(measured.directions).astype(np.float32)
    weakest = np.argmin(shares, axis=-1)
    for k in range(3):
        here = mask & (weakest == k) & (shares[..., k] < options.weak_share)
        excess = _log(measured.length[here] / np.maximum(albedo[here], _SMALLEST))
        lost = np.maximum(predicted[here][:, k] - np.maximum(shares[here][:, k], 0.0), 0.0)
        left = lengths_of(predicted[here] @ duals.T - lost[:, None] * duals[:, k])[:, 0]
        expected = _log(np.maximum(left, _SHORTEST))
        found = options.comparison * expected * (expected - 2.0 * excess) - options.departure * excess**2
        evidence[here, k] = np.clip(found, -options.most, options.most)
    return evidence


def _log(ratio: FloatArray) -> FloatArray:
    return np.clip(np.log(np.maximum(ratio, _SMALLEST)), -_LARGEST_EXCESS, _LARGEST_EXCESS)

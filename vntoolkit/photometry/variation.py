"""How the light response changes over the image: near lights shine from elsewhere at every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadRig

HIGHEST_DEGREE = 3


@dataclass(frozen=True, kw_only=True, eq=False)
class ResponseVariation:
    """Polynomials of the pixel position (u, v), without their constant terms, which the response holds.

    M(u, v) = M + Σ_k x^i y^j matrices[k] with (i, j) = powers[k], and likewise for the ambient light, where
    x = (u − centre_u) / scale and y = (v − centre_v) / scale. (u, v) is a pixel of the image without lens
    distortion. powers: (k, 2), 1 ≤ i + j ≤ 3. matrices: (k, 3, 3). ambients: (k, 3). centre_px: (2,).
    scale_px: half the longer side of the image, so that x and y stay within ±1.
    """

    powers: npt.NDArray[np.int64]
    matrices: FloatArray
    ambients: FloatArray
    centre_px: FloatArray
    scale_px: float

    def __post_init__(self) -> None:
        powers = np.array(self.powers, dtype=np.int64)
        require_shape(powers, (None, 2), "response variation: powers", BadRig)
        total = powers.sum(axis=1)
        if len(powers) < 1 or powers.min() < 0 or total.min() < 1 or total.max() > HIGHEST_DEGREE:
            raise BadRig(f"response variation: expected powers of total degree 1 to {HIGHEST_DEGREE}")
        if len(np.unique(powers, axis=0)) < len(powers):
            raise BadRig("response variation: a monomial is listed twice")
        object.__setattr__(self, "powers", read_only(powers))
        for name, shape in (
            ("matrices", (len(powers), 3, 3)),
            ("ambients", (len(powers), 3)),
            ("centre_px", (2,)),
        ):
            value = np.array(getattr(self, name), dtype=np.float64)
            require_shape(value, shape, f"response variation: {name}", BadRig)
            require_finite(value, f"response variation: {name}", BadRig)
            object.__setattr__(self, name, read_only(value))
        if not (np.isfinite(self.scale_px) and self.scale_px > 0):
            raise BadRig(f"response variation: expected a positive scale in pixels, got {self.scale_px:g}")

    def monomials(self, positions_px: FloatArray) -> FloatArray:
        """Return x^i y^j, (..., k), at positions (..., 2)."""
        xy = (np.asarray(positions_px, dtype=np.float64) - self.centre_px) / self.scale_px
        return np.asarray((xy[..., None, :] ** self.powers).prod(axis=-1))


def powers_to_degree(degree: int) -> npt.NDArray[np.int64]:
    """All (i, j) with 1 ≤ i + j ≤ degree, (k, 2), by rising degree."""
    return np.array(
        [(total - j, j) for total in range(1, degree + 1) for j in range(total + 1)], dtype=np.int64
    ).reshape(-1, 2)

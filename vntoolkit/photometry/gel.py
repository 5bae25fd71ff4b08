"""The response of a tactile gel: from a pixel's change of colour to the normal there.

A gel is compared with itself: d is a pixel's colour less the colour of the untouched gel there. One M for the
whole gel gives M⁻¹ d = n − n₀, n₀ = (0, 0, −1) the normal of the flat gel. Near lamps, light that the gel
scatters and the camera's colours bend this a little, differently from place to place. A polynomial in
m = M⁻¹ d and in the place corrects it. Each of its terms holds at least one factor of m, so that no change of
colour gives the flat normal, exactly. `tactile/response.py` computes it.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from vntoolkit.arrays import Float64Array, FloatArray
from vntoolkit.checks import set_arrays
from vntoolkit.errors import BadRig
from vntoolkit.geometry.rectification import Rectification

TOTAL_DEGREE = 4  # of a term, in m and place together; the fifth predicts held-back presses hardly better
COLOUR_FACTORS = tuple(
    factors
    for degree in range(1, TOTAL_DEGREE + 1)
    for factors in combinations_with_replacement(range(3), degree)
)  # the components of m that are multiplied, for every monomial of m


def _powers_to_degree(degree: int) -> tuple[tuple[int, int, int], ...]:
    """Of every term of at most this degree: the number of its monomial of m, the powers of x and y."""
    return tuple(
        (k, total - j, j)
        for k, factors in enumerate(COLOUR_FACTORS)
        for total in range(degree - len(factors) + 1)
        for j in range(total + 1)
    )


POWERS = _powers_to_degree(TOTAL_DEGREE)
TERMS = len(POWERS)
TERM_DEGREES = np.array([(len(COLOUR_FACTORS[k]), i + j) for k, i, j in POWERS])  # in m and in the place
_EARLIER_POWERS = _powers_to_degree(3)
EARLIER_TERMS = len(_EARLIER_POWERS)


@dataclass(frozen=True, kw_only=True, eq=False)
class GelResponse:
    """How a gel answers beyond one M, and where it lies in the picture.

    coefficients: (111, 2), what every term adds to s; the terms are the products of one to four of m's
    components, m = M⁻¹ d, with x^i y^j, at most four factors in all, in the order of `terms`.
    x = (u − centre_u) / scale, y = (v − centre_v) / scale. reach: length of m up to which the presses
    determine the terms; a longer m is shortened to it in them. errors_deg: (k, 2), tilts of the gel, growing,
    and the angle that nine of ten normals so tilted stay within, on presses held back from the fit, degrees;
    None where it is not known. untouched: (6, 3), the untouched gel's colour
    as a quadratic of the place, see `tactile/session.py`; None of an earlier rig. rectification: takes the
    picture as filmed, of size `filmed_px` (width, height), to the gel; both None where the pictures are of
    the gel already.
    """

    coefficients: FloatArray
    centre_px: FloatArray
    scale_px: float
    reach: float
    errors_deg: FloatArray | None = None
    untouched: FloatArray | None = None
    rectification: Rectification | None = None
    filmed_px: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        shapes = {"coefficients": (TERMS, 2), "centre_px": (2,), "errors_deg": (None, 2), "untouched": (6, 3)}
        set_arrays(self, shapes, called="gel: {}", dtype=np.float64, error=BadRig)
        errors = self.errors_deg
        if errors is not None and not (
            len(errors) and (np.diff(errors[:, 0]) > 0).all() and (errors >= 0).all()
        ):
            raise BadRig("gel: expected errors at growing tilts, both 0 or more")
        if (self.rectification is None) != (self.filmed_px is None):
            raise BadRig("gel: expected the rectification and the size as filmed, got one of them")
        if not (0 < self.scale_px < np.inf and 0 < self.reach < np.inf):
            raise BadRig(
                f"gel: expected a positive scale and reach, got {self.scale_px:g} and {self.reach:g}"
            )

    @property
    def terms(self) -> Float64Array:
        """(2, 34, 4, 4): for coordinate of s and monomial of m, the coefficient of x^i y^j."""
        laid_out = np.zeros((2, len(COLOUR_FACTORS), TOTAL_DEGREE, TOTAL_DEGREE))
        for (k, i, j), pair in zip(POWERS, self.coefficients, strict=True):
            laid_out[:, k, i, j] = pair
        return laid_out


def completed_coefficients(earlier: FloatArray) -> FloatArray:
    """The coefficients (111, 2) of a correction of the third degree, (46, 2)."""
    coefficients = np.zeros((TERMS, 2))
    coefficients[[POWERS.index(powers) for powers in _EARLIER_POWERS]] = earlier
    return coefficients

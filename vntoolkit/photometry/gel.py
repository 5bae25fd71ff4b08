"""The response of a tactile gel: from a pixel's change of colour to the normal there.

A gel is compared with itself: d is a pixel's colour less the colour of the untouched gel there. One M for the
whole gel gives M⁻¹ d = n − n₀, n₀ = (0, 0, −1) the normal of the flat gel. Near lamps, light that the gel
scatters and the camera's colours bend this a little, differently from place to place. A polynomial in
m = M⁻¹ d and in the place corrects it. Each of its terms holds at least one factor of m, so that no change of
colour gives the flat normal, exactly.

The correction is added in the normal's stereographic coordinates s = n_xy / (1 − n_z). They keep angles: the
same step of s is nearly the same angle wherever the normal points.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from vntoolkit.arrays import Float64Array, FloatArray, Points, Points2, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadRig
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.photometry.response import LightResponse

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


_POWERS = _powers_to_degree(TOTAL_DEGREE)
TERMS = len(_POWERS)
TERM_DEGREES = np.array([(len(COLOUR_FACTORS[k]), i + j) for k, i, j in _POWERS])  # in m and in the place
_EARLIER_POWERS = _powers_to_degree(3)
EARLIER_TERMS = len(_EARLIER_POWERS)
STEEPEST = 0.98  # |s|: 1 is a normal across the line of sight, beyond which nothing is seen


@dataclass(frozen=True, kw_only=True, eq=False)
class GelResponse:
    """How a gel answers beyond one M, and where it lies in the picture.

    coefficients: (111, 2), what every term adds to s; the terms are the products of one to four of m's
    components, m = M⁻¹ d, with x^i y^j, at most four factors in all, in the order of `terms`.
    x = (u − centre_u) / scale, y = (v − centre_v) / scale. reach: length of m up to which the presses
    determine the terms; a longer m is shortened to it in them. errors_deg: (k, 2), tilts of the gel, growing,
    and the angle that nine of ten normals so tilted stay within, on presses held back from the fit, degrees;
    None where it is not known. rectification: takes the picture as filmed,
    of size `filmed_px` (width, height), to the gel; both None where the pictures are of the gel already.
    """

    coefficients: FloatArray
    centre_px: FloatArray
    scale_px: float
    reach: float
    errors_deg: FloatArray | None = None
    rectification: Rectification | None = None
    filmed_px: tuple[int, int] | None = None

    def __post_init__(self) -> None:
        for name, shape in (("coefficients", (TERMS, 2)), ("centre_px", (2,))):
            value = np.array(getattr(self, name), dtype=np.float64)
            require_shape(value, shape, f"gel: {name}", BadRig)
            require_finite(value, f"gel: {name}", BadRig)
            object.__setattr__(self, name, read_only(value))
        if self.errors_deg is not None:
            errors = np.array(self.errors_deg, dtype=np.float64)
            require_shape(errors, (None, 2), "gel: errors", BadRig)
            require_finite(errors, "gel: errors", BadRig)
            if not (len(errors) and (np.diff(errors[:, 0]) > 0).all() and (errors >= 0).all()):
                raise BadRig("gel: expected errors at growing tilts, both 0 or more")
            object.__setattr__(self, "errors_deg", read_only(errors))
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
        for (k, i, j), pair in zip(_POWERS, self.coefficients, strict=True):
            laid_out[:, k, i, j] = pair
        return laid_out

    def normals_from_change(self, change: Points, positions_px: Points2, response: LightResponse) -> Points:
        """Unit normals (n, 3), camera frame, of changes of colour (n, 3) at pixels (n, 2)."""
        scaled = change @ response.inverse.T
        place = (positions_px - self.centre_px) / self.scale_px
        terms = correction_terms(scaled, place, self.reach)
        return normals_from_stereographic(first_estimate(scaled) + terms @ self.coefficients)


def completed_coefficients(earlier: FloatArray) -> FloatArray:
    """The coefficients (111, 2) of a correction of the third degree, (46, 2)."""
    coefficients = np.zeros((TERMS, 2))
    coefficients[[_POWERS.index(powers) for powers in _EARLIER_POWERS]] = earlier
    return coefficients


def first_estimate(scaled: Points) -> Points2:
    """Stereographic coordinates (n, 2) of the normals that M alone gives, n₀ + m for m (n, 3)."""
    z = scaled[:, 2] - 1.0
    length = np.sqrt(scaled[:, 0] ** 2 + scaled[:, 1] ** 2 + z**2)
    return np.asarray(scaled[:, :2] / np.maximum(length - z, 1e-9)[:, None])


def correction_terms(scaled: Points, place: Points2, reach: float) -> FloatArray:
    """The terms of the correction, (n, 111), for m (n, 3) at places (x, y), (n, 2)."""
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    within = scaled * np.minimum(1.0, reach / np.maximum(length, 1e-12))
    colours = [np.prod(within[:, list(factors)], axis=1) for factors in COLOUR_FACTORS]
    return np.column_stack([colours[k] * place[:, 0] ** i * place[:, 1] ** j for k, i, j in _POWERS])


def normals_from_stereographic(s: Points2) -> Points:
    """Unit normals (n, 3) that face the camera, of stereographic coordinates (n, 2)."""
    length = np.linalg.norm(s, axis=1, keepdims=True)
    s = s * np.minimum(1.0, STEEPEST / np.maximum(length, 1e-12))
    squared = (s**2).sum(axis=1, keepdims=True)
    return np.asarray(np.hstack([2.0 * s, squared - 1.0]) / (1.0 + squared))


def stereographic_from_normals(normals: Points) -> Points2:
    """Stereographic coordinates (n, 2) of unit normals (n, 3): 0 for the flat gel, 1 long at right angles."""
    return np.asarray(normals[:, :2] / (1.0 - normals[:, 2:]))

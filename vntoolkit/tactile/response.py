"""From a gel's change of colour to normals by `GelResponse`: the plain form that the loop is tested against.

The correction is added in the normal's stereographic coordinates s = n_xy / (1 − n_z). They keep angles: the
same step of s is nearly the same angle wherever the normal points.
"""

import numpy as np

from vntoolkit.arrays import FloatArray, Points, Points2
from vntoolkit.photometry.gel import COLOUR_FACTORS, POWERS, GelResponse
from vntoolkit.photometry.response import LightResponse

STEEPEST = 0.98  # |s|: 1 is a normal across the line of sight, beyond which nothing is seen


def normals_from_change(
    change: Points, positions_px: Points2, response: LightResponse, gel: GelResponse
) -> Points:
    """Unit normals (n, 3), camera frame, of changes of colour (n, 3) at pixels (n, 2)."""
    scaled = change @ response.inverse.T
    place = (positions_px - gel.centre_px) / gel.scale_px
    terms = correction_terms(scaled, place, gel.reach)
    return normals_from_stereographic(first_estimate(scaled) + terms @ gel.coefficients)


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
    return np.column_stack([colours[k] * place[:, 0] ** i * place[:, 1] ** j for k, i, j in POWERS])


def normals_from_stereographic(s: Points2) -> Points:
    """Unit normals (n, 3) that face the camera, of stereographic coordinates (n, 2)."""
    length = np.linalg.norm(s, axis=1, keepdims=True)
    s = s * np.minimum(1.0, STEEPEST / np.maximum(length, 1e-12))
    squared = (s**2).sum(axis=1, keepdims=True)
    return np.asarray(np.hstack([2.0 * s, squared - 1.0]) / (1.0 + squared))


def stereographic_from_normals(normals: Points) -> Points2:
    """Stereographic coordinates (n, 2) of unit normals (n, 3): 0 for the flat gel, 1 long at right angles."""
    return np.asarray(normals[:, :2] / (1.0 - normals[:, 2:]))

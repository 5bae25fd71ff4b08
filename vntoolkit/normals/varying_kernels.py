"""The loops of inversion for a response that varies over the image: M(u, v) is solved at every pixel.

Along a row the twelve numbers of M and a are cubics in u. A pixel's own 3×3 system is solved by cofactors,
eight pixels at a time, so that nothing of the size of the image is kept or read but the image itself.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit, prange

from vntoolkit.normals.inversion_kernels import (
    FLAGS,
    Array,
    Coefficients,
    Decoding,
    Outputs,
    normalise_row,
)
from vntoolkit.photometry.response import LightResponse

_ONE = np.float32(1)


class Field(NamedTuple):
    """M and a over the image, all float32.

    terms: (12, 4, 4): number e of (M row by row, then a), coefficient of x^i y^j; M is multiplied by the
    expected albedo. x = (u − centre_u) × inverse_scale, y likewise.
    """

    terms: Array
    centre_u: np.float32
    centre_v: np.float32
    inverse_scale: np.float32


@njit(cache=True, inline="always", fastmath=FLAGS, error_model="numpy")
def _cubics_of_row(field: Field, v: int, row: Array) -> None:
    """Put y in: row[e, i] is the coefficient of x^i in row v."""
    y = (np.float32(v) - field.centre_v) * field.inverse_scale
    terms = field.terms
    for e in range(12):
        for i in range(4):
            row[e, i] = ((terms[e, i, 3] * y + terms[e, i, 2]) * y + terms[e, i, 1]) * y + terms[e, i, 0]


@njit(cache=True, inline="always", fastmath=FLAGS, error_model="numpy")
def _cubic(row: Array, e: int, x: Any) -> Any:
    return ((row[e, 3] * x + row[e, 2]) * x + row[e, 1]) * x + row[e, 0]


@njit(cache=True, inline="always", fastmath=FLAGS, error_model="numpy")
def _solve_row(field: Field, row: Array, x: Array, y: Array, z: Array) -> None:
    """Replace the colours in x, y, z by M⁻¹(r − a), by Cramer's rule."""
    for u in range(x.shape[0]):
        s = (np.float32(u) - field.centre_u) * field.inverse_scale
        a, b, c = _cubic(row, 0, s), _cubic(row, 1, s), _cubic(row, 2, s)
        d, e, f = _cubic(row, 3, s), _cubic(row, 4, s), _cubic(row, 5, s)
        g, h, k = _cubic(row, 6, s), _cubic(row, 7, s), _cubic(row, 8, s)
        red, green, blue = x[u] - _cubic(row, 9, s), y[u] - _cubic(row, 10, s), z[u] - _cubic(row, 11, s)
        first, second, third = e * k - f * h, f * g - d * k, d * h - e * g
        scale = _ONE / (a * first + b * second + c * third)
        x[u] = (first * red + (c * h - b * k) * green + (b * f - c * e) * blue) * scale
        y[u] = (second * red + (a * k - c * g) * green + (c * d - a * f) * blue) * scale
        z[u] = (third * red + (b * g - a * h) * green + (a * e - b * d) * blue) * scale


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def normals_from_rgb_in_field(
    rgb: Array, clipped: Array, inside: Array, field: Field, c: Coefficients, out: Outputs
) -> None:
    """Fill `out` from linear float32 colours (h, w, 3)."""
    height, width = inside.shape
    normals, weight, valid = out  # numba drops stores through a tuple's field inside prange
    for v in prange(height):
        x, y, z = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        row = np.empty((12, 4), np.float32)
        _cubics_of_row(field, v, row)
        for u in range(width):
            x[u], y[u], z[u] = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
        _solve_row(field, row, x, y, z)
        normalise_row(x, y, z, clipped[v], inside[v], c, weight[v], valid[v])
        for u in range(width):
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = x[u], y[u], z[u]


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def normals_from_integers_in_field(
    encoded: Array, decoding: Decoding, inside: Array, field: Field, c: Coefficients, out: Outputs
) -> None:
    """Fill `out` from stored integers (h, w, 3) through a decoding table."""
    height, width = inside.shape
    normals, weight, valid = out  # numba drops stores through a tuple's field inside prange
    table = decoding.table
    for v in prange(height):
        x, y, z = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        clipped = np.empty(width, np.bool_)
        row = np.empty((12, 4), np.float32)
        _cubics_of_row(field, v, row)
        for u in range(width):
            r, g, b = table[encoded[v, u, 0]], table[encoded[v, u, 1]], table[encoded[v, u, 2]]
            clipped[u] = max(r, g, b) >= decoding.white
            x[u], y[u], z[u] = r, g, b
        _solve_row(field, row, x, y, z)
        normalise_row(x, y, z, clipped, inside[v], c, weight[v], valid[v])
        for u in range(width):
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = x[u], y[u], z[u]


def field_from_response(response: LightResponse, relative_albedo: float) -> Field:
    """Lay out a response for the loops."""
    terms = np.zeros((12, 4, 4))
    terms[:9, 0, 0] = response.matrix.ravel() * relative_albedo
    terms[9:, 0, 0] = response.ambient
    centre_u, centre_v, scale = 0.0, 0.0, 1.0
    if response.variation is not None:
        (centre_u, centre_v), scale = response.variation.centre_px.tolist(), response.variation.scale_px
        i, j = response.variation.powers.T
        terms[:9, i, j] = response.variation.matrices.reshape(-1, 9).T * relative_albedo
        terms[9:, i, j] = response.variation.ambients.T
    return Field(
        terms=terms.astype(np.float32),
        centre_u=np.float32(centre_u),
        centre_v=np.float32(centre_v),
        inverse_scale=np.float32(1.0 / scale),
    )

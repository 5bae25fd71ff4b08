"""The compiled loops of inversion: one pass over the image, row by row.

A row lives in separate x, y, z buffers that stay in the first-level cache, so that the middle loop, with its
root and divisions, runs eight pixels at a time; interleaved pixels would keep it scalar (1.6 times slower).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit, prange

FLAGS = {"contract", "arcp", "nsz"}  # reordering that keeps NaN and infinity meaningful
_LONGEST = np.float32(1e18)  # squares beyond it overflow float32: treated as not finite
_ZERO = np.float32(0)
_ONE = np.float32(1)

Array = npt.NDArray[Any]


class Coefficients(NamedTuple):
    """What the loops need to know, all float32.

    inverse: M⁻¹ over the expected albedo, (3, 3). offset: the same times the ambient light, (3,). darkest:
    smallest length of a pixel that has a normal. sharpness: 1 / (2 albedo tolerance). clipped_factor: on a
    clipped pixel's weight.
    """

    inverse: Array
    offset: Array
    darkest: np.float32
    sharpness: np.float32
    clipped_factor: np.float32


class Decoding(NamedTuple):
    """table: linear float32 value of every stored integer. white: value from which a sample is clipped."""

    table: Array
    white: np.float32


class Outputs(NamedTuple):
    """normals (h, w, 3) float32, weight (h, w) float32, valid (h, w) bool: filled by the loops."""

    normals: Array
    weight: Array
    valid: Array


@njit(cache=True, inline="always", fastmath=FLAGS, error_model="numpy")
def _mix(r: Any, g: Any, b: Any, c: Coefficients, x: Array, y: Array, z: Array, u: int) -> None:
    x[u] = c.inverse[0, 0] * r + c.inverse[0, 1] * g + c.inverse[0, 2] * b - c.offset[0]
    y[u] = c.inverse[1, 0] * r + c.inverse[1, 1] * g + c.inverse[1, 2] * b - c.offset[1]
    z[u] = c.inverse[2, 0] * r + c.inverse[2, 1] * g + c.inverse[2, 2] * b - c.offset[2]


@njit(cache=True, inline="always", fastmath=FLAGS, error_model="numpy")
def normalise_row(
    x: Array, y: Array, z: Array, clipped: Array, inside: Array, c: Coefficients, weight: Array, valid: Array
) -> None:
    """Scale one row to unit length, with its weight; 0 where there is no normal."""
    for u in range(x.shape[0]):
        length = np.sqrt(x[u] * x[u] + y[u] * y[u] + z[u] * z[u])
        factor = c.clipped_factor if clipped[u] else _ONE
        good = inside[u] & (length > c.darkest) & (length < _LONGEST) & (z[u] < _ZERO) & (factor > _ZERO)
        scale = _ONE / length
        departure = (length - scale) * c.sharpness  # near 1: the relative departure over the tolerance
        weight[u] = factor / (_ONE + departure * departure) if good else _ZERO
        x[u] = x[u] * scale if good else _ZERO
        y[u] = y[u] * scale if good else _ZERO
        z[u] = z[u] * scale if good else _ZERO
        valid[u] = good


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def normals_from_rgb_kernel(rgb: Array, clipped: Array, inside: Array, c: Coefficients, out: Outputs) -> None:
    """Fill `out` from linear float32 colours (h, w, 3)."""
    height, width = inside.shape
    normals, weight, valid = out  # numba drops stores through a tuple's field inside prange
    for v in prange(height):
        x, y, z = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        for u in range(width):
            _mix(rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2], c, x, y, z, u)
        normalise_row(x, y, z, clipped[v], inside[v], c, weight[v], valid[v])
        for u in range(width):
            normals[v, u, 0] = x[u]
            normals[v, u, 1] = y[u]
            normals[v, u, 2] = z[u]


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def normals_from_integers_kernel(
    encoded: Array, decoding: Decoding, inside: Array, c: Coefficients, out: Outputs
) -> None:
    """Fill `out` from stored integers (h, w, 3) through a decoding table."""
    height, width = inside.shape
    normals, weight, valid = out  # numba drops stores through a tuple's field inside prange
    table = decoding.table
    for v in prange(height):
        x, y, z = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        clipped = np.empty(width, np.bool_)
        for u in range(width):
            r, g, b = table[encoded[v, u, 0]], table[encoded[v, u, 1]], table[encoded[v, u, 2]]
            clipped[u] = max(r, g, b) >= decoding.white
            _mix(r, g, b, c, x, y, z, u)
        normalise_row(x, y, z, clipped, inside[v], c, weight[v], valid[v])
        for u in range(width):
            normals[v, u, 0] = x[u]
            normals[v, u, 1] = y[u]
            normals[v, u, 2] = z[u]

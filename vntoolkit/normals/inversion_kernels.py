"""The compiled loops of inversion: one pass over the pixels, no intermediate image."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit, prange

_FLAGS = {"contract", "arcp", "nsz"}  # reordering that keeps NaN and infinity meaningful
_LONGEST = np.float32(1e18)  # squares beyond it overflow float32: treated as not finite

Array = npt.NDArray[Any]


@njit(cache=True, inline="always", fastmath=_FLAGS)
def _invert(
    r: np.float32,
    g: np.float32,
    b: np.float32,
    inverse: Array,
    offset: Array,
    usable: bool,
    clipped: bool,
    darkest: np.float32,
    sharpness: np.float32,
    clipped_factor: np.float32,
) -> Any:
    """Return the unit normal and its weight; all 0 where there is none."""
    zero = np.float32(0)
    one = np.float32(1)
    x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b - offset[0]
    y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b - offset[1]
    z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b - offset[2]
    length = np.sqrt(x * x + y * y + z * z)
    factor = clipped_factor if clipped else one
    valid = usable & (length > darkest) & (length < _LONGEST) & (z < zero) & (factor > zero)
    scale = one / length if valid else zero
    departure = (length - scale) * sharpness
    weight = factor / (one + departure * departure) if valid else zero
    if not valid:  # 0 × NaN is NaN
        x = y = z = zero
    return x * scale, y * scale, z * scale, weight


@njit(cache=True, parallel=True, fastmath=_FLAGS)
def normals_from_rgb_kernel(
    rgb: Array,
    clipped: Array,
    inside: Array,
    inverse: Array,
    offset: Array,
    darkest: np.float32,
    sharpness: np.float32,
    clipped_factor: np.float32,
    normals: Array,
    weight: Array,
    valid: Array,
) -> None:
    """Fill normals (h, w, 3), weight and valid (h, w) from linear float32 colours."""
    for v in prange(rgb.shape[0]):
        for u in range(rgb.shape[1]):
            x, y, z, w = _invert(
                rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2], inverse, offset,
                inside[v, u], clipped[v, u], darkest, sharpness, clipped_factor,
            )  # fmt: skip
            normals[v, u, 0] = x
            normals[v, u, 1] = y
            normals[v, u, 2] = z
            weight[v, u] = w
            valid[v, u] = w > np.float32(0)


@njit(cache=True, parallel=True, fastmath=_FLAGS)
def normals_from_integers_kernel(
    encoded: Array,
    table: Array,
    white: np.float32,
    inside: Array,
    inverse: Array,
    offset: Array,
    darkest: np.float32,
    sharpness: np.float32,
    clipped_factor: np.float32,
    normals: Array,
    weight: Array,
    valid: Array,
) -> None:
    """As `normals_from_rgb_kernel`, from stored integers through a decoding table."""
    for v in prange(encoded.shape[0]):
        for u in range(encoded.shape[1]):
            r, g, b = table[encoded[v, u, 0]], table[encoded[v, u, 1]], table[encoded[v, u, 2]]
            x, y, z, w = _invert(
                r, g, b, inverse, offset,
                inside[v, u], max(r, g, b) >= white, darkest, sharpness, clipped_factor,
            )  # fmt: skip
            normals[v, u, 0] = x
            normals[v, u, 1] = y
            normals[v, u, 2] = z
            weight[v, u] = w
            valid[v, u] = w > np.float32(0)


@njit(cache=True, parallel=True, fastmath=_FLAGS)
def gradients_from_integers_kernel(
    encoded: Array,
    table: Array,
    white: np.float32,
    inside: Array,
    inverse: Array,
    offset: Array,
    darkest: np.float32,
    sharpness: np.float32,
    clipped_factor: np.float32,
    flattest_z: np.float32,
    normals: Array,
    weight: Array,
    valid: Array,
    p: Array,
    q: Array,
) -> None:
    """As `normals_from_integers_kernel`, with the gradients p, q (h, w) of an orthographic depth."""
    for v in prange(encoded.shape[0]):
        for u in range(encoded.shape[1]):
            r, g, b = table[encoded[v, u, 0]], table[encoded[v, u, 1]], table[encoded[v, u, 2]]
            x, y, z, w = _invert(
                r, g, b, inverse, offset,
                inside[v, u], max(r, g, b) >= white, darkest, sharpness, clipped_factor,
            )  # fmt: skip
            normals[v, u, 0] = x
            normals[v, u, 1] = y
            normals[v, u, 2] = z
            weight[v, u] = w
            valid[v, u] = w > np.float32(0)
            slope = np.float32(1) / max(-z, flattest_z)
            p[v, u] = x * slope
            q[v, u] = y * slope

"""Normals as half floats, the four planes of an EXR, in one pass over the pixels.

numpy, which converts one plane at a time from interleaved pixels, takes five times as long.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from vntoolkit.geometry.maps import NormalMap

_SIGN = np.uint32(0x8000_0000)
_SMALLEST_NORMAL = np.uint32(0x3880_0000)  # 2**-14: below it a half counts in steps of 2**-24
_BIAS = np.uint32(0x3800_0000)  # the exponents' zeros lie 112 apart
_TOO_LARGE = np.uint32(0x4780_0000)  # 2**16
_BEYOND_INFINITY = np.uint32(0x7F80_0000)
_STEPS_PER_UNIT = np.float32(2.0**24)


def half_planes_from_normals(
    normal_map: NormalMap, signs: tuple[float, float, float]
) -> npt.NDArray[np.float16]:
    """Return (4, h, w) float16: n_x, n_y, n_z, each times its sign (1 or -1); the weight, 0 where invalid."""
    planes = np.empty((4, *normal_map.shape), dtype=np.uint16)
    normals = np.ascontiguousarray(normal_map.normals_in_camera, dtype=np.float32)
    weight = normal_map.mask if normal_map.weight is None else normal_map.weight * normal_map.mask
    flips = np.array([0x8000 if sign < 0 else 0 for sign in (*signs, 1)], dtype=np.uint32)
    _fill(normals, np.ascontiguousarray(weight, dtype=np.float32), flips, planes)
    return planes.view(np.float16)


@njit(cache=True, inline="always")
def _half_bits(value, bits):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Round a float32, given as value and as bits, to the nearest half, ties to even."""
    sign = (bits & _SIGN) >> np.uint32(16)
    size = bits & ~_SIGN
    normal = (size - _BIAS + np.uint32(0xFFF) + ((size >> np.uint32(13)) & np.uint32(1))) >> np.uint32(13)
    subnormal = np.uint32(np.int32(np.rint(min(abs(value), np.float32(1.0)) * _STEPS_PER_UNIT)))
    half = normal if size >= _SMALLEST_NORMAL else subnormal
    infinite = np.uint32(0x7E00) if size > _BEYOND_INFINITY else np.uint32(0x7C00)
    return sign | (min(half, np.uint32(0x7C00)) if size < _TOO_LARGE else infinite)


@njit(cache=True, nogil=True)
def _fill(normals, weight, flips, planes):  # type: ignore[no-untyped-def]  # pragma: no cover
    height, width = weight.shape
    row = np.empty(width, np.float32)  # contiguous, so that eight pixels are converted at a time
    bits = row.view(np.uint32)
    for v in range(height):
        for k in range(4):
            for u in range(width):
                row[u] = normals[v, u, k] if k < 3 else weight[v, u]
            plane = planes[k, v]
            for u in range(width):
                plane[u] = _half_bits(row[u], bits[u]) ^ flips[k]

"""Fine detail through subsampled chroma: what luma shows goes to the channels as a turning normal sends it.

Plain decoding adds the detail of the luma to red, green and blue alike, as if paint had changed. On a surface
of one colour it is the normal n that turns, and |n| = 1: of the two ways in which it can turn, the luma
Y = w·(M n) sees the one along the gradient g of Y over the sphere. A change dY of the luma against its mean
over a chroma sample is taken for the turn g dY / (|g|² + λ), the least one that explains it under noise, and
chroma changes with it. Luma is kept exactly; where g is small, so is the change, and plain decoding is left.
Chroma is taken to lie in the middle of the luma that it covers.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Matrix3, Vector3
from vntoolkit.native import njit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, linear_from_encoded

# λ: noise of luma, 0.005 of full scale (one level of 8 bits and the codec), over 3 degrees, squared.
# From a third to three times it, errors on simulated knits move by less than a tenth of what is gained.
_NOISE_OVER_DETAIL = 0.01
_CODES = 1024  # of the decoding table
_DARKEST = 1e-3  # of M's own brightness: no direction is known below


class LumaDetail:
    """Decodes subsampled YUV of a surface under a light response. transfer: of the stored values."""

    def __init__(self, response: LightResponse, transfer: Transfer) -> None:
        codes = np.arange(_CODES + 1) / _CODES
        light = linear_from_encoded(codes, transfer)
        self._light = light.astype(np.float32)
        self._slope = (1.0 / np.maximum(np.gradient(light, codes), 1e-3)).astype(np.float32)  # code per light
        self._matrix = response.matrix.astype(np.float32)
        self._inverse = response.inverse.astype(np.float32)
        self._ambient = response.ambient.astype(np.float32)

    def rgb(self, planes: list[npt.NDArray[Any]], matrix: Matrix3, offset: Vector3) -> npt.NDArray[np.uint16]:
        """Return (h, w, 3) uint16 RGB, 65535 = full scale.

        planes: Y (h, w), and Cb and Cr of fewer pixels, integers as stored. matrix, offset: from these to RGB
        of 0 to 1.
        """
        luma, size = planes[0], planes[0].shape[::-1]
        coarse_size = planes[1].shape[::-1]
        coarse = np.empty((*planes[1].shape, 3), np.float32)
        coarse[..., 0] = cv2.resize(luma.astype(np.float32), coarse_size, interpolation=cv2.INTER_AREA)
        coarse[..., 1], coarse[..., 2] = planes[1], planes[2]
        # the turns change slowly: a fourth of the samples tells them
        height, width = planes[1].shape
        fewer = cv2.resize(coarse, (-(-width // 2), -(-height // 2)), interpolation=cv2.INTER_AREA)
        turns = np.empty((*fewer.shape[:2], 2), np.float32)
        to_rgb, shift = matrix.astype(np.float32), offset.astype(np.float32)
        from_rgb = np.linalg.inv(matrix).astype(np.float32)
        _chroma_per_luma(
            fewer, to_rgb, shift, from_rgb, self._light, self._slope, self._matrix, self._inverse,
            self._ambient, turns,
        )  # fmt: skip
        smooth = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
        turns = cv2.resize(turns, size, interpolation=cv2.INTER_LINEAR)
        rgb = np.empty((*luma.shape, 3), np.uint16)
        _sharpened(luma, smooth, turns, to_rgb * np.float32(65535), shift * np.float32(65535), rgb)
        return rgb


@njit(cache=True, nogil=True, fastmath=True)
def _chroma_per_luma(  # type: ignore[no-untyped-def]  # pragma: no cover
    coarse, to_rgb, shift, from_rgb, light, slope, matrix, inverse, ambient, turns
):
    """How much Cb and Cr change per change of Y, in codes, where the normal turns."""
    top = np.float32(len(light) - 1)
    darkest = np.float32(_DARKEST)
    noise = np.float32(_NOISE_OVER_DETAIL)
    # luma of RGB, 0 to 1: the row of Y, freed of its span
    span = from_rgb[0, 0] + from_rgb[0, 1] + from_rgb[0, 2]
    w0, w1, w2 = from_rgb[0, 0] / span, from_rgb[0, 1] / span, from_rgb[0, 2] / span
    # copies, since what is written might lie where these are read
    t00, t01, t02 = to_rgb[0, 0], to_rgb[0, 1], to_rgb[0, 2]
    t10, t11, t12 = to_rgb[1, 0], to_rgb[1, 1], to_rgb[1, 2]
    t20, t21, t22 = to_rgb[2, 0], to_rgb[2, 1], to_rgb[2, 2]
    f10, f11, f12 = from_rgb[1, 0], from_rgb[1, 1], from_rgb[1, 2]
    f20, f21, f22 = from_rgb[2, 0], from_rgb[2, 1], from_rgb[2, 2]
    m00, m01, m02 = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    m10, m11, m12 = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    m20, m21, m22 = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    i00, i01, i02 = inverse[0, 0], inverse[0, 1], inverse[0, 2]
    i10, i11, i12 = inverse[1, 0], inverse[1, 1], inverse[1, 2]
    i20, i21, i22 = inverse[2, 0], inverse[2, 1], inverse[2, 2]
    s0, s1, s2 = shift[0], shift[1], shift[2]
    b0, b1, b2 = ambient[0], ambient[1], ambient[2]
    for v in range(coarse.shape[0]):
        for u in range(coarse.shape[1]):
            y, cb, cr = coarse[v, u, 0], coarse[v, u, 1], coarse[v, u, 2]
            e0 = t00 * y + t01 * cb + t02 * cr + s0
            e1 = t10 * y + t11 * cb + t12 * cr + s1
            e2 = t20 * y + t21 * cb + t22 * cr + s2
            k0 = int(min(max(e0, np.float32(0)), np.float32(1)) * top + np.float32(0.5))
            k1 = int(min(max(e1, np.float32(0)), np.float32(1)) * top + np.float32(0.5))
            k2 = int(min(max(e2, np.float32(0)), np.float32(1)) * top + np.float32(0.5))
            r0, r1, r2 = light[k0] - b0, light[k1] - b1, light[k2] - b2
            x0 = i00 * r0 + i01 * r1 + i02 * r2
            x1 = i10 * r0 + i11 * r1 + i12 * r2
            x2 = i20 * r0 + i21 * r1 + i22 * r2
            squared = x0 * x0 + x1 * x1 + x2 * x2
            if squared < darkest * darkest:
                turns[v, u, 0] = turns[v, u, 1] = np.float32(0)
                continue
            # Y's gradient over x, then its part across x: x = rho n, and dY per radian is rho times it
            a0, a1, a2 = w0 * slope[k0], w1 * slope[k1], w2 * slope[k2]
            g0 = a0 * m00 + a1 * m10 + a2 * m20
            g1 = a0 * m01 + a1 * m11 + a2 * m21
            g2 = a0 * m02 + a1 * m12 + a2 * m22
            along = (g0 * x0 + g1 * x1 + g2 * x2) / squared
            g0, g1, g2 = g0 - along * x0, g1 - along * x1, g2 - along * x2
            per_dy = squared / (squared * (g0 * g0 + g1 * g1 + g2 * g2) + noise)
            d0 = slope[k0] * (m00 * g0 + m01 * g1 + m02 * g2) * per_dy
            d1 = slope[k1] * (m10 * g0 + m11 * g1 + m12 * g2) * per_dy
            d2 = slope[k2] * (m20 * g0 + m21 * g1 + m22 * g2) * per_dy
            turns[v, u, 0] = (f10 * d0 + f11 * d1 + f12 * d2) / span
            turns[v, u, 1] = (f20 * d0 + f21 * d1 + f22 * d2) / span


@njit(cache=True, nogil=True, fastmath=True)
def _sharpened(luma, smooth, turns, matrix, offset, rgb):  # type: ignore[no-untyped-def]  # pragma: no cover
    m00, m01, m02 = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    m10, m11, m12 = matrix[1, 0], matrix[1, 1], matrix[1, 2]
    m20, m21, m22 = matrix[2, 0], matrix[2, 1], matrix[2, 2]
    half = np.float32(0.5)
    s0, s1, s2 = offset[0] + half, offset[1] + half, offset[2] + half
    least, most = np.float32(0), np.float32(65535)
    for v in range(rgb.shape[0]):
        for u in range(rgb.shape[1]):
            y = np.float32(luma[v, u])
            detail = y - smooth[v, u, 0]
            cb = smooth[v, u, 1] + turns[v, u, 0] * detail
            cr = smooth[v, u, 2] + turns[v, u, 1] * detail
            rgb[v, u, 0] = np.uint16(min(max(m00 * y + m01 * cb + m02 * cr + s0, least), most))
            rgb[v, u, 1] = np.uint16(min(max(m10 * y + m11 * cb + m12 * cr + s1, least), most))
            rgb[v, u, 2] = np.uint16(min(max(m20 * y + m21 * cb + m22 * cr + s2, least), most))

"""YUV of 9 to 16 bits to 16-bit RGB, exact to half a level.

FFmpeg's scaler loses 0.2 % of full scale on the way from 12-bit limited range to RGB (17 levels of 4095 at
worst), so the matrix is applied here; the scaler only brings chroma to full resolution.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from vntoolkit.arrays import Matrix3, Vector3

_FULL_RANGE = 2  # AVCOL_RANGE_JPEG
_UNSPECIFIED = 2  # AVCOL_SPC_UNSPECIFIED
# AVCOL_SPC_* to the luma weights (K_R, K_B): BT.709, FCC, BT.470BG and SMPTE 170M (BT.601), 240M, BT.2020.
_LUMA_WEIGHTS = {
    1: (0.2126, 0.0722), 4: (0.30, 0.11), 5: (0.299, 0.114), 6: (0.299, 0.114), 7: (0.212, 0.087),
    9: (0.2627, 0.0593), 10: (0.2627, 0.0593),
}  # fmt: skip


def rgb_from_deep_yuv(frame: Any, source: Any, bits: int, *, hd: bool) -> npt.NDArray[np.uint16]:
    """Return (h, w, 3) uint16 RGB, 65535 = full scale, of a planar 4:4:4 frame of `bits` bits.

    Matrix and range are taken from `source`, the frame as decoded; where it states no matrix, BT.709 for a
    picture of 720 lines or more (`hd`), else BT.601.
    """
    colour_space = int(source.colorspace)
    if colour_space == _UNSPECIFIED or colour_space not in _LUMA_WEIGHTS:
        colour_space = 1 if hd else 5
    full_range = int(source.color_range) == _FULL_RANGE
    matrix, offset = _rgb_from_yuv(*_LUMA_WEIGHTS[colour_space], bits=bits, full_range=full_range)
    planes = [_plane(frame, i) for i in range(3)]
    rgb = np.empty((frame.height, frame.width, 3), dtype=np.uint16)
    _apply(planes[0], planes[1], planes[2], matrix * 65535.0, offset * 65535.0, rgb)
    return rgb


def _rgb_from_yuv(k_red: float, k_blue: float, *, bits: int, full_range: bool) -> tuple[Matrix3, Vector3]:
    """Return the affine map from stored YUV to RGB 0 to 1 (ITU-R BT.709-6, items 3 and 4)."""
    k_green = 1.0 - k_red - k_blue
    yuv_from_rgb = np.array(
        [
            [k_red, k_green, k_blue],
            np.array([-k_red, -k_green, 1 - k_blue]) / (2 * (1 - k_blue)),
            np.array([1 - k_red, -k_green, -k_blue]) / (2 * (1 - k_red)),
        ]
    )
    step = 2 ** (bits - 8)
    luma, chroma, black = (2**bits - 1, 2**bits - 1, 0) if full_range else (219 * step, 224 * step, 16 * step)
    matrix = np.linalg.inv(yuv_from_rgb) / np.array([luma, chroma, chroma])
    return matrix, -matrix @ np.array([black, 128 * step, 128 * step], dtype=np.float64)


def _plane(frame: Any, index: int) -> npt.NDArray[np.uint16]:
    plane = frame.planes[index]
    rows = np.frombuffer(plane, np.uint16).reshape(-1, plane.line_size // 2)
    return rows[: frame.height, : frame.width]


@njit(cache=True, nogil=True)
def _apply(luma, blue, red, matrix, offset, rgb):  # type: ignore[no-untyped-def]  # pragma: no cover
    for v in range(rgb.shape[0]):
        for u in range(rgb.shape[1]):
            y, cb, cr = float(luma[v, u]), float(blue[v, u]), float(red[v, u])
            for c in range(3):
                value = matrix[c, 0] * y + matrix[c, 1] * cb + matrix[c, 2] * cr + offset[c] + 0.5
                rgb[v, u, c] = np.uint16(min(max(value, 0.0), 65535.0))

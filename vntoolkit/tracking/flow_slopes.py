"""Normal maps as images that flow and registration can read: bytes, and pyramids of slopes."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from numba import njit

from vntoolkit.geometry.maps import NormalMap

_STEEPEST = 0.15  # −n_z below which a slope is clamped: 81° from the viewing direction


def bytes_from_normals(normal_map: NormalMap) -> npt.NDArray[np.uint8]:
    """Return (h, w, 3) bytes of a normal map, as OpenCV's DIS and LK need: 127.5 (n + 1), 128 outside."""
    return _encode(normal_map.normals_in_camera, normal_map.mask)


def slope_pyramid(normal_map: NormalMap, levels: int) -> list[npt.NDArray[np.float32]]:
    """Return the slopes at full resolution and `levels` halvings, each (h, w, 3) float32.

    Channels: w ∂z/∂u, w ∂z/∂v, w with w the pixel's weight (mask, normal map's weight, and less at grazing
    angles); premultiplied, so that smoothing mixes only what is valid. The finest is smoothed over 3×3
    pixels: interpolation then blurs no more at half pixels than at whole ones.
    """
    weight = normal_map.weight if normal_map.weight is not None else np.ones((1, 1), dtype=np.float32)
    finest = _slopes(normal_map.normals_in_camera, normal_map.mask, weight)
    pyramid = [cv2.GaussianBlur(finest, (3, 3), 0.7)]
    for _ in range(levels):
        pyramid.append(cv2.pyrDown(pyramid[-1]))
    return [np.asarray(level, dtype=np.float32) for level in pyramid]


@njit(cache=True)
def _encode(normals, mask):  # type: ignore[no-untyped-def]
    h, w = mask.shape
    out = np.full((h, w, 3), 128, dtype=np.uint8)
    for v in range(h):
        for u in range(w):
            if mask[v, u]:
                for c in range(3):
                    out[v, u, c] = np.uint8(127.5 * (normals[v, u, c] + 1.0) + 0.5)
    return out


@njit(cache=True)
def _slopes(normals, mask, weight):  # type: ignore[no-untyped-def]
    h, w = mask.shape
    weighted = weight.shape[0] == h and weight.shape[1] == w
    out = np.zeros((h, w, 3), dtype=np.float32)
    for v in range(h):
        for u in range(w):
            if mask[v, u]:
                facing = max(-normals[v, u, 2], _STEEPEST)
                share = min(1.0, (facing / 0.3) ** 2)  # grazing slopes are noise
                if weighted:
                    share *= weight[v, u]
                out[v, u, 0] = share * normals[v, u, 0] / facing
                out[v, u, 1] = share * normals[v, u, 1] / facing
                out[v, u, 2] = share
    return out

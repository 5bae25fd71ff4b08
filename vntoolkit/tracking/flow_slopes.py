"""Images made of normal maps for flow and registration: bytes, slope pyramids, smoothed normals."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Mask
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit
from vntoolkit.tracking.flow_jumps import jump_pixels

Relief = npt.NDArray[np.uint8]  # (h, w, 3)

_RELIEF_SIGMA_PX = 4.0
_RELIEF_GAIN = 400.0  # steps of a byte per unit of normal
_STEEPEST = 0.15  # −n_z below which a slope is clamped: 81° from the viewing direction
_GRAZING = 0.3  # −n_z below which a slope weighs less, 73°: there it is mostly noise
_AT_JUMPS = np.float32(0.02)  # share of the weight that is left there


def bytes_from_normals(normal_map: NormalMap) -> Relief:
    """Return (h, w, 3) bytes of the fine relief of a normal map, as OpenCV's DIS and LK need; 128 outside.

    The mean over the surroundings is taken off, and what is left is stretched: a surface that turns changes
    all of its normals, which LK would take for motion, and a byte of the normal itself has too few steps for
    a knit. On the simulated sweater this halves the error of 30 chained frames.
    """
    bytes_ = np.full((*normal_map.shape, 3), 128, dtype=np.uint8)
    box = _box(normal_map.mask, _RELIEF_SIGMA_PX)
    mask = normal_map.mask[box]
    weight = mask.astype(np.float32)
    normals = normal_map.normals_in_camera[box] * weight[..., None]
    mean = cv2.GaussianBlur(normals, (0, 0), _RELIEF_SIGMA_PX)
    share = cv2.GaussianBlur(weight, (0, 0), _RELIEF_SIGMA_PX)
    bytes_[box] = _encode(normals, mean, share, mask)
    return bytes_


def slope_pyramid(normal_map: NormalMap, levels: int) -> list[npt.NDArray[np.float32]]:
    """Return the slopes at full resolution and `levels` halvings, each (h, w, 3) float32.

    Channels: w ∂z/∂u, w ∂z/∂v, w with w the pixel's weight (mask, normal map's weight, less at grazing
    angles, next to nothing around its jumps); premultiplied, so that smoothing mixes only what is valid. The
    finest is smoothed over 3×3 pixels: interpolation then blurs no more at half pixels than at whole ones.
    """
    weight = np.ones((1, 1), dtype=np.float32)
    if normal_map.weight is not None:
        weight = np.where(jump_pixels(normal_map), _AT_JUMPS * normal_map.weight, normal_map.weight)
    finest = _slopes(normal_map.normals_in_camera, normal_map.mask, weight)
    pyramid = [cv2.GaussianBlur(finest, (3, 3), 0.7)]
    for _ in range(levels):
        pyramid.append(cv2.pyrDown(pyramid[-1]))
    return [np.asarray(level, dtype=np.float32) for level in pyramid]


def smooth_normals(normal_map: NormalMap, sigma_px: float) -> npt.NDArray[np.float32]:
    """Return (h, w, 3) normals under a Gaussian: shape without relief; not unit, 0 outside the mask."""
    out = np.zeros((*normal_map.shape, 3), dtype=np.float32)
    box = _box(normal_map.mask, sigma_px)
    inside = normal_map.mask[box][..., None]
    weighted = normal_map.normals_in_camera[box] * inside.astype(np.float32)
    out[box] = cv2.GaussianBlur(weighted, (0, 0), sigma_px) * inside
    return out


def _box(mask: Mask, sigma_px: float) -> tuple[slice, slice]:
    """Rows and columns of the mask and of what a Gaussian reaches around it: elsewhere there is nothing."""
    reach = int(5 * sigma_px)
    sides = []
    for axis, length in enumerate(mask.shape):
        used = np.flatnonzero(mask.any(axis=1 - axis))
        first, last = (used[0], used[-1]) if used.size else (0, 0)
        sides.append(slice(max(0, int(first) - reach), min(length, int(last) + 1 + reach)))
    return sides[0], sides[1]


@njit(cache=True)
def _encode(normals, mean, share, mask):  # type: ignore[no-untyped-def]
    h, w = mask.shape
    out = np.full((h, w, 3), 128, dtype=np.uint8)
    for v in range(h):
        for u in range(w):
            if mask[v, u]:
                for c in range(3):
                    relief = normals[v, u, c] - mean[v, u, c] / share[v, u]
                    out[v, u, c] = np.uint8(min(max(128.5 + _RELIEF_GAIN * relief, 0.0), 255.0))
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
                share = min(1.0, (facing / _GRAZING) ** 2)
                if weighted:
                    share *= weight[v, u]
                out[v, u, 0] = share * normals[v, u, 0] / facing
                out[v, u, 1] = share * normals[v, u, 1] / facing
                out[v, u, 2] = share
    return out

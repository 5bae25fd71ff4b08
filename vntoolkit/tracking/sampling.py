"""Bilinear lookup at positions between pixels, aware of the mask."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points2
from vntoolkit.native import njit


def sample_image(image: FloatArray, positions_px: Points2) -> npt.NDArray[np.float64]:
    """Return (n, k) bilinear values of an image (h, w, k) at positions (n, 2), clamped to its border."""
    return _sample(np.ascontiguousarray(image), np.ascontiguousarray(positions_px, dtype=np.float64))


def sample_depth(depth: FloatArray, mask: Mask, positions_px: Points2) -> tuple[FloatArray, Mask]:
    """Return the depth (n,) at positions (n, 2), and where it is valid (n,).

    Bilinear over the valid ones of the four pixels around, whose weights are scaled up to sum to 1; invalid
    where those share less than half of the weight, or the position is not in the image.
    """
    value = np.ascontiguousarray(depth)
    return _sample_masked(
        value, np.ascontiguousarray(mask), np.ascontiguousarray(positions_px, dtype=np.float64)
    )


@njit(cache=True)
def _sample(image, positions):  # type: ignore[no-untyped-def]
    h, w, channels = image.shape
    out = np.empty((positions.shape[0], channels))
    for i in range(positions.shape[0]):
        x = min(max(positions[i, 0], 0.0), w - 1.0)
        y = min(max(positions[i, 1], 0.0), h - 1.0)
        u, v = min(int(x), max(w - 2, 0)), min(int(y), max(h - 2, 0))
        right, below = min(u + 1, w - 1), min(v + 1, h - 1)
        a, b = x - u, y - v
        for c in range(channels):
            top = (1 - a) * image[v, u, c] + a * image[v, right, c]
            bottom = (1 - a) * image[below, u, c] + a * image[below, right, c]
            out[i, c] = (1 - b) * top + b * bottom
    return out


@njit(cache=True)
def _sample_masked(image, mask, positions):  # type: ignore[no-untyped-def]
    h, w = image.shape
    n = positions.shape[0]
    out, valid = np.zeros(n), np.zeros(n, dtype=np.bool_)
    for i in range(n):
        x, y = positions[i, 0], positions[i, 1]
        if not (x > -0.5 and y > -0.5 and x < w - 0.5 and y < h - 0.5):
            continue
        u, v = int(np.floor(x)), int(np.floor(y))
        a, b = x - u, y - v
        total = weight = 0.0
        for dv in range(2):
            for du in range(2):
                row, column = v + dv, u + du
                if 0 <= row < h and 0 <= column < w and mask[row, column]:
                    share = (a if du else 1 - a) * (b if dv else 1 - b)
                    total += share * image[row, column]
                    weight += share
        if weight >= 0.5:
            out[i], valid[i] = total / weight, True
    return out, valid

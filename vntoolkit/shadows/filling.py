"""Values known on some pixels, spread smoothly over the rest (push–pull over an image pyramid)."""

from __future__ import annotations

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray

_LEAST_TRUST = 1e-4  # weight of the coarser level where a pixel's block holds anything at all


def fill_smoothly(values: FloatArray, trust: FloatArray, finest_level: int = 0) -> FloatArray:
    """Return `values` where trusted, and a smooth continuation of them elsewhere (gortler1996).

    values: (h, w) or (h, w, c). trust: (h, w), 0 where a value is unknown. finest_level: detail below
    2**finest_level pixels is smoothed away even where trusted. Without any trusted pixel the result is 0.
    """
    weight = np.ascontiguousarray(trust, dtype=np.float32)
    values32 = np.asarray(values, dtype=np.float32)
    total = values32 * (weight if values32.ndim == 2 else weight[..., None])
    pyramid = [(total, weight)]
    while max(weight.shape) > 1:
        size = ((weight.shape[1] + 1) // 2, (weight.shape[0] + 1) // 2)
        total = cv2.resize(total, size, interpolation=cv2.INTER_AREA).reshape(
            *size[::-1], *values32.shape[2:]
        )
        weight = cv2.resize(weight, size, interpolation=cv2.INTER_AREA).reshape(size[::-1])
        pyramid.append((total, weight))
    filled = pyramid[-1][0] / np.maximum(_channels(pyramid[-1][1], values32), 1e-20)
    for level in range(len(pyramid) - 2, -1, -1):
        total, weight = pyramid[level]
        coarse = cv2.resize(filled, weight.shape[::-1], interpolation=cv2.INTER_LINEAR).reshape(total.shape)
        if level < finest_level:
            filled = coarse
            continue
        own = _channels(weight, values32)
        filled = (total + _LEAST_TRUST * coarse) / (own + _LEAST_TRUST)
    return filled


def _channels(weight: FloatArray, like: FloatArray) -> FloatArray:
    return weight if like.ndim == 2 else weight[..., None]

"""Albedo under shadows: slowly varying, read where all three lights arrive, continued where they do not."""

import math

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask

_DARKEST = 1e-3  # of the albedo scale; keeps the logarithm finite
_LEAST_TRUST = 1e-4  # weight of the coarser level where a pixel's block holds anything at all

_FINEST_LEVEL = 3  # detail below 2³ pixels counts as shading, not as paint
_OUTLIER = 0.3  # departure of a pixel's log albedo from its surroundings at which it counts half
_ROUNDS = 2  # reweightings; a third changes nothing
_MARGIN_PX = 1  # lit pixels this close to a shadow's edge do not count: penumbra darkens them


def albedo_from_lit(length: FloatArray, lit: Mask, factor: int = 1) -> FloatArray:
    """Spread the albedo of fully lit pixels over the image.

    length: (h, w), `LightContributions.length`, which is the albedo where all three lights arrive
    (`lit`). factor: by how much the image is smaller than the frame whose detail counts. Returns (h, w),
    positive everywhere; 1, the calibration material's, where nothing is lit.
    """
    side = 2 * _MARGIN_PX + 1
    core = cv2.erode(lit.astype(np.uint8), np.ones((side, side), np.uint8)) > 0
    if not core.any():
        core = lit
    logarithm = np.log(np.maximum(length, _DARKEST))
    trust = core.astype(np.float32)
    if not core.any():
        return np.ones_like(logarithm, dtype=np.float32)
    finest = max(_FINEST_LEVEL - round(math.log2(factor)), 0)
    filled = fill_smoothly(logarithm, trust, finest)
    for _ in range(_ROUNDS):
        trust = core / (1.0 + ((logarithm - filled) / _OUTLIER) ** 2)
        filled = fill_smoothly(logarithm, trust, finest)
    return np.exp(filled)


# Values known on some pixels, spread smoothly over the rest (push–pull over an image pyramid).


def fill_smoothly(values: FloatArray, trust: FloatArray, finest_level: int = 0) -> FloatArray:
    """Return `values` where trusted, and a smooth continuation of them elsewhere (gortler1996).

    values: (h, w) or (h, w, c). trust: (h, w), 0 where a value is unknown. finest_level: detail below
    2**finest_level pixels is smoothed away even where trusted. Without any trusted pixel the result is 0.
    """
    weight: FloatArray = np.ascontiguousarray(trust, dtype=np.float32)
    values32: FloatArray = np.asarray(values, dtype=np.float32)
    total: FloatArray = values32 * _channels(weight, values32)
    pyramid = [(total, weight)]
    while max(weight.shape) > 1:
        size = ((weight.shape[1] + 1) // 2, (weight.shape[0] + 1) // 2)
        total = _resized(total, size, cv2.INTER_AREA)
        weight = _resized(weight, size, cv2.INTER_AREA)
        pyramid.append((total, weight))
    filled: FloatArray = pyramid[-1][0] / np.maximum(_channels(pyramid[-1][1], values32), 1e-20)
    for level in range(len(pyramid) - 2, -1, -1):
        total, weight = pyramid[level]
        coarse = _resized(filled, weight.shape[::-1], cv2.INTER_LINEAR)
        if level < finest_level:
            filled = coarse
            continue
        own = _channels(weight, values32)
        filled = (total + _LEAST_TRUST * coarse) / (own + _LEAST_TRUST)
    return filled


def _channels(weight: FloatArray, like: FloatArray) -> FloatArray:
    return weight if like.ndim == 2 else weight[..., None]


def _resized(image: FloatArray, size: tuple[int, ...], interpolation: int) -> FloatArray:
    """cv2.resize, which drops axes of length 1, with the axes put back."""
    resized = cv2.resize(image, size, interpolation=interpolation)
    return np.asarray(resized, dtype=np.float32).reshape(*size[::-1], *image.shape[2:])

"""The look of the knit: cables and ribs as relief of the mesh, stitches as detail, heathered yarn."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from vntoolkit.arrays import FloatArray, Points2

STITCH_M = (0.011, 0.0095)  # width and height of one stitch
_CABLE_SPACING_M, _CABLE_TWIST_M = 0.066, 0.070
_STRAND_SHIFT_M, _STRAND_WIDTH_M = 0.0085, 0.0065
_CABLE_HEIGHT_M, _RIB_HEIGHT_M, _RIB_SPACING_M = 0.0032, 0.0016, 0.0135
_STITCH_HEIGHT_M = 0.00045
_YARN_SPREAD = 0.05


def knit_relief(along_knit: Points2, gather: FloatArray) -> FloatArray:
    """Return (n,) metres by which cables and ribs stand out; along_knit: (n, 2) across and along the ribs."""
    x = along_knit[:, 0]
    offset = x - _CABLE_SPACING_M * np.round(x / _CABLE_SPACING_M)
    swing = _STRAND_SHIFT_M * np.sin(2.0 * np.pi * along_knit[:, 1] / _CABLE_TWIST_M)
    strands = [np.exp(-0.5 * ((offset - s * swing) / (0.5 * _STRAND_WIDTH_M)) ** 2) for s in (-1.0, 1.0)]
    cables = _CABLE_HEIGHT_M * np.maximum(*strands)
    ribs = _RIB_HEIGHT_M * np.cos(2.0 * np.pi * x / _RIB_SPACING_M)
    band = np.clip((1.0 - gather) / max(1.0 - float(gather.min()), 1e-9), 0.0, 1.0)
    return np.asarray((1.0 - band) * cables + band * ribs)


def stitch_tile(size: int = 48) -> FloatArray:
    """Return (size, size) the height of one stitch, metres: two yarns that lean into a V, tiling."""
    v, u = np.meshgrid(*(2 * [(np.arange(size) + 0.5) / size]), indexing="ij")
    height = np.zeros((size, size))
    for sign in (-1.0, 1.0):
        for row in (-1.0, 0.0, 1.0):
            along = v - row - 0.5
            across = (u - 0.5) - sign * (0.24 - 0.16 * along)
            yarn = np.exp(-0.5 * (across / 0.13) ** 2 - 0.5 * (along / 0.34) ** 2)
            height = np.maximum(height, yarn)
    return np.asarray(_STITCH_HEIGHT_M * height)


def heather_texture(rng: np.random.Generator, size: int = 256) -> FloatArray:
    """Return (size, size, 3) factors near 1: the yarn's uneven dye, without a change of hue, tiling."""
    noise = np.zeros((size, size))
    for blur in (0.8, 2.5, 7.0):
        layer = gaussian_filter(rng.standard_normal((size, size)), (blur, 1.6 * blur), mode="wrap")
        noise += layer / layer.std()
    factor = 1.0 - _YARN_SPREAD + _YARN_SPREAD * np.tanh(noise / noise.std())
    return np.repeat(factor[..., None], 3, axis=2).astype(np.float32)

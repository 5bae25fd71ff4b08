"""How noisy the normals of one frame are: as far as no surface has them.

The slopes of a surface add up to nothing around any loop. What four neighbouring pixels add up to instead is
noise, whatever the shape: of the camera on a smooth figure, of pores and hair on a head.
"""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, Mask

_FLATTEST_Z = 0.12  # |n_z| below which a slope is held
_MEDIAN_TO_DEVIATION = 1.4826
_FEWEST_LOOPS = 100


def slope_noise(normals: FloatArray, known: Mask) -> float | None:
    """Return the standard deviation of a facing normal's slope, or None with too few `known` pixels.

    normals: (h, w, 3), camera frame. A slope's noise grows with 1 / n_z², which is taken out. The median
    makes steps in depth, where loops do not close either, count for little.
    """
    facing = np.maximum(-normals[..., 2], _FLATTEST_Z)
    p, q = normals[..., 0] / facing, normals[..., 1] / facing
    along_u = 0.5 * (p[:-1, :-1] + p[:-1, 1:] - p[1:, :-1] - p[1:, 1:])
    along_v = 0.5 * (q[:-1, 1:] + q[1:, 1:] - q[:-1, :-1] - q[1:, :-1])
    loops = known[:-1, :-1] & known[:-1, 1:] & known[1:, :-1] & known[1:, 1:]
    if np.count_nonzero(loops) < _FEWEST_LOOPS:
        return None
    sums = np.abs((along_u + along_v) * facing[:-1, :-1] ** 2)[loops]
    return float(_MEDIAN_TO_DEVIATION * np.median(sums) / np.sqrt(2.0))  # of 8 slopes, a half each

"""The compiled loop of classical photometric stereo: robust least squares at one pixel, over all pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit, prange

fewest_lights = 3
_SMALLEST_DETERMINANT = 1e-6  # of the normal equations over the cube of their trace

Array = npt.NDArray[Any]


@njit(cache=True, error_model="numpy")
def _least_squares(samples: Array, lights: Array, use: Array, solution: Array) -> bool:
    """Solve the 3×3 normal equations over the samples in use; False where they are singular."""
    a = b = c = d = e = f = x = y = z = 0.0
    for k in range(len(samples)):
        if use[k]:
            lx, ly, lz, s = lights[k, 0], lights[k, 1], lights[k, 2], samples[k]
            a += lx * lx
            b += lx * ly
            c += lx * lz
            d += ly * ly
            e += ly * lz
            f += lz * lz
            x += lx * s
            y += ly * s
            z += lz * s
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d  # cofactors of the first row
    determinant = a * p + b * q + c * r
    trace = a + d + f
    if not determinant > _SMALLEST_DETERMINANT * trace * trace * trace:
        return False
    solution[0] = (p * x + q * y + r * z) / determinant
    solution[1] = (q * x + (a * f - c * c) * y + (b * c - a * e) * z) / determinant
    solution[2] = (r * x + (b * c - a * e) * y + (a * d - b * b) * z) / determinant
    return True


@njit(cache=True, error_model="numpy")
def _worst_sample(samples: Array, lights: Array, use: Array, solution: Array, outlier_share: float) -> int:
    """Index of the sample in use that departs most from the fit, or −1 if all agree with it."""
    albedo = np.sqrt(solution[0] ** 2 + solution[1] ** 2 + solution[2] ** 2)
    worst, largest = -1, outlier_share * albedo
    for k in range(len(samples)):
        if use[k]:
            strength = np.sqrt(lights[k, 0] ** 2 + lights[k, 1] ** 2 + lights[k, 2] ** 2)
            predicted = lights[k, 0] * solution[0] + lights[k, 1] * solution[1] + lights[k, 2] * solution[2]
            departure = abs(samples[k] - predicted) / strength
            if departure > largest:
                worst, largest = k, departure
    return worst


@njit(cache=True, parallel=True, error_model="numpy")
def robust_normals_kernel(
    images: Array, lights: Array, inside: Array, options: Array, scaled: Array, used: Array
) -> None:
    """Fill scaled (h, w, 3) with albedo × normal and used (h, w) with the share of the lights that count.

    images: (k, h, w) float32. lights: (k, 3). options: shadow share, saturation, outlier share, darkest.
    """
    count, height, width = images.shape
    shadow_share, saturation, outlier_share, darkest = options[0], options[1], options[2], options[3]
    for v in prange(height):
        samples, use, solution = np.empty(count), np.empty(count, np.bool_), np.empty(3)
        for u in range(width):
            if not inside[v, u]:
                continue
            samples[:] = images[:, v, u]
            brightest = np.max(samples)
            if not brightest > darkest:  # NaN ends here too
                continue
            left = 0
            for k in range(count):
                use[k] = shadow_share * brightest < samples[k] < saturation
                left += use[k]
            solved = left >= fewest_lights and _least_squares(samples, lights, use, solution)
            while solved and left > fewest_lights:
                worst = _worst_sample(samples, lights, use, solution, outlier_share)
                if worst < 0:
                    break
                use[worst] = False
                left -= 1
                if not _least_squares(samples, lights, use, solution):
                    break  # the last sound solution stands
            if solved:
                scaled[v, u] = solution
                used[v, u] = left / count

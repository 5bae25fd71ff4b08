"""Classical photometric stereo: many photographs, one white light each, least squares per pixel.

Woodham, Photometric method for determining surface orientation from multiple images, 1980 (woodham1980).
It is what brostow2011 compares coloured light with. Shadowed, clipped and glossy samples are left out pixel
by pixel; the rest is plain least squares.
"""

from dataclasses import dataclass

import numpy as np
from numba import prange

from vntoolkit.arrays import Array, Float32Array, FloatArray, Mask, Points, read_only
from vntoolkit.checks import checks_kinds, require_finite, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit

_FLATTEST_LIGHTS = 1e-3  # smallest over largest singular value: below it the lights lie in one plane
fewest_lights = 3
_SHADOW_SHARE = 0.1  # of a pixel's brightest sample: at most that, a sample is shadow
_SATURATION = 1.0  # linear value from which a sample is clipped
_OUTLIER_SHARE = (
    0.05  # of the albedo: a sample further off the fit is gloss or cast shadow; the worst goes first
)
_DARKEST = 0.01  # brightest sample, linear, below which a pixel has no normal
_SMALLEST_DETERMINANT = 1e-6  # of the normal equations over the cube of their trace


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoResult:
    """normal_map: with weight = share of the lights used. albedo: (h, w) float32, 0 where invalid."""

    normal_map: NormalMap
    albedo: Float32Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "albedo", read_only(self.albedo))


@checks_kinds
def normals_from_lights(images: FloatArray, lights: Points, mask: Mask | None = None) -> NormalMap:
    """Return only the normals of `solve_photometric_stereo`."""
    return solve_photometric_stereo(images, lights, mask).normal_map


def solve_photometric_stereo(images: FloatArray, lights: Points, mask: Mask | None = None) -> StereoResult:
    """Solve `images[k] = albedo · max(lights[k] · n, 0)` per pixel.

    images: (k, h, w) linear grey. lights: (k, 3), camera frame, direction to light k times its strength.
    mask: (h, w). A pixel needs three samples that are neither shadow nor clipped; where fewer than four are
    left, none can be told to be an outlier. Raises `BadInput` for fewer than three lights, coplanar ones, or
    one of no strength.
    """
    lights = np.ascontiguousarray(lights, dtype=np.float64)
    stack = _require_images(images, lights)
    shape = stack.shape[1:]
    inside = np.ones(shape, np.bool_) if mask is None else np.ascontiguousarray(mask)
    require_mask(inside, shape)
    scaled = np.zeros((*shape, 3), np.float32)
    used = np.zeros(shape, np.float32)
    robust_normals_kernel(stack, lights, inside, scaled, used)
    albedo = np.linalg.norm(scaled, axis=-1)
    valid = (albedo > 0) & (scaled[..., 2] < 0)
    normals = np.divide(scaled, albedo[..., None], out=np.zeros_like(scaled), where=valid[..., None])
    return StereoResult(
        normal_map=NormalMap(normals_in_camera=normals, mask=valid, weight=np.where(valid, used, 0)),
        albedo=np.where(valid, albedo, np.float32(0)),
    )


def _require_images(images: FloatArray, lights: Points) -> Array:
    require_shape(lights, (None, 3), "lights")
    require_finite(lights, "lights")
    if np.mean(lights[:, 2] > 0) > 0.5:
        raise BadInput(
            "lights: expected the camera's axes (x right, y down, z away from the viewer), where a light in "
            "front of the surface has z < 0, got z > 0 in most: multiply by [1, -1, -1]"
        )
    stack = np.ascontiguousarray(images, dtype=np.float32)
    require_shape(stack, (len(lights), None, None), "images (one for each light)")
    if len(lights) < fewest_lights:
        raise BadInput(f"photometric stereo: expected at least three lights, got {len(lights)}")
    singular = np.linalg.svd(lights, compute_uv=False)
    if not singular[2] > _FLATTEST_LIGHTS * singular[0]:
        raise BadInput("photometric stereo: the lights lie in one plane and cannot determine a normal")
    if not lights.any(axis=1).all():
        raise BadInput("photometric stereo: a light has no strength; leave its photograph out")
    return stack


# Compiled loop: robust least squares at every pixel.


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
def _worst_sample(samples: Array, lights: Array, use: Array, solution: Array) -> int:
    """Index of the sample in use that departs most from the fit, or −1 if all agree with it."""
    albedo = np.sqrt(solution[0] ** 2 + solution[1] ** 2 + solution[2] ** 2)
    worst, largest = -1, _OUTLIER_SHARE * albedo
    for k in range(len(samples)):
        if use[k]:
            strength = np.sqrt(lights[k, 0] ** 2 + lights[k, 1] ** 2 + lights[k, 2] ** 2)
            predicted = lights[k, 0] * solution[0] + lights[k, 1] * solution[1] + lights[k, 2] * solution[2]
            departure = abs(samples[k] - predicted) / strength
            if departure > largest:
                worst, largest = k, departure
    return worst


@njit(cache=True, parallel=True, error_model="numpy")
def robust_normals_kernel(images: Array, lights: Array, inside: Array, scaled: Array, used: Array) -> None:
    """Fill scaled (h, w, 3) with albedo × normal and used (h, w) with the share of the lights that count.

    images: (k, h, w) float32. lights: (k, 3).
    """
    count, height, width = images.shape
    for v in prange(height):
        samples, use, solution = np.empty(count), np.empty(count, np.bool_), np.empty(3)
        for u in range(width):
            if not inside[v, u]:
                continue
            samples[:] = images[:, v, u]
            brightest = np.max(samples)
            if not brightest > _DARKEST:  # NaN ends here too
                continue
            left = 0
            for k in range(count):
                use[k] = _SHADOW_SHARE * brightest < samples[k] < _SATURATION
                left += use[k]
            solved = left >= fewest_lights and _least_squares(samples, lights, use, solution)
            while solved and left > fewest_lights:
                worst = _worst_sample(samples, lights, use, solution)
                if worst < 0:
                    break
                use[worst] = False
                left -= 1
                if not _least_squares(samples, lights, use, solution):
                    break  # the last sound solution stands
            if solved:
                scaled[v, u] = solution
                used[v, u] = left / count

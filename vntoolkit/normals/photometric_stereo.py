"""Classical photometric stereo: many photographs, one white light each, least squares per pixel.

Woodham, Photometric method for determining surface orientation from multiple images, 1980 (woodham1980).
It is what brostow2011 compares coloured light with. Shadowed, clipped and glossy samples are left out pixel
by pixel; the rest is plain least squares.
"""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import Array, BoolArray, Float32Array, FloatArray, Mask, Points, read_only
from vntoolkit.checks import checks_kinds, require_finite, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap

_FLATTEST_LIGHTS = 1e-3  # smallest over largest singular value: below it the lights lie in one plane
fewest_lights = 3
_SHADOW_SHARE = 0.1  # of a pixel's brightest sample: at most that, a sample is shadow
_SATURATION = 1.0  # linear value from which a sample is clipped
_OUTLIER_SHARE = 0.05  # of the albedo: a sample further off the fit is gloss or cast shadow; the worst goes
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
    inside = np.ones(shape, np.bool_) if mask is None else mask.copy()
    require_mask(inside, shape)
    scaled, used = np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32)
    inside &= stack.max(axis=0) > _DARKEST  # NaN ends here too
    scaled[inside], used[inside] = _robust_normals(stack[:, inside].T, lights)
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


def _robust_normals(samples: FloatArray, lights: Points) -> tuple[Points, FloatArray]:
    """Return albedo × normal (n, 3), 0 where it is not told, and the share of the lights that count (n,).

    samples: (n, k). The sample that departs most from the fit goes, one at a time, while more are left than a
    fit needs; the last sound fit stands.
    """
    use = (samples > _SHADOW_SHARE * samples.max(axis=1, keepdims=True)) & (samples < _SATURATION)
    scaled, solved = _least_squares(samples, lights, use)
    scaled[~solved] = 0.0
    left = np.flatnonzero(solved)
    strengths = np.linalg.norm(lights, axis=1)
    while left.size:
        residuals = use[left] * np.abs(samples[left] - scaled[left] @ lights.T) / strengths
        worst = residuals.argmax(axis=1)
        off = residuals.max(axis=1) > _OUTLIER_SHARE * np.linalg.norm(scaled[left], axis=1)
        off &= use[left].sum(axis=1) > fewest_lights
        left, worst = left[off], worst[off]
        use[left, worst] = False
        found, solved = _least_squares(samples[left], lights, use[left])
        left = left[solved]
        scaled[left] = found[solved]
    return scaled, use.mean(axis=1)


def _least_squares(samples: FloatArray, lights: Points, use: BoolArray) -> tuple[Points, BoolArray]:
    """Solve the normal equations (n, 3) over the samples (n, k) in use; whether they are regular, (n,)."""
    matrix = np.einsum("nk,ki,kj->nij", use, lights, lights, optimize=True)
    trace = np.trace(matrix, axis1=1, axis2=2)
    regular = np.linalg.det(matrix) > _SMALLEST_DETERMINANT * trace**3
    regular &= use.sum(axis=1) >= fewest_lights
    matrix[~regular] = np.eye(3)
    return np.linalg.solve(matrix, ((use * samples) @ lights)[..., None])[..., 0], regular

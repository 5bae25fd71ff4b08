"""Classical photometric stereo: many photographs, one white light each, least squares per pixel.

Woodham, Photometric method for determining surface orientation from multiple images, 1980 (woodham1980).
It is what brostow2011 compares coloured light with. Shadowed, clipped and glossy samples are left out pixel
by pixel; the rest is plain least squares.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points, read_only
from vntoolkit.checks import require_finite, require_mask, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.normals.photometric_stereo_kernels import fewest_lights, robust_normals_kernel

_FLATTEST_LIGHTS = 1e-3  # smallest over largest singular value: below it the lights lie in one plane


@dataclass(frozen=True, kw_only=True)
class PhotometricStereoOptions:
    """Which samples of a pixel count.

    shadow_share: a sample is shadow where it is at most this share of the pixel's brightest. saturation:
    linear value from which a sample is clipped. outlier_share: a sample is gloss or cast shadow where it
    departs from the fit by more than this share of the pixel's albedo; the worst goes first. darkest:
    brightest sample, linear, below which a pixel has no normal.
    """

    shadow_share: float = 0.1
    saturation: float = 1.0
    outlier_share: float = 0.05
    darkest: float = 0.01

    def __post_init__(self) -> None:
        if not 0 <= self.shadow_share < 1:
            raise BadInput(f"shadow share: expected 0 to 1, got {self.shadow_share:g}")
        if not (self.outlier_share > 0 and self.saturation > 0 and self.darkest > 0):
            raise BadInput("outlier share, saturation and darkest: expected positive numbers")


@dataclass(frozen=True, kw_only=True, eq=False)
class StereoResult:
    """normal_map: with weight = share of the lights used. albedo: (h, w) float32, 0 where invalid."""

    normal_map: NormalMap
    albedo: npt.NDArray[np.float32]

    def __post_init__(self) -> None:
        object.__setattr__(self, "albedo", read_only(self.albedo))


def normals_from_lights(
    images: FloatArray,
    lights: Points,
    mask: Mask | None = None,
    options: PhotometricStereoOptions | None = None,
) -> NormalMap:
    """Return only the normals of `solve_photometric_stereo`."""
    return solve_photometric_stereo(images, lights, mask, options).normal_map


def solve_photometric_stereo(
    images: FloatArray,
    lights: Points,
    mask: Mask | None = None,
    options: PhotometricStereoOptions | None = None,
) -> StereoResult:
    """Solve `images[k] = albedo · max(lights[k] · n, 0)` per pixel.

    images: (k, h, w) linear grey. lights: (k, 3), camera frame, direction to light k times its strength.
    mask: (h, w). A pixel needs three samples that are neither shadow nor clipped; where fewer than four are
    left, none can be told to be an outlier. Raises `BadInput` for fewer than three lights, coplanar ones, or
    one of no strength.
    """
    options = options or PhotometricStereoOptions()
    lights = np.ascontiguousarray(lights, dtype=np.float64)
    stack = _require_images(images, lights)
    shape = stack.shape[1:]
    inside = np.ones(shape, np.bool_) if mask is None else np.ascontiguousarray(mask)
    require_mask(inside, shape)
    scaled = np.zeros((*shape, 3), np.float32)
    used = np.zeros(shape, np.float32)
    robust_normals_kernel(
        stack,
        lights,
        inside,
        np.array([options.shadow_share, options.saturation, options.outlier_share, options.darkest]),
        scaled,
        used,
    )
    albedo = np.linalg.norm(scaled, axis=-1)
    valid = (albedo > 0) & (scaled[..., 2] < 0)
    normals = np.divide(scaled, albedo[..., None], out=np.zeros_like(scaled), where=valid[..., None])
    return StereoResult(
        normal_map=NormalMap(normals_in_camera=normals, mask=valid, weight=np.where(valid, used, 0)),
        albedo=np.where(valid, albedo, np.float32(0)),
    )


def _require_images(images: FloatArray, lights: Points) -> npt.NDArray[Any]:
    require_shape(lights, (None, 3), "lights")
    require_finite(lights, "lights")
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

"""Normals from colour by inverting the light response: one normal per pixel and frame.

M⁻¹(r − a) is the normal times the surface's albedo relative to the calibration material. The direction is
the normal; the length, set against the albedo that is expected, tells how far the pixel can be trusted:
shadow, gloss and another paint all change it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Mask
from vntoolkit.checks import require_mask, require_positive, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.normals.inversion_kernels import (
    Coefficients,
    Decoding,
    Outputs,
    normals_from_integers_kernel,
    normals_from_rgb_kernel,
)
from vntoolkit.normals.varying_kernels import (
    Field,
    field_from_response,
    normals_from_integers_in_field,
    normals_from_rgb_in_field,
)
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.lambertian import scaled_normals_from_rgb
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer, decoding_table

Single = npt.NDArray[np.float32]


class ClippedPixels(Enum):
    """What becomes of a pixel with a saturated channel, whose colour is only a bound."""

    DOWNWEIGHT = "downweight"  # a normal stays, at a tenth of its weight, so that the domain has no hole
    EXCLUDE = "exclude"


@dataclass(frozen=True, kw_only=True)
class InversionOptions:
    """How colours become normals.

    relative_albedo: expected length of M⁻¹(r − a), the surface's albedo over the calibration material's (1 if
    it is the same material; `relative_albedo_from_frame` measures it). albedo_tolerance: relative departure
    from the expected albedo that halves a pixel's weight. darkest: share of the expected albedo below which a
    pixel is black and has no normal. clipped: what becomes of saturated pixels.
    """

    relative_albedo: float = 1.0
    albedo_tolerance: float = 0.25
    darkest: float = 0.05
    clipped: ClippedPixels = ClippedPixels.DOWNWEIGHT

    def __post_init__(self) -> None:
        require_positive(self.relative_albedo, "relative albedo")
        require_positive(self.albedo_tolerance, "albedo tolerance")
        if not 0 < self.darkest < 1:
            raise BadInput(f"darkest: expected a share between 0 and 1, got {self.darkest:g}")

    @property
    def clipped_factor(self) -> float:
        """The factor on a clipped pixel's weight; 0 excludes it."""
        return 0.1 if self.clipped is ClippedPixels.DOWNWEIGHT else 0.0


def normals_from_frame(
    frame: LinearFrame,
    response: LightResponse,
    mask: Mask | None = None,
    options: InversionOptions | None = None,
) -> NormalMap:
    """Equation 1: n = M⁻¹(r − a) / |M⁻¹(r − a)| at every pixel (brostow2011).

    frame: linear colour (h, w, 3). mask: (h, w), pixels of interest; default all. Invalid in the result:
    outside the mask, black, turned away from the camera, not finite, or clipped where so chosen. The
    weight is 1 where the albedo is as expected and 1/2 where it is off by `albedo_tolerance`.
    """
    inside = _require_mask(mask, frame.shape)
    out = _outputs(frame.shape)
    rgb = np.ascontiguousarray(frame.rgb)
    c = coefficients_from_response(response, options)
    if response.variation is None:
        normals_from_rgb_kernel(rgb, frame.clipped, inside, c, out)
    else:
        normals_from_rgb_in_field(rgb, frame.clipped, inside, _field(response, options), c, out)
    return _map_from_outputs(out)


def normals_from_encoded(
    encoded: npt.NDArray[Any],
    response: LightResponse,
    transfer: Transfer,
    mask: Mask | None = None,
    options: InversionOptions | None = None,
    bits: int | None = None,
) -> NormalMap:
    """Decode and invert in one pass: `normals_from_frame` of stored uint8 or uint16 samples (h, w, 3), RGB.

    transfer: the capture's curve and levels. bits: significant bits of a sample, default all. A sample at or
    above the white level is clipped.
    """
    shape = _require_encoded(encoded)
    out = _outputs(shape)
    image, decoding = np.ascontiguousarray(encoded), _decoding(encoded, transfer, bits)
    inside, c = _require_mask(mask, shape), coefficients_from_response(response, options)
    if response.variation is None:
        normals_from_integers_kernel(image, decoding, inside, c, out)
    else:
        normals_from_integers_in_field(image, decoding, inside, _field(response, options), c, out)
    return _map_from_outputs(out)


def relative_albedo_from_frame(
    frame: LinearFrame, response: LightResponse, mask: Mask | None = None
) -> float:
    """Median length of M⁻¹(r − a) over the lit pixels: the surface's albedo over the calibration material's.

    Lit means: brighter than a tenth of the frame's 99th percentile, and not clipped. Raises `BadInput` where
    no pixel is.
    """
    inside = _require_mask(mask, frame.shape) & ~frame.clipped
    inside &= (frame.rgb > response.ambient).any(axis=2)
    v, u = np.nonzero(inside)
    scaled = scaled_normals_from_rgb(frame.rgb[inside], response, np.stack([u, v], axis=-1))
    lengths = np.linalg.norm(scaled, axis=1)
    lengths = lengths[np.isfinite(lengths)]
    if lengths.size:
        lengths = lengths[lengths > 0.1 * np.percentile(lengths, 99)]
    if not lengths.size:
        raise BadInput(f"frame {frame.number}: no lit pixel (all black or clipped) to measure the albedo on")
    return float(np.median(lengths))


def coefficients_from_response(response: LightResponse, options: InversionOptions | None) -> Coefficients:
    """What the loops need to know."""
    options = options or InversionOptions()
    inverse = response.inverse / options.relative_albedo
    return Coefficients(
        inverse=inverse.astype(np.float32),
        offset=(inverse @ response.ambient).astype(np.float32),
        darkest=np.float32(options.darkest),
        sharpness=np.float32(0.5 / options.albedo_tolerance),
        clipped_factor=np.float32(options.clipped_factor),
    )


def _field(response: LightResponse, options: InversionOptions | None) -> Field:
    return field_from_response(response, (options or InversionOptions()).relative_albedo)


def _decoding(encoded: npt.NDArray[Any], transfer: Transfer, bits: int | None) -> Decoding:
    storage_bits = encoded.dtype.itemsize * 8
    table = decoding_table(transfer, bits or storage_bits, storage_bits)
    white = (transfer.white_level - transfer.black_level) / (1.0 - transfer.black_level)
    return Decoding(table=table, white=np.float32(white * (1.0 - 1e-6)))


def _require_encoded(encoded: npt.NDArray[Any]) -> tuple[int, int]:
    if encoded.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"image: expected 8- or 16-bit samples, got {encoded.dtype}")
    require_shape(encoded, (None, None, 3), "image")
    return encoded.shape[0], encoded.shape[1]


def _require_mask(mask: Mask | None, shape: tuple[int, int]) -> Mask:
    if mask is None:
        return np.ones(shape, dtype=np.bool_)
    require_mask(mask, shape)
    return np.ascontiguousarray(mask)


def _outputs(shape: tuple[int, int]) -> Outputs:
    return Outputs(
        normals=np.empty((*shape, 3), np.float32),
        weight=np.empty(shape, np.float32),
        valid=np.empty(shape, np.bool_),
    )


def _map_from_outputs(out: Outputs) -> NormalMap:
    return NormalMap(normals_in_camera=out.normals, mask=out.valid, weight=out.weight)

"""Normals from colour by inverting the light response: one normal per pixel and frame.

M⁻¹(r − a) is the normal times the surface's albedo relative to the calibration material. The direction is
the normal; the length, set against the albedo that is expected, tells how far the pixel can be trusted:
shadow, gloss and another paint all change it.
"""

import numpy as np

from vntoolkit.arrays import Float32Array, Mask
from vntoolkit.checks import checks_kinds, require_mask
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.options.normals import InversionOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.levelling import leveller_of
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb

_LONGEST = np.float32(1e18)  # squares beyond it overflow float32: treated as not finite


@checks_kinds
def normals_from_frame(
    frame: LinearFrame,
    response: LightResponse,
    mask: Mask | None = None,
    camera: Camera | None = None,
    options: InversionOptions | None = None,
) -> NormalMap:
    """Equation 1: n = M⁻¹(r − a) / |M⁻¹(r − a)| at every pixel (brostow2011).

    frame: linear colour (h, w, 3). mask: (h, w), pixels of interest; default all. camera: tells from where a
    pixel is seen, so that no normal faces away from there; None for orthographic. Invalid in the result:
    outside the mask, black, turned away from the camera, or clipped where so chosen. The
    weight is 1 where the albedo is as expected and 1/2 where it is off by `albedo_tolerance`.
    """
    if response.is_of_changes:
        raise BadInput(
            "normals: expected the M of a surface, got a gel's, which is of changes of colour; take `Gel`, "
            "which rectifies the frame and subtracts the untouched gel"
        )
    inside = require_mask_or_all(mask, frame.shape)
    found = _normalised(frame, _scaled_normals(frame, response), inside, options or InversionOptions())
    return found if camera is None else _towards(found, camera)


def _towards(normal_map: NormalMap, camera: Camera) -> NormalMap:
    """Drop normals that face away from where a perspective camera sees their pixel."""
    if not camera.is_perspective:
        return normal_map
    if normal_map.shape != (camera.height, camera.width):
        h, w = normal_map.shape
        raise BadInput(f"frame is {w}×{h} but the camera is {camera.width}×{camera.height}")
    rays = camera.points_from_depth(np.ones(normal_map.shape))
    kept = normal_map.mask & ((normal_map.normals_in_camera * rays).sum(axis=2) < 0)
    normals = np.where(kept[..., None], normal_map.normals_in_camera, np.float32(0))
    assert normal_map.weight is not None
    weight = np.where(kept, normal_map.weight, np.float32(0))
    return NormalMap(normals_in_camera=normals, mask=kept, weight=weight)


@checks_kinds
def relative_albedo_from_frame(
    frame: LinearFrame, response: LightResponse, mask: Mask | None = None
) -> float:
    """Median length of M⁻¹(r − a) over the lit pixels: the surface's albedo over the calibration material's.

    Lit means: brighter than a tenth of the frame's 99th percentile, and not clipped. Raises `BadInput` where
    no pixel is.
    """
    inside = require_mask_or_all(mask, frame.shape) & ~frame.clipped
    inside &= (frame.rgb > response.ambient).any(axis=2)
    lengths = np.linalg.norm(_scaled_normals(frame, response)[inside], axis=1)
    lengths = lengths[np.isfinite(lengths)]
    if lengths.size:
        lengths = lengths[lengths > 0.1 * np.percentile(lengths, 99)]
    if not lengths.size:
        raise BadInput(f"frame {frame.number}: no lit pixel (all black or clipped) to measure the albedo on")
    return float(np.median(lengths))


def require_mask_or_all(mask: Mask | None, shape: tuple[int, int]) -> Mask:
    """Return the mask, True everywhere for None."""
    if mask is None:
        return np.ones(shape, dtype=np.bool_)
    require_mask(mask, shape)
    return np.ascontiguousarray(mask)


def _scaled_normals(frame: LinearFrame, response: LightResponse) -> Float32Array:
    """(h, w, 3) M⁻¹(r − a); where M varies, of the frame as the M of the centre would have formed it."""
    level = frame if response.variation is None else leveller_of(response, frame.shape).frame(frame)
    return np.asarray(scaled_normals_from_rgb(level.rgb, response.central), np.float32)


def _normalised(
    frame: LinearFrame, scaled: Float32Array, inside: Mask, options: InversionOptions
) -> NormalMap:
    """Scale M⁻¹(r − a) to unit length, with its weight; 0 where there is no normal."""
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.sqrt(np.einsum("vui,vui->vu", scaled, scaled)) / np.float32(options.relative_albedo)
        valid = inside & (length > options.darkest) & (length < _LONGEST) & (scaled[..., 2] < 0)
    if options.clipped_factor == 0.0:
        valid &= ~frame.clipped
    length = np.where(valid, length, np.float32(1))
    over = np.where(valid, 1 / (length * np.float32(options.relative_albedo)), np.float32(0))
    departure = (length - 1 / length) * np.float32(0.5 / options.albedo_tolerance)  # relative, near 1
    weight = np.where(frame.clipped, np.float32(options.clipped_factor), np.float32(1))
    weight *= valid / (1 + departure * departure)
    normals = np.where(valid[..., None], scaled, np.float32(0)) * over[..., None]
    return NormalMap(normals_in_camera=normals, mask=valid, weight=weight)

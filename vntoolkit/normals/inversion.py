"""Normals from colour by inverting the light response: one normal per pixel and frame.

M⁻¹(r − a) is the normal times the surface's albedo relative to the calibration material. The direction is
the normal; the length, set against the albedo that is expected, tells how far the pixel can be trusted:
shadow, gloss and another paint all change it.
"""

from typing import Any, NamedTuple

import numpy as np

from vntoolkit.arrays import Array, Mask
from vntoolkit.checks import checks_kinds, require_mask
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit
from vntoolkit.options.normals import InversionOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.levelling import leveller_of, map_row, span_of
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb

_LONGEST = np.float32(1e18)  # squares beyond it overflow float32: treated as not finite
_ALBEDO_TOLERANCE = 0.25  # relative departure from the expected albedo that halves a pixel's weight
_ZERO = np.float32(0)
_ONE = np.float32(1)


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
    weight is 1 where the albedo is as expected and 1/2 where it is off by a quarter.
    """
    if response.is_of_changes:
        raise BadInput(
            "normals: expected the M of a surface, got a gel's, which is of changes of colour; take `Gel`, "
            "which rectifies the frame and subtracts the untouched gel"
        )
    inside = require_mask_or_all(mask, frame.shape)
    clipped = np.ascontiguousarray(frame.clipped)
    found = _inverted(np.ascontiguousarray(frame.rgb), clipped, inside, response, options)
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
    assert normal_map.weight is not None  # every map of these loops has one
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
    if response.variation is None:  # of every frame: an array a step would take most of its time
        lengths = _lengths(frame.rgb, inside, response.inverse, response.ambient)
    else:
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


@njit
def _lengths(rgb: Any, inside: Any, inverse: Any, ambient: Any) -> Any:
    """(n,), lengths of M⁻¹(r − a) of the pixels inside that are brighter than the ambient light."""
    found, count = np.empty(inside.size), 0
    for v in range(inside.shape[0]):
        for u in range(inside.shape[1]):
            r, g, b = rgb[v, u, 0] - ambient[0], rgb[v, u, 1] - ambient[1], rgb[v, u, 2] - ambient[2]
            if inside[v, u] and (r > 0.0 or g > 0.0 or b > 0.0):
                x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
                y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
                z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
                found[count] = np.sqrt(x * x + y * y + z * z)
                count += 1
    return found[:count]


def coefficients_from_response(response: LightResponse, options: InversionOptions | None) -> "AffineInverse":
    """What the loops need to know."""
    options = options or InversionOptions()
    inverse = response.inverse / options.relative_albedo
    return AffineInverse(
        inverse=inverse.astype(np.float32),
        offset=(inverse @ response.ambient).astype(np.float32),
        darkest=np.float32(options.darkest),
        sharpness=np.float32(0.5 / _ALBEDO_TOLERANCE),
        clipped_factor=np.float32(options.clipped_factor),
    )


def require_mask_or_all(mask: Mask | None, shape: tuple[int, int]) -> Mask:
    """Return the mask, True everywhere for None."""
    if mask is None:
        return np.ones(shape, dtype=np.bool_)
    require_mask(mask, shape)
    return np.ascontiguousarray(mask)


def _inverted(
    image: Array, clipped: Mask, inside: Mask, response: LightResponse, options: InversionOptions | None
) -> NormalMap:
    """Return the normals of linear colours (h, w, 3) with their clipped pixels."""
    options = options or InversionOptions()
    shape = inside.shape
    maps = None if response.variation is None else leveller_of(response, shape).maps
    out = Outputs(
        normals=np.empty((*shape, 3), np.float32),
        weight=np.empty(shape, np.float32),
        valid=np.empty(shape, np.bool_),
    )
    c = coefficients_from_response(response, options)
    flat = out._replace(normals=rows_of(out.normals))
    _normals_kernel(rows_of(image), clipped, inside, maps, c, flat)
    return NormalMap(normals_in_camera=out.normals, mask=out.valid, weight=out.weight)


def rows_of(image: Array) -> Array:
    """Return an image (h, w, 3) as rows (h, 3 w)."""
    return image.reshape(len(image), -1)


class AffineInverse(NamedTuple):
    """What the loops need to know, all float32.

    inverse: M⁻¹ over the expected albedo, (3, 3). offset: the same times the ambient light, (3,). darkest:
    smallest length of a pixel that has a normal. sharpness: 1 / (2 albedo tolerance). clipped_factor: on a
    clipped pixel's weight.
    """

    inverse: Array
    offset: Array
    darkest: np.float32
    sharpness: np.float32
    clipped_factor: np.float32


class Outputs(NamedTuple):
    """normals (h, 3 w) float32, weight (h, w) float32, valid (h, w) bool: filled by the loop."""

    normals: Array
    weight: Array
    valid: Array


# Compiled loops: one pass over the image, row by row. Maps of None stand for one M all over the image: numba
# drops the branches for the other. Rows are flat slices, and what every pixel shares is read before a loop:
# only such loops are done many pixels at a time.


@njit
def _normals_kernel(
    image: Array, clipped: Array, inside: Array, maps: Any, c: AffineInverse, out: Outputs
) -> None:
    """Fill `out` from linear colours (h, 3 w) with their clipped pixels (h, w)."""
    height, width = inside.shape
    normals, weight, valid = out
    for v in range(height):
        first, last = span_of(inside[v])
        count = last - first
        x, y, z = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
        read_row(image[v, 3 * first : 3 * last], x, y, z)
        if maps is not None:
            map_row(maps, v, first, x, y, z)
        _mix_row(c, x, y, z)
        for side in (slice(0, first), slice(last, width)):
            weight[v, side], valid[v, side] = _ZERO, False
        normals[v, : 3 * first], normals[v, 3 * last :] = _ZERO, _ZERO
        within = slice(first, last)
        _normalise_row(x, y, z, clipped[v, within], inside[v, within], c, weight[v, within], valid[v, within])
        to = normals[v, 3 * first : 3 * last]
        for u in range(count):
            to[3 * u] = x[u]
            to[3 * u + 1] = y[u]
            to[3 * u + 2] = z[u]


@njit
def read_row(line: Any, r: Any, g: Any, b: Any) -> None:
    """Fill three rows (w,) from a row of colours or normals, (3 w,)."""
    for u in range(len(r)):
        r[u], g[u], b[u] = line[3 * u], line[3 * u + 1], line[3 * u + 2]


@njit
def _mix_row(c: AffineInverse, x: Array, y: Array, z: Array) -> None:
    """Replace the colours in x, y, z by M⁻¹(r − a)."""
    i00, i01, i02 = c.inverse[0, 0], c.inverse[0, 1], c.inverse[0, 2]
    i10, i11, i12 = c.inverse[1, 0], c.inverse[1, 1], c.inverse[1, 2]
    i20, i21, i22 = c.inverse[2, 0], c.inverse[2, 1], c.inverse[2, 2]
    a, b, d = c.offset[0], c.offset[1], c.offset[2]
    for u in range(len(x)):
        red, green, blue = x[u], y[u], z[u]
        x[u] = i00 * red + i01 * green + i02 * blue - a
        y[u] = i10 * red + i11 * green + i12 * blue - b
        z[u] = i20 * red + i21 * green + i22 * blue - d


@njit
def _normalise_row(
    x: Array, y: Array, z: Array, clipped: Array, inside: Array, c: AffineInverse, weight: Array, valid: Array
) -> None:
    """Scale one row to unit length, with its weight; 0 where there is no normal."""
    darkest, sharpness, clipped_factor = c.darkest, c.sharpness, c.clipped_factor
    for u in range(len(x)):
        length = np.sqrt(x[u] * x[u] + y[u] * y[u] + z[u] * z[u])
        factor = clipped_factor if clipped[u] else _ONE
        good = inside[u] & (length > darkest) & (length < _LONGEST) & (z[u] < _ZERO) & (factor > _ZERO)
        scale = _ONE / length
        departure = (length - scale) * sharpness  # near 1: the relative departure over the tolerance
        weight[u] = factor / (_ONE + departure * departure) if good else _ZERO
        x[u] = x[u] * scale if good else _ZERO
        y[u] = y[u] * scale if good else _ZERO
        z[u] = z[u] * scale if good else _ZERO
        valid[u] = good

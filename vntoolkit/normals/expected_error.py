"""How far off is each normal? The angle that nine of ten normals stay within, from the footage itself.

Independent errors add up in squares. `frame_evidence` measures three of them on the frame itself: noise,
relief that blur took, an error of M. Beside them

- the rotation in M⁻¹ΔM leaves no trace; its size is taken to be E's, the symmetric part's;
- the rig's own residual is what its calibration could not explain. That of a ball's pixels holds the noise of
  the calibration, too, which would count twice: as much as this footage has is taken away;
- what departs from the ellipsoid by more than three standard deviations of the frame's own lengths is another
  paint, gloss, or a light that is missing;
- where a light is missing the normal rests on its surroundings. Two lights leave two normals, mirror images
  across the plane of the two. The distance from the found normal to the nearer of them counts. So does the
  distance to the other one, which may be the right one, unless found and nearer one both face away from the
  missing light: that explains the shadow. Both hang on the albedo, which the surroundings tell: with it they
  move in the plane of the two lights, and across it the more, the nearer to it they lie. One light leaves a
  cone of normals, which tells next to nothing.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import prange

from vntoolkit.arrays import Array, ByteArray, Float32Array, Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, NormalMap
from vntoolkit.native import njit
from vntoolkit.normals.frame_evidence import (
    LEAST_FACING,
    LONGEST,
    SHORTEST,
    Coefficients,
    FrameLight,
    brightness_at,
    coefficients_from_rig,
    evidence_of_frame,
    evidence_row,
)
from vntoolkit.normals.inversion import (
    coefficients_from_response,
    decoding_of,
    read_row,
    require_encoded,
    require_mask_or_all,
    rows_of,
)
from vntoolkit.options.normals import InversionOptions
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import FLAGS, leveller_of, map_row, span_of
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer

# Nine of ten angles of a two-dimensional normal distribution lie within √(2 ln 10) standard deviations.
NINE_OF_TEN = 2.146
OF_ANGLE = NINE_OF_TEN / math.sqrt(2.0)  # … and within 1.5 times the root of their mean square
# … and, where five numbers tell that mean square, as the entries of E, within √F₀.₉(2, 5) times the root.
_OF_ELLIPSOID = 1.944
# The bounds of nine of ten pixels over each measured error, fitted on simulated scenes.
_OF_RESIDUAL = 1.1  # of a median
_OF_LENGTH = 2.75  # radians over a log length that departs from the ellipsoid
_OF_TWO_LIGHTS = 1.2  # radians over the distances to the normals that two lights leave
_ALBEDO_SPREAD = np.float32(0.03)  # relative standard deviation of lit pixels' albedo about the surroundings'
# A sphere shows nine tenths of its image within this angle of the axis: what a guess without data is worth.
_LARGEST_DEG = np.float32(71.6)

# The same, as the loops need it: squared, in degrees.
_PER_NOISE = np.float32(np.degrees(NINE_OF_TEN) ** 2)
_PER_TURN = np.float32(np.degrees(_OF_ELLIPSOID) ** 2)
_PER_DEPARTURE = np.float32(np.degrees(_OF_LENGTH) ** 2)
_PER_HALF_WEIGHT = np.float32(1.0 / HALF_WEIGHT_DEG)
_PER_DISTANCE = np.float32(np.degrees(_OF_TWO_LIGHTS) ** 2)


def with_expected_error(
    normal_map: NormalMap,
    frame: LinearFrame,
    response: LightResponse,
    labels: VisibilityLabels | None = None,
    camera: Camera | None = None,
    residual_deg: float = 0.0,
    blur_px: float = 0.0,
    residual_of_pixels: bool = False,
) -> NormalMap:
    """Return the map with the angle in degrees that nine of ten normals stay within, and the weight from it.

    The weight is 1 without error and 1/2 at 12 degrees.

    frame: the (h, w, 3) colours that the normals came from, as the central M of `response` forms them.
    labels: (h, w), bit k set where light k arrives; None for all, and for normals of the colours alone.
    camera: None for orthographic; distortion is ignored. residual_deg: median residual of the rig's
    calibration. blur_px: standard deviation of the picture's blur, 0 for unknown. residual_of_pixels: whether
    the residual is that of single pixels, noise included, for which this frame's own stands.
    Raises `BadInput` for other shapes.
    """
    shape = normal_map.shape
    require_shape(frame.rgb, (*shape, 3), "frame of the normals")
    if labels is not None:
        require_shape(labels, shape, "visibility labels")
        labels = np.ascontiguousarray(labels)
    clipped = np.ascontiguousarray(frame.clipped)
    light = FrameLight(np.ascontiguousarray(frame.rgb), None, clipped, np.float32(0), None)
    mask = np.ascontiguousarray(normal_map.mask)
    c = coefficients_from_rig(response, camera)
    noise_deg, turns, constants = _judged(light, mask, labels, c, residual_deg, blur_px, residual_of_pixels)
    error, weight = np.empty(shape, np.float32), np.empty(shape, np.float32)
    found = rows_of(np.ascontiguousarray(normal_map.normals_in_camera, np.float32))
    _error_kernel(
        rows_of(light.image), found, mask, labels, _pairs_of_lights(response), turns, constants, error, weight
    )
    return replace(normal_map, error_deg=error, noise_deg=noise_deg, weight=weight)


def with_doubt(normal_map: NormalMap, doubt_deg: Float32Array) -> NormalMap:
    """Return the map with a further, independent error (h, w) in degrees, and the weight from both."""
    assert normal_map.error_deg is not None
    error, weight = np.empty((2, *normal_map.mask.shape), np.float32)
    _add_doubt(normal_map.error_deg, doubt_deg, normal_map.mask, error, weight)
    return replace(normal_map, error_deg=error, weight=weight)


def doubts_of_materials(
    numbers: ByteArray, bounds_deg: Float32Array, turned_deg: Float32Array | None
) -> Float32Array:
    """Return (h, w), degrees: the bound (m,) of each pixel's material, and a further, independent doubt.

    numbers: (h, w), of the materials. turned_deg: (h, w), None for 0.
    """
    doubts = np.empty(numbers.shape, np.float32)
    _fill_doubts(
        numbers, bounds_deg, np.zeros((1, 1), np.float32) if turned_deg is None else turned_deg, doubts
    )
    return doubts


@njit(cache=True, parallel=True, error_model="numpy")
def _add_doubt(told: Any, doubt: Any, mask: Any, error: Any, weight: Any) -> None:
    for v in prange(len(mask)):
        for u in range(mask.shape[1]):
            e = min(np.sqrt(told[v, u] * told[v, u] + doubt[v, u] * doubt[v, u]), _LARGEST_DEG)
            half = e * _PER_HALF_WEIGHT
            error[v, u] = e if mask[v, u] else np.float32(0.0)
            weight[v, u] = (
                np.float32(1.0) / (np.float32(1.0) + half * half) if mask[v, u] else np.float32(0.0)
            )


@njit(cache=True, parallel=True, error_model="numpy")
def _fill_doubts(numbers: Any, bounds: Any, turned: Any, out: Any) -> None:
    """turned: (1, 1) where it is 0 everywhere."""
    is_turned = turned.size > 1
    for v in prange(len(numbers)):
        for u in range(numbers.shape[1]):
            bound = bounds[numbers[v, u]]
            rest = turned[v, u] if is_turned else np.float32(0.0)
            out[v, u] = np.sqrt(bound * bound + rest * rest)


def _pairs_of_lights(response: LightResponse) -> Float32Array:
    """Return (8, 6): for labels of two lights the normal of the plane of both and the third's direction."""
    pairs = np.zeros((8, 6))
    for missing in range(3):
        one, other = np.delete(response.light_directions, missing, axis=0)
        across = np.cross(one, other)
        pairs[ALL_LIT - (1 << missing), :3] = across / max(float(np.linalg.norm(across)), 1e-12)
        pairs[ALL_LIT - (1 << missing), 3:] = response.light_directions[missing]
    return pairs.astype(np.float32)


def normals_and_errors_from_encoded(
    encoded: Array,
    response: LightResponse,
    transfer: Transfer,
    mask: Mask | None = None,
    *,
    camera: Camera | None = None,
    options: InversionOptions | None = None,
    bits: int | None = None,
    residual_deg: float = 0.0,
    blur_px: float = 0.0,
    residual_of_pixels: bool = False,
) -> tuple[NormalMap, float]:
    """Decode, invert and tell the error in one pass; return the map and the share of clipped pixels.

    The normals of `normals_from_encoded` with the errors of `with_expected_error`.
    """
    shape = require_encoded(encoded)
    inside, decoding = require_mask_or_all(mask, shape), decoding_of(encoded, transfer, bits)
    maps = None if response.variation is None else leveller_of(response, shape).maps
    light = FrameLight(np.ascontiguousarray(encoded), decoding.table, None, decoding.white, maps)
    options = options or InversionOptions()
    c = coefficients_from_rig(response, camera, options.relative_albedo, options.darkest)
    noise_deg, turns, constants = _judged(light, inside, None, c, residual_deg, blur_px, residual_of_pixels)
    inversion = coefficients_from_response(response, options)
    limits = np.array([inversion.darkest, inversion.clipped_factor, decoding.white], np.float32)
    normals, valid = np.empty((*shape, 3), np.float32), np.empty(shape, np.bool_)
    error, weight = np.empty(shape, np.float32), np.empty(shape, np.float32)
    clipped = np.zeros(shape[0], np.int64)
    out = (rows_of(normals), valid, error, weight, clipped)
    image = rows_of(light.image)
    _normals_and_errors_kernel(image, decoding.table, maps, inside, turns, constants, limits, out)
    found = NormalMap(
        normals_in_camera=normals,
        mask=valid,
        weight=weight,
        error_deg=error,
        noise_deg=noise_deg,
    )
    return found, float(clipped.sum()) / max(1, shape[0] * shape[1])


def _judged(
    light: FrameLight, mask: Mask, labels: VisibilityLabels | None, c: Coefficients, residual_deg: float,
    blur_px: float, of_pixels: bool,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Return the noise by cells, in degrees as the bounds are, what `evidence_row` reads, and constants.

    Constants, (28,): M⁻¹, the ambient light, the squared bound that all pixels share, and of `fit_ellipsoid`
    all but the last.
    """
    noise, seen, rows, ellipsoid = evidence_of_frame(light, mask, labels, c, blur_px)
    residual = (_OF_RESIDUAL * max(residual_deg, 0.0)) ** 2
    if of_pixels and seen.any():
        residual = max(residual - float(_PER_NOISE * np.median(noise[seen > 0])), 0.0)
    fixed = residual + (np.degrees(_OF_ELLIPSOID) * ellipsoid[15]) ** 2
    constants = np.concatenate([c.inverse.ravel(), c.ambient, (fixed,), ellipsoid[:15]])
    return np.sqrt(_PER_NOISE * noise), rows, constants.astype(np.float32)


# Compiled loops. A table of None stands for linear light: numba drops the branches for another. Rows are
# flat slices, whose loops begin at 0: only such loops are done eight pixels at a time.


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _bound_row(
    r: Any, g: Any, b: Any, unlit: Any, turns: Any, inside: Any, k: Any, at: Any, length: Any, bound: Any,
    weight: Any,
) -> None:  # fmt: skip
    """Turn a row of colours into unit normals, in place, and fill their length, their bound and its weight.

    unlit: squared bound of pixels that not all lights reach, else 0. turns: variances, of noise and of lost
    relief. at: `brightness_at` of the first pixel.
    """
    zero, half, one, nine = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(9.0)
    i00, i01, i02, i10, i11, i12, i20, i21, i22 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8]
    a0, a1, a2, fixed, inverse_albedo = k[9], k[10], k[11], k[12], k[13]
    e00, e01, e02, e11, e12, e22 = k[14], k[15], k[16], k[17], k[18], k[19]
    f0, f1, f2, usual, told = at[0], at[1], at[2], k[26], k[27]
    for u in range(len(r)):  # without a branch: eight pixels at a time
        red, green, blue = r[u] - a0, g[u] - a1, b[u] - a2
        x = i00 * red + i01 * green + i02 * blue
        y = i10 * red + i11 * green + i12 * blue
        z = i20 * red + i21 * green + i22 * blue
        size = np.sqrt(x * x + y * y + z * z)
        seen = (size > SHORTEST) & (size < LONGEST)
        scale = one / size if seen else one
        x, y, z = x * scale, y * scale, z * scale
        t0 = e00 * x + e01 * y + e02 * z
        t1 = e01 * x + e11 * y + e12 * z
        t2 = e02 * x + e12 * y + e22 * z
        along = t0 * x + t1 * y + t2 * z
        turn = max(t0 * t0 + t1 * t1 + t2 * t2 - along * along, zero)
        foretold = max(along + f0 + np.float32(u) * (f1 + np.float32(u) * f2), LEAST_FACING)
        measured = max(size * inverse_albedo, SHORTEST)
        departure = abs(measured * measured - foretold * foretold) / (measured * foretold) * half
        departure = min(departure * departure, one)  # squared sinh of the log length
        # as robust fits weigh: next to nothing within three standard deviations, all of it far beyond
        own = departure * departure / (departure + nine * (usual + turns[u]) + SHORTEST)
        own = own if unlit[u] == zero else zero
        total = fixed + _PER_TURN * told * turn + _PER_NOISE * turns[u] + _PER_DEPARTURE * own + unlit[u]
        angle = min(np.sqrt(total), _LARGEST_DEG) if size > SHORTEST else _LARGEST_DEG
        share = angle * _PER_HALF_WEIGHT
        bound[u] = angle if inside[u] else zero
        weight[u] = one / (one + share * share) if inside[u] else zero
        r[u], g[u], b[u], length[u] = x, y, z, size


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _error_kernel(
    rgb: Any, normals: Any, mask: Mask, labels: Any, pairs: Any, turns: Any, constants: Any, error: Any,
    weight: Any,
) -> None:  # fmt: skip
    """Fill (h, w) with the bound in degrees and its weight; 0 outside the mask.

    normals: (h, 3 w), found. pairs: of `_pairs_of_lights`.
    """
    for v in prange(len(mask)):
        error[v, :] = np.float32(0.0)
        weight[v, :] = np.float32(0.0)
        first, last = span_of(mask[v])
        if first == last:
            continue
        count = last - first
        r, g, b = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
        length, unlit = np.empty(count, np.float32), np.zeros(count, np.float32)
        row_turns = np.empty(count, np.float32)
        evidence_row(turns, np.int64(v), first, row_turns)
        read_row(rgb[v, 3 * first : 3 * last], None, r, g, b)
        if labels is not None:
            found = normals[v, 3 * first : 3 * last]
            _unlit_row(r, g, b, found, labels[v, first:last], pairs, constants, unlit)
        at = brightness_at(mask.shape, constants[13:], first, v)
        _bound_row(
            r, g, b, unlit, row_turns, mask[v, first:last], constants, at, length, error[v, first:last],
            weight[v, first:last],
        )  # fmt: skip


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _unlit_row(
    r: Any, g: Any, b: Any, normals: Any, label: Any, pairs: Any, k: Any, unlit: Any
) -> None:  # fmt: skip
    """Fill the squared bounds of a row of pixels that not all lights reach, 0 of the others."""
    zero, one, two = np.float32(0.0), np.float32(1.0), np.float32(2.0)
    for u in range(len(label)):
        if label[u] == ALL_LIT:
            unlit[u] = zero
            continue
        pair = pairs[label[u]]
        a0, a1, a2, l0, l1, l2 = pair[0], pair[1], pair[2], pair[3], pair[4], pair[5]
        if l0 * l0 + l1 * l1 + l2 * l2 == zero:
            unlit[u] = _LARGEST_DEG * _LARGEST_DEG
            continue
        n0, n1, n2 = normals[3 * u], normals[3 * u + 1], normals[3 * u + 2]
        red, green, blue, scale = r[u] - k[9], g[u] - k[10], b[u] - k[11], k[13]
        # M⁻¹(r − a) says in the plane of the two lights what the normal is, and nothing across it
        x = scale * (k[0] * red + k[1] * green + k[2] * blue)
        y = scale * (k[3] * red + k[4] * green + k[5] * blue)
        z = scale * (k[6] * red + k[7] * green + k[8] * blue)
        across = x * a0 + y * a1 + z * a2
        x, y, z = x - across * a0, y - across * a1, z - across * a2
        off = n0 * a0 + n1 * a1 + n2 * a2
        plane = x * x + y * y + z * z
        moved = plane + plane * plane / (abs(one - plane) + two * _ALBEDO_SPREAD * plane + SHORTEST)
        height = np.sqrt(max(one - plane, zero))
        height = height if off > zero else -height
        x, y, z = x + height * a0, y + height * a1, z + height * a2
        size = max(np.sqrt(x * x + y * y + z * z), SHORTEST)
        x, y, z = x / size, y / size, z / size
        squared = (x - n0) * (x - n0) + (y - n1) * (y - n1) + (z - n2) * (z - n2)
        behind = (x * l0 + y * l1 + z * l2 < zero) & (n0 * l0 + n1 * l1 + n2 * l2 < zero)
        if not behind and n2 - (off + off) * a2 < zero:  # the other normal faces the camera
            squared += np.float32(4.0) * off * off
        known = squared < np.float32(8.0)  # no NaN
        bound = _PER_DISTANCE * squared + _PER_NOISE * _ALBEDO_SPREAD * _ALBEDO_SPREAD * moved
        unlit[u] = max(bound, SHORTEST) if known else _LARGEST_DEG * _LARGEST_DEG


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _normals_and_errors_kernel(
    encoded: Any, table: Any, maps: Any, mask: Mask, turns: Any, constants: Any, limits: Any, out: Any
) -> None:
    """Fill normals (h, w, 3), valid, the bound in degrees and its weight (h, w), and clipped pixels a row."""
    height, width = mask.shape
    normals, valid, error, weight, clipped = out  # numba drops stores through a tuple's field inside prange
    darkest, clipped_factor, white, zero = limits[0], limits[1], limits[2], np.float32(0.0)
    for v in prange(height):
        r, g, b = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        length, row_turns = np.empty(width, np.float32), np.empty(width, np.float32)
        unlit, good = np.zeros(width, np.float32), np.empty(width, np.bool_)
        evidence_row(turns, np.int64(v), 0, row_turns)
        read_row(encoded[v], table, r, g, b)
        count = 0
        for u in range(width):
            largest = max(r[u], g[u])
            top = max(largest, b[u]) >= white
            count += top
            good[u] = mask[v, u] & ((not top) | (clipped_factor > zero))
        clipped[v] = count
        if maps is not None:
            map_row(maps, np.int64(v), 0, r, g, b)
        at = brightness_at(mask.shape, constants[13:], 0, v)
        _bound_row(r, g, b, unlit, row_turns, good, constants, at, length, error[v], weight[v])
        to_error, to_weight, to_valid, to_normals = error[v], weight[v], valid[v], normals[v]
        for u in range(width):
            kept = good[u] & (length[u] > darkest) & (length[u] < LONGEST) & (b[u] < zero)
            to_valid[u] = kept
            to_error[u] = to_error[u] if kept else zero
            to_weight[u] = to_weight[u] if kept else zero
            r[u], g[u], b[u] = r[u] if kept else zero, g[u] if kept else zero, b[u] if kept else zero
        for u in range(width):
            to_normals[3 * u] = r[u]
            to_normals[3 * u + 1] = g[u]
            to_normals[3 * u + 2] = b[u]

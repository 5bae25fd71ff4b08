"""How far off is each normal? The angle that nine of ten normals stay within, from the footage itself.

Independent errors add up in squares. `frame_evidence` measures four of them: noise, relief that blur took, an
error of M, near lamps. Beside them

- normals that were solved together with a surface have less noise than the colours' own. The noise left out
  and the noise kept are uncorrelated: the mean squared distance between the two normals is the former;
- the rotation in M⁻¹ΔM leaves no trace; its size is taken to be E's, the symmetric part's;
- the rig's own residual is what its calibration could not explain. That of a ball's pixels holds the noise of
  the calibration, too, which would count twice: as much as this footage has is taken away;
- what departs from the ellipsoid, at a pixel or in its cell on average, the larger of the two, is relief
  finer than pixels, another paint, gloss, saturation, or light from elsewhere;
- where a light is missing the normal rests on its surroundings. Two lights leave two normals, mirror images
  across the plane of the two. The distance from the found normal to the nearer of them counts. So does the
  distance to the other one, which may be the right one, unless found and nearer one both face away from the
  missing light: that explains the shadow. Both hang on the albedo, which the surroundings tell: with it they
  move in the plane of the two lights, and across it the more, the nearer to it they lie;
- one light or none tells next to nothing: the true normal may be any that faces the camera. The bound is the
  angle to nine tenths of those, as the picture of a sphere shows them: the larger, the more the normal leans.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from vntoolkit.arrays import ByteArray, Float32Array, Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, NormalMap
from vntoolkit.native import njit
from vntoolkit.normals.frame_evidence import (
    LEAST_FACING,
    LONGEST,
    SHORTEST,
    RigModel,
    evidence_of_frame,
    evidence_row,
    model_of_rig,
    slow_changes_at,
)
from vntoolkit.normals.inversion import (
    read_row,
    rows_of,
)
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import span_of
from vntoolkit.photometry.response import LightResponse
from vntoolkit.spread import NINE_OF_TEN_IN_PLANE

OF_ANGLE = NINE_OF_TEN_IN_PLANE / math.sqrt(2.0)  # over the root of the angles' mean square
# Where all nine entries of M⁻¹ΔM have variance 1, the rotation in it has 1/2 about every axis.
_OF_ROTATION = NINE_OF_TEN_IN_PLANE / math.sqrt(2.0)
# The bounds of nine of ten pixels over each measured error, fitted on simulated scenes.
_OF_ELLIPSOID = 2.5
_OF_RESIDUAL = 1.1  # of a median
_OF_LENGTH = 2.75  # radians over log length
_OF_LENGTHS = _OF_LENGTH / 2.0  # the same, over the root of the mean square in a cell
_OF_TWO_LIGHTS = 1.2  # radians over the distances to the normals that two lights leave
_ALBEDO_SPREAD = np.float32(0.03)  # relative standard deviation of lit pixels' albedo about the surroundings'
# Nine tenths of a sphere's image lie within this angle of a normal: at grazing incidence, less so much per
# cosine and so much per squared cosine; to two degrees. It is 71.6 for a normal that faces the camera.
_UNKNOWN = np.array([133.0, 35.0, 26.4], np.float32)
_LARGEST_DEG = np.float32(_UNKNOWN[0] - _UNKNOWN[1] - _UNKNOWN[2])
_LEFT_OUT_PX = 16  # in a row, over which the noise that a surface leaves out is averaged, …
_KEPT = np.float32(1 / 8)  # … which is not all of it

# The same, as the loops need it: squared, in degrees.
_PER_NOISE = np.float32(np.degrees(NINE_OF_TEN_IN_PLANE) ** 2)
_PER_TURN = np.float32(np.degrees(_OF_ELLIPSOID) ** 2)
_PER_NEARNESS = np.float32(np.degrees(OF_ANGLE) ** 2)
_PER_MISFIT = np.float32(np.degrees(_OF_LENGTH) ** 2)
_PER_MISFITS = np.float32(np.degrees(_OF_LENGTHS) ** 2)
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
    image, clipped = np.ascontiguousarray(frame.rgb), np.ascontiguousarray(frame.clipped)
    mask = np.ascontiguousarray(normal_map.mask)
    c = model_of_rig(response, camera)
    evidence = evidence_of_frame(image, clipped, mask, labels, c, blur_px)
    noise_deg, noise, constants = _judged(evidence, c, residual_deg, residual_of_pixels)
    error, weight = np.empty(shape, np.float32), np.empty(shape, np.float32)
    found = rows_of(np.ascontiguousarray(normal_map.normals_in_camera, np.float32))
    # The bound of nine in ten holds the mirror image whole from a probability of 1/10 on.
    mirror = normal_map.mirror_probability
    other = np.ones(shape, np.float32) if mirror is None else np.minimum(10 * mirror, 1).astype(np.float32)
    _error_kernel(
        rows_of(image), found, mask, labels, other, _pairs_of_lights(response), noise, constants, error,
        weight,
    )  # fmt: skip
    return replace(normal_map, error_deg=error, noise_deg=noise_deg, weight=weight)


def with_added_error(normal_map: NormalMap, added_deg: Float32Array) -> NormalMap:
    """Return the map with a further, independent error (h, w) in degrees, and the weight from both."""
    assert normal_map.error_deg is not None
    error, weight = np.empty((2, *normal_map.mask.shape), np.float32)
    _add_error(normal_map.error_deg, added_deg, normal_map.mask, error, weight)
    return replace(normal_map, error_deg=error, weight=weight)


def errors_of_materials(
    numbers: ByteArray, bounds_deg: Float32Array, turned_deg: Float32Array | None
) -> Float32Array:
    """Return (h, w), degrees: the bound (m,) of each pixel's material, and a further, independent error.

    numbers: (h, w), of the materials. turned_deg: (h, w), None for 0.
    """
    errors = np.empty(numbers.shape, np.float32)
    _fill_errors(
        numbers, bounds_deg, np.zeros((1, 1), np.float32) if turned_deg is None else turned_deg, errors
    )
    return errors


@njit
def _add_error(stated: Any, added: Any, mask: Any, error: Any, weight: Any) -> None:
    for v in range(len(mask)):
        for u in range(mask.shape[1]):
            e = min(np.sqrt(stated[v, u] * stated[v, u] + added[v, u] * added[v, u]), _LARGEST_DEG)
            e = max(e, stated[v, u])  # of one light or none
            half = e * _PER_HALF_WEIGHT
            error[v, u] = e if mask[v, u] else np.float32(0.0)
            weight[v, u] = (
                np.float32(1.0) / (np.float32(1.0) + half * half) if mask[v, u] else np.float32(0.0)
            )


@njit
def _fill_errors(numbers: Any, bounds: Any, turned: Any, out: Any) -> None:
    """turned: (1, 1) where it is 0 everywhere."""
    is_turned = turned.size > 1
    for v in range(len(numbers)):
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


def _judged(
    evidence: tuple[Any, Any, Any, Any], c: RigModel, residual_deg: float, of_pixels: bool
) -> tuple[Any, Any, Any]:
    """Return the noise by cells, in degrees as the bounds are, what `evidence_row` reads, and constants.

    evidence: of `evidence_of_frame`. Constants, (47,): M⁻¹, the ambient light, the squared bound that all
    pixels share, noise along a normal over that across it, and the ellipsoid.
    """
    noise, seen, rows, ellipsoid = evidence
    residual = (_OF_RESIDUAL * max(residual_deg, 0.0)) ** 2
    if of_pixels and seen.any():
        residual = max(residual - float(_PER_NOISE * np.median(noise[seen > 0])), 0.0)
    fixed = residual + (np.degrees(_OF_ROTATION) * ellipsoid[32]) ** 2
    constants = np.concatenate([c.inverse.ravel(), c.ambient, (fixed, c.along), ellipsoid])
    return np.sqrt(_PER_NOISE * noise), rows, constants.astype(np.float32)


# Compiled loops. Rows are flat slices, whose loops begin at 0: only such loops are done eight pixels at a
# time.


@njit
def _bound_row(
    r: Any, g: Any, b: Any, found: Any, unlit: Any, rows: Any, inside: Any, k: Any, m: Any, length: Any,
    bound: Any, weight: Any,
) -> None:  # fmt: skip
    """Turn a row of colours into unit normals, in place, and fill their length, their bound and its weight.

    found: the normals to judge, or None for these. unlit: squared bound of pixels that not all lights reach,
    else 0. m: slow changes at the first pixel.
    """
    noise, lost, around_cell = rows[0], rows[1], rows[2]
    zero, half, one, eight = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(8.0)
    i00, i01, i02, i10, i11, i12, i20, i21, i22 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8]
    a0, a1, a2 = k[9], k[10], k[11]
    fixed, along_noise, inverse_albedo = k[12], k[13], k[14]
    e00, e01, e02, e11, e12, e22 = k[15], k[16], k[17], k[18], k[19], k[20]
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    f0, f1, f2, told = m[9], m[10], k[42], k[45]
    largest = _LARGEST_DEG * _LARGEST_DEG
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = k[21], k[22], k[23], k[24], k[25], k[26], k[27], k[28], k[29]
    count = len(r)
    misfits, rest = np.empty(count, np.float32), np.empty(count, np.float32)
    for u in range(count):  # without a branch: eight pixels at a time
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
        at = np.float32(u)
        n0 = (m0 + at * s0) * x + (m1 + at * s1) * y + (m2 + at * s2) * z
        n1 = (m3 + at * s3) * x + (m4 + at * s4) * y + (m5 + at * s5) * z
        n2 = (m6 + at * s6) * x + (m7 + at * s7) * y + (m8 + at * s8) * z
        longer = n0 * x + n1 * y + n2 * z
        near = max(n0 * n0 + n1 * n1 + n2 * n2 - longer * longer, zero)
        foretold = max(one + along + longer + f0 + at * (f1 + at * f2), LEAST_FACING)
        measured = max(size * inverse_albedo, SHORTEST)
        misfit = abs(measured * measured - foretold * foretold) / (measured * foretold) * half
        misfit = min(misfit, one)  # sinh of the log length
        misfits[u] = misfit * misfit if seen else zero
        rest[u] = fixed + _PER_TURN * told * turn + _PER_NEARNESS * near + _PER_NOISE * (noise[u] + lost[u])
        r[u], g[u], b[u], length[u] = x, y, z, size
    if found is not None:
        _leave_out(r, g, b, found, unlit, noise, inside, rest)
    for u in range(count):
        # Noise across the axis has one variance, along it `along_noise` times that. A normal that leans away
        # by t is turned by (1 + cos² t + along sin² t) / 2 of it, its length by sin² t + along cos² t, and
        # rarely by more than two standard deviations.
        facing = b[u] * b[u]
        leaning = one - facing
        of_turn = eight * noise[u] / (one + facing + along_noise * leaning)
        own = misfits[u] - of_turn * (leaning + along_noise * facing)
        own = max(_PER_MISFIT * own if unlit[u] == zero else zero, _PER_MISFITS * around_cell[u])
        total = rest[u] + own + unlit[u] if length[u] > SHORTEST else largest
        angle = np.sqrt(max(min(total, largest), unlit[u]))
        share = angle * _PER_HALF_WEIGHT
        bound[u] = angle if inside[u] else zero
        weight[u] = one / (one + share * share) if inside[u] else zero


@njit
def _leave_out(
    r: Any, g: Any, b: Any, found: Any, unlit: Any, noise: Any, inside: Any, rest: Any
) -> None:  # fmt: skip
    """Take from a row of squared bounds the noise of the colours' normals that those found do not have."""
    count, zero, four = len(r), np.float32(0.0), np.float32(4.0)
    reach = _LEFT_OUT_PX // 2
    apart = np.zeros(count + _LEFT_OUT_PX, np.float32)
    x, y, z = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    read_row(found, x, y, z)
    for u in range(count):
        square = (r[u] - x[u]) ** 2 + (g[u] - y[u]) ** 2 + (b[u] - z[u]) ** 2
        # in two directions; what is farther off is no noise
        square = min(square, four * noise[u])
        apart[u + reach] = square if inside[u] & (unlit[u] == zero) else zero
    step = 1
    while step < _LEFT_OUT_PX:  # sums of 2, 4, 8, 16
        ahead = apart[step:]
        sums = np.empty(len(ahead), np.float32)
        for u in range(len(sums)):
            sums[u] = apart[u] + ahead[u]
        apart, step = sums, 2 * step
    share, kept = np.float32(0.5 / _LEFT_OUT_PX), np.float32(1.0) - _KEPT
    for u in range(count):
        left_out = min(share * apart[u], kept * noise[u])
        rest[u] -= _PER_NOISE * left_out if unlit[u] == zero else zero


@njit
def _error_kernel(
    rgb: Any, normals: Any, mask: Mask, labels: Any, other: Any, pairs: Any, noise: Any, constants: Any,
    error: Any, weight: Any,
) -> None:  # fmt: skip
    """Fill (h, w) with the bound in degrees and its weight; 0 outside the mask.

    normals: (h, 3 w), found. other: (h, w), share of the squared distance to the mirror image that counts.
    pairs: of `_pairs_of_lights`.
    """
    for v in range(len(mask)):
        error[v, :] = np.float32(0.0)
        weight[v, :] = np.float32(0.0)
        first, last = span_of(mask[v])
        if first == last:
            continue
        count = last - first
        r, g, b = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
        length, unlit = np.empty(count, np.float32), np.zeros(count, np.float32)
        row_noise = np.empty((3, count), np.float32)
        evidence_row(noise, v, first, row_noise)
        read_row(rgb[v, 3 * first : 3 * last], r, g, b)
        found = None if labels is None else normals[v, 3 * first : 3 * last]
        if labels is not None:
            label, of_other = labels[v, first:last], other[v, first:last]
            _unlit_row(r, g, b, found, label, of_other, pairs, constants, unlit)
        _bound_row(
            r, g, b, found, unlit, row_noise, mask[v, first:last], constants,
            slow_changes_at(mask.shape, constants, first, v), length, error[v, first:last],
            weight[v, first:last],
        )  # fmt: skip


@njit
def _unlit_row(
    r: Any, g: Any, b: Any, normals: Any, label: Any, other: Any, pairs: Any, k: Any, unlit: Any
) -> None:  # fmt: skip
    """Fill the squared bounds of a row of pixels that not all lights reach, 0 of the others."""
    zero, one, two = np.float32(0.0), np.float32(1.0), np.float32(2.0)
    for u in range(len(label)):
        if label[u] == ALL_LIT:
            unlit[u] = zero
            continue
        n2 = normals[3 * u + 2]
        unknown = (_UNKNOWN[0] + _UNKNOWN[1] * n2 - _UNKNOWN[2] * n2 * n2) ** 2
        pair = pairs[label[u]]
        a0, a1, a2, l0, l1, l2 = pair[0], pair[1], pair[2], pair[3], pair[4], pair[5]
        if l0 * l0 + l1 * l1 + l2 * l2 == zero:
            unlit[u] = unknown
            continue
        n0, n1 = normals[3 * u], normals[3 * u + 1]
        red, green, blue, scale = r[u] - k[9], g[u] - k[10], b[u] - k[11], k[14]
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
            squared += other[u] * np.float32(4.0) * off * off
        known = squared < np.float32(8.0)  # no NaN
        bound = _PER_DISTANCE * squared + _PER_NOISE * _ALBEDO_SPREAD * _ALBEDO_SPREAD * moved
        unlit[u] = min(max(bound, SHORTEST), _LARGEST_DEG * _LARGEST_DEG) if known else unknown

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
  move in the plane of the two lights, and across it the more, the nearer to it they lie. One light leaves a
  cone of normals, which tells next to nothing.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numba import prange
from scipy import ndimage

from vntoolkit.arrays import ByteArray, Float32Array, FloatArray, Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, NOISE_CELL_PX, NormalMap
from vntoolkit.native import njit
from vntoolkit.normals.frame_evidence import LEAST_FACING, LONGEST, SHORTEST, at_rows, evidence_of_frame
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import FLAGS, span_of
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb

# Nine of ten angles of a two-dimensional normal distribution lie within √(2 ln 10) standard deviations.
NINE_OF_TEN = 2.146
# … and within 1.5 times the root of their mean square. So of the rotation in M⁻¹ΔM, too: where all nine
# entries have variance 1, it has 1/2 about every axis.
OF_ANGLE = NINE_OF_TEN / math.sqrt(2.0)
# The bounds of nine of ten pixels over each measured error, fitted on simulated scenes.
_OF_ELLIPSOID = 2.5
_OF_RESIDUAL = 1.1  # of a median
_OF_LENGTH = 2.75  # radians over log length; half of it over the root of the mean square in a cell
_OF_TWO_LIGHTS = 1.2  # radians over the distances to the normals that two lights leave
_ALBEDO_SPREAD = np.float32(0.03)  # relative standard deviation of lit pixels' albedo about the surroundings'
# A sphere shows nine tenths of its image within this angle of the axis: what a guess without data is worth.
_LARGEST_DEG = np.float32(71.6)
_LEFT_OUT_PX = 16  # in a row, over which the noise that a surface leaves out is averaged, …
_KEPT = np.float32(1 / 8)  # … which is not all of it


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
    mask, central = normal_map.mask, response.central
    noise, seen, evidence, ellipsoid = evidence_of_frame(frame, mask, labels, central, camera, blur_px)
    residual = np.radians(_OF_RESIDUAL * max(residual_deg, 0.0)) ** 2
    if residual_of_pixels and seen.any():
        residual = max(residual - NINE_OF_TEN**2 * float(np.median(noise[seen > 0])), 0.0)
    fixed = residual + (OF_ANGLE * ellipsoid[32]) ** 2
    unlit, left_out = np.zeros((2, *shape), np.float32)
    if labels is not None:
        unlit = _unlit(frame, normal_map, labels, central, ellipsoid[0])
        left_out = _left_out(frame, normal_map, mask & (labels == ALL_LIT), central, evidence[0])
    spread = central.inverse @ central.inverse.T  # of equal noise in all channels
    along = 2.0 * spread[2, 2] / max(float(np.trace(spread) - spread[2, 2]), 1e-12)
    constants = np.concatenate([central.inverse.ravel(), central.ambient, (fixed, along), ellipsoid])
    error, weight = np.zeros((2, *shape), np.float32)
    _error_kernel(
        np.ascontiguousarray(frame.rgb).reshape(shape[0], -1), np.ascontiguousarray(mask), evidence, unlit,
        left_out, constants.astype(np.float32), _slow_changes(shape, ellipsoid), error, weight,
    )  # fmt: skip
    noise_deg = np.degrees(NINE_OF_TEN * np.sqrt(noise))
    return replace(normal_map, error_deg=error, noise_deg=noise_deg, weight=weight)


def with_doubt(normal_map: NormalMap, doubt_deg: Float32Array) -> NormalMap:
    """Return the map with a further, independent error (h, w) in degrees, and the weight from both."""
    assert normal_map.error_deg is not None
    error = np.minimum(np.hypot(normal_map.error_deg, doubt_deg), _LARGEST_DEG) * normal_map.mask
    weight = normal_map.mask / (1.0 + (error / HALF_WEIGHT_DEG) ** 2)
    return replace(normal_map, error_deg=error, weight=np.asarray(weight, np.float32))


def doubts_of_materials(
    numbers: ByteArray, bounds_deg: Float32Array, turned_deg: Float32Array | None
) -> Float32Array:
    """Return (h, w), degrees: the bound (m,) of each pixel's material, and a further, independent doubt.

    numbers: (h, w), of the materials. turned_deg: (h, w), None for 0.
    """
    bounds = bounds_deg[numbers]
    return bounds if turned_deg is None else np.hypot(bounds, turned_deg)


def _pairs_of_lights(response: LightResponse) -> Float32Array:
    """Return (8, 6): for labels of two lights the normal of the plane of both and the third's direction."""
    pairs = np.zeros((8, 6))
    for missing in range(3):
        one, other = np.delete(response.light_directions, missing, axis=0)
        across = np.cross(one, other)
        pairs[ALL_LIT - (1 << missing), :3] = across / max(float(np.linalg.norm(across)), 1e-12)
        pairs[ALL_LIT - (1 << missing), 3:] = response.light_directions[missing]
    return pairs.astype(np.float32)


def _unlit(
    frame: LinearFrame, found: NormalMap, labels: VisibilityLabels, response: LightResponse, scale: float
) -> Float32Array:
    """(h, w) squared bounds, radians², of pixels that not all lights reach, 0 of the others.

    scale: 1 over the albedo.
    """
    pairs = _pairs_of_lights(response)
    largest = np.radians(_LARGEST_DEG) ** 2
    bound = np.where(labels == ALL_LIT, np.float32(0), largest)
    two: Mask = found.mask & np.asarray(pairs.any(axis=1))[labels]
    across, missing = np.hsplit(pairs[labels[two]], 2)
    normals = found.normals_in_camera[two]
    # M⁻¹(r − a) says in the plane of the two lights what the normal is, and nothing across it
    seen = np.float32(scale) * scaled_normals_from_rgb(frame.rgb[two], response)
    seen -= _dot(seen, across)[:, None] * across
    off, plane = _dot(normals, across), _dot(seen, seen)
    moved = plane + plane**2 / (np.abs(1 - plane) + 2 * _ALBEDO_SPREAD * plane + SHORTEST)
    height = np.where(off > 0, 1, -1) * np.sqrt(np.maximum(1 - plane, 0))
    seen += height[:, None] * across
    seen /= np.maximum(np.linalg.norm(seen, axis=1, keepdims=True), SHORTEST)
    squared = np.square(seen - normals).sum(axis=1)
    behind = (_dot(seen, missing) < 0) & (_dot(normals, missing) < 0)
    other_faces = normals[:, 2] - 2 * off * across[:, 2] < 0  # the camera
    squared += np.where(~behind & other_faces, 4 * off**2, 0)
    known = squared < 8  # no NaN
    square = _OF_TWO_LIGHTS**2 * squared + (NINE_OF_TEN * _ALBEDO_SPREAD) ** 2 * moved
    bound[two] = np.where(known, np.maximum(square, SHORTEST), largest)
    return bound


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.sum(a * b, axis=-1))


def _left_out(
    frame: LinearFrame, found: NormalMap, lit: Mask, response: LightResponse, noise: Float32Array
) -> Float32Array:
    """(h, w) variance, radians², of the colours' own normals that those found do not have; 0 beside `lit`.

    noise: (rows of cells, w), of the colours' own.
    """
    own, normals = scaled_normals_from_rgb(frame.rgb, response), found.normals_in_camera
    length = np.maximum(np.sqrt(np.einsum("vui,vui->vu", own, own)), SHORTEST)
    usual = at_rows(noise, len(lit))
    square = 2 - 2 * np.einsum("vui,vui->vu", own, normals) / length  # of two unit vectors' difference
    square = np.minimum(square, 4 * usual)  # what is farther off is no noise
    mean = ndimage.uniform_filter1d(lit * square, _LEFT_OUT_PX, axis=1, mode="constant")
    return np.where(lit, np.minimum(0.5 * mean, (1 - _KEPT) * usual), np.float32(0))  # in two directions


def _slow_changes(shape: tuple[int, int], ellipsoid: FloatArray) -> Float32Array:
    """(h, 11): M⁻¹ΔM of near lamps at the first pixel of a row, f of `fit_ellipsoid`, its slope along u."""
    right, down = -0.5 * (shape[1] - 1), np.arange(shape[0])[:, None] - 0.5 * (shape[0] - 1)
    near = right * ellipsoid[7:16] + down * ellipsoid[16:25]
    f = ellipsoid[25:31]
    falloff = f[0] + f[1] * right + f[2] * down + f[3] * right**2 + f[4] * down**2 + f[5] * right * down
    return np.hstack([near, falloff, f[1] + 2.0 * f[3] * right + f[5] * down]).astype(np.float32)


# Compiled loops. Rows are flat slices, whose loops begin at 0: such loops are done eight pixels at a time.


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _bound_row(
    line: Any, unlit: Any, left_out: Any, rows: Any, inside: Any, k: Any, m: Any, bound: Any, weight: Any
) -> None:  # fmt: skip
    """Fill a row of bounds and their weights from colours (3 w,).

    unlit: squared bound of pixels that not all lights reach, else 0. left_out: variance that their normals do
    not have. rows: noise, lost relief, departures of the cell. k: constants. m: slow changes at the first
    pixel.
    """
    noise, lost, around_cell = rows[0], rows[1], rows[2]
    of_noise, of_angle = np.float32(NINE_OF_TEN**2), np.float32(OF_ANGLE**2)
    of_turn, of_length = np.float32(_OF_ELLIPSOID**2), np.float32(_OF_LENGTH**2)
    of_lengths, degrees = np.float32(_OF_LENGTH**2 / 4), np.float32(180.0 / np.pi)
    half_weight = np.float32(1.0 / HALF_WEIGHT_DEG)
    zero, half, one, eight = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(8.0)
    i00, i01, i02, i10, i11, i12, i20, i21, i22 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8]
    a0, a1, a2 = k[9], k[10], k[11]
    fixed, along_noise, inverse_albedo = k[12], k[13], k[14]
    e00, e01, e02, e11, e12, e22 = k[15], k[16], k[17], k[18], k[19], k[20]
    m0, m1, m2, m3, m4, m5, m6, m7, m8 = m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8]
    f0, f1, f2, told = m[9], m[10], k[42], k[45]
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = k[21], k[22], k[23], k[24], k[25], k[26], k[27], k[28], k[29]
    count = len(bound)
    departures, rest = np.empty(count, np.float32), np.empty(count, np.float32)
    facing_square, length = np.empty(count, np.float32), np.empty(count, np.float32)
    for u in range(count):  # without a branch: eight pixels at a time
        red, green, blue = line[3 * u] - a0, line[3 * u + 1] - a1, line[3 * u + 2] - a2
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
        departure = abs(measured * measured - foretold * foretold) / (measured * foretold) * half
        departure = min(departure, one)  # sinh of the log length
        departures[u] = departure * departure if seen else zero
        rest[u] = (
            fixed + of_turn * told * turn + of_angle * near + of_noise * (noise[u] - left_out[u] + lost[u])
        )
        facing_square[u], length[u] = z * z, size
    for u in range(count):
        # Noise across the axis has one variance, along it `along_noise` times that. A normal that leans away
        # by t is turned by (1 + cos² t + along sin² t) / 2 of it, its length by sin² t + along cos² t, and
        # rarely by more than two standard deviations.
        facing = facing_square[u]
        leaning = one - facing
        of_turn = eight * noise[u] / (one + facing + along_noise * leaning)
        own = departures[u] - of_turn * (leaning + along_noise * facing)
        own = max(of_length * own if unlit[u] == zero else zero, of_lengths * around_cell[u])
        total = rest[u] + own + unlit[u]
        angle = min(degrees * np.sqrt(total), _LARGEST_DEG) if length[u] > SHORTEST else _LARGEST_DEG
        share = angle * half_weight
        bound[u] = angle if inside[u] else zero
        weight[u] = one / (one + share * share) if inside[u] else zero


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _error_kernel(
    rgb: Any, mask: Mask, evidence: Any, unlit: Any, left_out: Any, constants: Any, changes: Any, error: Any,
    weight: Any,
) -> None:  # fmt: skip
    """Fill (h, w) with the bound in degrees and its weight, zeros outside the mask; rgb: (h, 3 w)."""
    cell, half, zero, two = np.float32(NOISE_CELL_PX), np.float32(0.5), np.float32(0.0), np.float32(2.0)
    lowest = evidence.shape[1] - 1
    for v in prange(len(mask)):
        first, last = span_of(mask[v])
        if first == last:
            continue
        y = max((np.float32(v) + half) / cell - half, zero)
        up = min(int(y), lowest)
        share, rows = y - np.float32(up), np.empty((3, last - first), np.float32)
        for k in range(3):
            above, below, to = evidence[k, up, first:], evidence[k, min(up + 1, lowest), first:], rows[k]
            for u in range(len(to)):
                to[u] = (np.float32(1.0) - share) * above[u] + share * below[u]
        here, at = changes[v].copy(), np.float32(first)
        for i in range(9):
            here[i] += at * constants[21 + i]
        here[9] += at * (here[10] + at * constants[42])
        here[10] += two * at * constants[42]
        _bound_row(
            rgb[v, 3 * first : 3 * last], unlit[v, first:last], left_out[v, first:last], rows,
            mask[v, first:last], constants, here, error[v, first:last], weight[v, first:last],
        )  # fmt: skip

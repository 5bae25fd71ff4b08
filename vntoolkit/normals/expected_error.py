"""How far off is each normal? The angle that nine of ten normals stay within, from the footage itself.

Seven independent errors add up in squares. Each is measured where it shows:

- noise of every kind (shot, read, quantisation, codec) turns normals at random. A surface's slopes (p, q)
  add up to 0 around a square, p along the rows and q along the columns; noise does not. Squares of 4 pixels
  show a codec's noise, too, which is alike over several pixels.
  Pixels at the subject's edge mix it with what lies behind: they tell nothing of those farther in;
- normals that were solved together with a surface have less noise than the colours' own. The noise left out
  and the noise kept are uncorrelated: the mean squared distance between the two normals is the former;
- an error ΔM of the rig or of the material's colour moves M⁻¹r from the unit sphere onto an ellipsoid,
  |M⁻¹r| ≈ 1 + nᵀE n with E the symmetric part of M⁻¹ΔM. The ellipsoid that fits the frame tells E, and E the
  turn of every normal, but for the rotation in M⁻¹ΔM, which leaves no trace. Its size is taken to be E's.
  Of E's squares those are taken away that a fit to so few independent samples has where E is 0;
- under near lamps M is right at the picture's centre only. A lamp in the direction l at the distance d has at
  a place δ beside the centre, to first order, the direction times strength l + (3 l (l·δ) − δ) / d. That
  changes the length of M⁻¹r with the place and the direction, which tells d of each lamp;
- blur averages relief away: of a lens, of motion, of colours that were interpolated. What it has left of
  relief as wide as itself foretells what is lost;
- the rig's own residual is what its calibration could not explain. That of a ball's pixels holds the noise of
  the calibration, too, which would count twice: as much as this footage has is taken away;
- what departs from the ellipsoid at a pixel, beside it, or in its cell on average, the largest of the three,
  is relief finer than pixels, another paint, gloss, saturation, or light from elsewhere;
- where a light is missing the normal rests on its surroundings. Two lights leave two normals, mirror images
  across the plane of the two. The distance from the found normal to the nearer of them counts. So does the
  distance to the other one, which may be the right one, unless found and nearer one both face away from the
  missing light: that explains the shadow. One light leaves a cone of normals, which tells next to nothing.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import Mask, VisibilityLabels
from vntoolkit.checks import require_shape
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NOISE_CELL_PX, NormalMap
from vntoolkit.native import njit
from vntoolkit.normals.inversion import (
    InversionOptions,
    coefficients_from_response,
    decoding_of,
    read_row,
    require_encoded,
    require_mask_or_all,
    rows_of,
)
from vntoolkit.normals.lost_detail import LEAST_BLUR_PX, detail_kernel, lost_over_left, side_of_squares
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.levelling import FLAGS, leveller_of, map_row
from vntoolkit.photometry.near_lamps import changes_of_near_lamps
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.transfer import Transfer

# Nine of ten angles of a two-dimensional normal distribution lie within √(2 ln 10) standard deviations.
NINE_OF_TEN = 2.146
_OF_NEARNESS = NINE_OF_TEN / math.sqrt(2.0)  # of a length in two dimensions
# Over the root of the sum of E's squared entries: where all nine entries of M⁻¹ΔM are equally uncertain, the
# variance of the rotation about an axis is a tenth of that sum.
_OF_ROTATION = NINE_OF_TEN / math.sqrt(10.0)
# The bounds of nine of ten pixels over each measured error, fitted on simulated scenes.
_OF_ELLIPSOID = 2.5
_OF_RESIDUAL = 1.1  # of a median
_OF_LENGTH = 2.75  # radians over log length
_OF_LENGTHS = _OF_LENGTH / 2.0  # the same, over the root of the mean square in a cell
_OF_TWO_LIGHTS = 1.2  # radians over the distances to the normals that two lights leave
# A sphere shows nine tenths of its image within this angle of the axis: what a guess without data is worth.
_LARGEST_DEG = np.float32(71.6)
_HALF_WEIGHT_DEG = 12.0
_CELL = NOISE_CELL_PX  # noise changes slowly: one row of every cell tells it
_WIDER = 2  # cells around one that are asked where its neighbours know nothing
_EDGE_PX = 4  # from the subject's edge, which blur and subsampled chroma mix with what lies behind …
_EDGE_SHARE = np.float32(1e-4)  # … a pixel tells of noise only where none farther in does
_BESIDE_PX = 2  # to either side: one departure is a poor sample of how far normals depart there
_LEFT_OUT_PX = 16  # in a row, over which the noise that a surface leaves out is averaged, …
_KEPT = np.float32(1 / 8)  # … which is not all of it
_LEAST_FACING = np.float32(0.1)
_LOOP_PX = 2  # half a side of the squares: a codec's noise is alike over 4 pixels, its smallest blocks
# Noise of variance 1 adds up to 4 (1/4 + 3 + 1/4) around a square: the pixels at its corners count half.
_PER_CIRCULATION = np.float32(1.0 / math.sqrt(14.0))
# Standard deviations over a cell's median departure, of white noise. That of 16 squares that overlap, from
# the mean of the medians of 3×3 cells, is 1.138 times that of many that do not, both squared.
_PER_MEDIAN = np.float32(1.4826 / math.sqrt(1.138))
_LEAST_LIGHT, _GRID_PIXELS = 0.3, 4000  # of the length that a fiftieth exceeds, over a grid of pixels
_SAMPLES, _NEAR_PIXELS = 1000, 9
_MOST_PER_KNOWN = 20  # places of the grid that are looked at for a sample
_ROUNDS = 4
_GRID = 2.0**-16  # of log lengths that are fitted: finer than any bound, far coarser than their rounding
_ELLIPSOID_SPREAD = 0.05  # prior standard deviation of E's entries …
_FALLOFF_SPREAD = 0.1  # … of the slow change of brightness over the image …
_NEARNESS_SPREAD = 0.3  # … and of half the picture's larger side over a lamp's distance
_TERMS = 14
_PRIOR = np.repeat([0.0, _ELLIPSOID_SPREAD**-2, _FALLOFF_SPREAD**-2, _NEARNESS_SPREAD**-2], [1, 5, 5, 3])
_INDEPENDENT = 100  # of the samples: neighbours share their errors
_SHORTEST, _LONGEST = np.float32(1e-6), np.float32(1e18)  # lengths whose squares float32 holds

# The same, as the loops need it: squared, in degrees.
_PER_NOISE = np.float32(np.degrees(NINE_OF_TEN) ** 2)
_PER_TURN = np.float32(np.degrees(_OF_ELLIPSOID) ** 2)
_PER_NEARNESS = np.float32(np.degrees(_OF_NEARNESS) ** 2)
_PER_DEPARTURE = np.float32(np.degrees(_OF_LENGTH) ** 2)
_PER_DEPARTURES = np.float32(np.degrees(_OF_LENGTHS) ** 2)
_PER_HALF_WEIGHT = np.float32(1.0 / _HALF_WEIGHT_DEG)
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
    light = _Light(np.ascontiguousarray(frame.rgb), None, clipped, np.float32(0), None)
    mask = np.ascontiguousarray(normal_map.mask)
    c = _coefficients(response, camera)
    noise_deg, noise, constants = _evidence(light, mask, labels, c, residual_deg, blur_px, residual_of_pixels)
    error, weight = np.empty(shape, np.float32), np.empty(shape, np.float32)
    found = rows_of(np.ascontiguousarray(normal_map.normals_in_camera, np.float32))
    _error_kernel(
        rows_of(light.image), found, mask, labels, _pairs_of_lights(response), noise, constants, error, weight
    )
    return replace(normal_map, error_deg=error, noise_deg=noise_deg, weight=weight)


def _pairs_of_lights(response: LightResponse) -> npt.NDArray[np.float32]:
    """Return (8, 6): for labels of two lights the normal of the plane of both and the third's direction."""
    pairs = np.zeros((8, 6))
    for missing in range(3):
        one, other = np.delete(response.light_directions, missing, axis=0)
        across = np.cross(one, other)
        pairs[ALL_LIT - (1 << missing), :3] = across / max(float(np.linalg.norm(across)), 1e-12)
        pairs[ALL_LIT - (1 << missing), 3:] = response.light_directions[missing]
    return pairs.astype(np.float32)


def normals_and_errors_from_encoded(
    encoded: npt.NDArray[Any],
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
    light = _Light(np.ascontiguousarray(encoded), decoding.table, None, decoding.white, maps)
    options = options or InversionOptions()
    c = _coefficients(response, camera, options.relative_albedo, options.darkest)
    noise_deg, noise, constants = _evidence(light, inside, None, c, residual_deg, blur_px, residual_of_pixels)
    inversion = coefficients_from_response(response, options)
    limits = np.array([inversion.darkest, inversion.clipped_factor, decoding.white], np.float32)
    normals, valid = np.empty((*shape, 3), np.float32), np.empty(shape, np.bool_)
    error, weight = np.empty(shape, np.float32), np.empty(shape, np.float32)
    clipped = np.zeros(shape[0], np.int64)
    out = (rows_of(normals), valid, error, weight, clipped)
    image = rows_of(light.image)
    _normals_and_errors_kernel(image, decoding.table, maps, inside, noise, constants, limits, out)
    found = NormalMap(
        normals_in_camera=normals,
        mask=valid,
        weight=weight,
        error_deg=error,
        noise_deg=noise_deg,
    )
    return found, float(clipped.sum()) / max(1, shape[0] * shape[1])


class _Light(NamedTuple):
    """Where light is read: linear (h, w, 3), or stored integers with the linear value of each.

    clipped: (h, w) of linear light; stored light is clipped from `white` on. maps: of these colours to those
    that the M of the picture's centre forms, or None where they are so.
    """

    image: Any
    table: Any
    clipped: Any
    white: np.float32
    maps: Any


class _Coefficients(NamedTuple):
    """What the loops need to know, float32.

    inverse: M⁻¹ at the centre, (3, 3). ambient: (3,). rays: (6,), an affine
    map from a pixel to its ray. along: variance of equal noise in all channels along a normal that faces the
    camera, over that across it. darkest: length of M⁻¹(r − a) below which a pixel is black. nearness:
    (2, 3, 3, 3), M⁻¹ΔM a step to the right or down makes with each lamp, times the lamp's distance over the
    step.
    """

    inverse: Any
    ambient: Any
    rays: Any
    along: np.float32
    darkest: np.float32
    nearness: Any


def _coefficients(
    response: LightResponse, camera: Camera | None, relative_albedo: float = 1.0, darkest: float = 1e-6
) -> _Coefficients:
    rays = np.zeros(6)
    if camera is not None and camera.is_perspective:
        inverse = np.linalg.inv(camera.matrix[:2, :2])
        rays = np.column_stack([inverse, -inverse @ camera.matrix[:2, 2]]).ravel()
    spread = response.inverse @ response.inverse.T
    along = 2.0 * spread[2, 2] / max(float(np.trace(spread) - spread[2, 2]), 1e-12)
    nearness = np.einsum("ij,akjl->akil", response.inverse, changes_of_near_lamps(response))
    return _Coefficients(
        inverse=(response.inverse / relative_albedo).astype(np.float32),
        ambient=response.ambient.astype(np.float32),
        rays=rays.astype(np.float32),
        along=np.float32(along),
        darkest=np.float32(darkest),
        nearness=nearness,
    )


def _evidence(
    light: _Light,
    mask: Mask,
    labels: VisibilityLabels | None,
    c: _Coefficients,
    residual_deg: float,
    blur_px: float,
    of_pixels: bool,
) -> tuple[Any, Any, Any]:
    """Return the frame's noise and what holds for all its pixels.

    The noise by cells, (⌈h/16⌉, ⌈w/16⌉), in degrees as the bounds are, and by rows of cells, (3, ⌈h/16⌉, w):
    noise, lost relief, both in radians², and squared departures.
    """
    cells = tuple(-(-n // _CELL) for n in mask.shape)
    found, noise = np.zeros((2, *cells), np.float32), np.empty(cells, np.float32)
    least = _least_length(light.image, light.table, mask, c)
    c = c._replace(darkest=np.float32(least))
    lit = mask if labels is None else mask & (labels == ALL_LIT)  # a shadow's normals belong to no surface
    _curl_kernel(rows_of(light.image), light.table, light.maps, lit, c, *_whole_cells(cells), found)
    rows, ellipsoid = np.zeros((3, cells[0], mask.shape[1]), np.float32), np.empty(32)
    _whole_frame_kernel(light, mask, labels, c, found, noise, rows, ellipsoid)
    if blur_px >= LEAST_BLUR_PX:
        _lost_by_blur(light, mask, labels, c, noise.shape, ellipsoid[0], blur_px, rows[1])
    e00, e01, e02, e11, e12, e22 = ellipsoid[1:7]
    squares = e00**2 + e11**2 + e22**2 + 2.0 * (e01**2 + e02**2 + e12**2)
    squares *= ellipsoid[31]
    residual = (_OF_RESIDUAL * max(residual_deg, 0.0)) ** 2
    if of_pixels and found[1].any():
        residual = max(residual - float(_PER_NOISE * np.median(noise[found[1] > 0])), 0.0)
    fixed = residual + np.degrees(_OF_ROTATION) ** 2 * squares
    constants = np.concatenate([c.inverse.ravel(), c.ambient, (fixed, c.along), ellipsoid])
    return np.sqrt(_PER_NOISE * noise), rows, constants.astype(np.float32)


def _whole_cells(cells: tuple[int, ...]) -> npt.NDArray[np.float32]:
    """Return two (⌈h/16⌉, 16 ⌈w/16⌉) arrays of zeros."""
    return np.zeros((2, cells[0], cells[1] * _CELL), np.float32)


def _lost_by_blur(
    light: _Light, mask: Mask, labels: VisibilityLabels | None, c: _Coefficients, cells: tuple[int, ...],
    inverse_albedo: float, blur_px: float, rows: Any,
) -> None:  # fmt: skip
    """Fill what blur has turned normals by, as noise would, by rows of cells: (⌈h/16⌉, w), radians²."""
    image, table, clipped, white, maps = light
    side, found = side_of_squares(blur_px), np.zeros((3, *cells), np.float32)
    detail_kernel(
        rows_of(image), table, clipped, white, maps, mask, labels, c.inverse, c.ambient,
        np.float32(inverse_albedo), side, found,
    )  # fmt: skip
    left = np.empty(cells, np.float32)
    _noise_of_cells(found[:2], left)
    _along_rows(np.float32(lost_over_left(found, blur_px, side)) * np.maximum(left, np.float32(0.0)), rows)


# Compiled loops. A table of None stands for linear light: numba drops the branches for another. Rows are
# flat slices, whose loops begin at 0: only such loops are done eight pixels at a time.


@njit(cache=True)
def _span(inside: Any) -> tuple[int, int]:
    """Return the first pixel of a row that is inside and the one after the last; (0, 0) for none."""
    first, last = 0, len(inside)
    while first < last and not inside[first]:
        first += 1
    while last > first and not inside[last - 1]:
        last -= 1
    return (first, last) if first < last else (0, 0)


@njit(cache=True)
def _whole_frame_kernel(
    light: _Light, mask: Mask, labels: Any, c: _Coefficients, found: Any, noise: Any, rows: Any,
    ellipsoid: Any,
) -> None:  # fmt: skip
    """Fill noise and rows from the cells' curl, and the ellipsoid; see `_noise_of_cells` and its like."""
    _noise_of_cells(found, noise)
    _along_rows(noise, rows[0])
    known = int(found[1].sum()) * _CELL
    step = max(1, int(math.sqrt(max(known, mask.size // _MOST_PER_KNOWN) // _SAMPLES)))
    samples = np.empty((5, -(-mask.shape[0] // step) * -(-mask.shape[1] // step)))
    image, table, clipped, white, maps = light
    count = _samples_kernel(image, table, clipped, white, maps, mask, labels, c, step, samples)
    _fit_ellipsoid(samples[:, :count], mask.shape, c.nearness, ellipsoid)
    departures, around = np.zeros((2, *noise.shape), np.float32), np.empty_like(noise)
    for i in range(count):
        v, u = int(samples[4, i]) // _CELL, int(samples[3, i]) // _CELL
        departures[0, v, u] += np.float32(samples[0, i] ** 2)
        departures[1, v, u] += np.float32(1.0)
    _noise_of_cells(departures, around)
    by_noise = np.float32(1 / _NEAR_PIXELS) * noise  # at most, in a mean of nine
    _along_rows(np.maximum(around - by_noise, np.float32(0.0)), rows[2])


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _least_length(image: Any, table: Any, mask: Mask, c: _Coefficients) -> np.float32:
    """Return the length of M⁻¹(r − a) below which a pixel is backdrop, hair, or another paint."""
    step = max(1, int(math.sqrt(mask.size // _GRID_PIXELS)))
    squares, count = np.empty(-(-mask.shape[0] // step) * -(-mask.shape[1] // step), np.float32), 0
    for v in range(step // 2, mask.shape[0], step):
        for u in range(step // 2, mask.shape[1], step):
            square = _light_at(image, table, c, v, u)[3]
            if mask[v, u] and square > 0:
                squares[count] = square
                count += 1
    if not count:
        return c.darkest
    ordered = np.sort(squares[:count])
    brightest = np.sqrt(min(ordered[count - 1 - count // 50], _LONGEST))
    return max(c.darkest, np.float32(_LEAST_LIGHT) * brightest)


@njit(cache=True, fastmath=FLAGS | {"reassoc"}, error_model="numpy")
def _fit_ellipsoid(samples: Any, shape: tuple[int, int], nearness: Any, found: Any) -> None:
    """Fill 1 / albedo, e00, e01, e02, e11, e12, e22 of |M⁻¹(r − a)| = albedo (1 + nᵀ(E + u U + v V) n + f),
    U, V, the numbers of f, brightness that changes slowly over the image, by 1, u, v, u², v², u v, and the
    share of E's squares that its own uncertainty does not explain.

    Regress the log length of M⁻¹(r − a) on the normal's squares, on what near lamps make of them and on f,
    robustly. samples: (5, n), M⁻¹(r − a) and the place u, v; here u and v count from the image's centre. The
    first row is overwritten with the departures' sizes.
    shape: of the image. E, symmetric and without trace, is that of the picture's centre.
    """
    count = samples.shape[1]
    design = np.ones((_TERMS + 1, count))  # what to regress on, and the log length
    logs = design[_TERMS]
    for i in range(count):
        x, y, z = samples[0, i], samples[1, i], samples[2, i]
        square = x * x + y * y + z * z
        logs[i] = 0.5 * np.log(square)
        design[1, i], design[2, i] = (x * x - z * z) / square, (y * y - z * z) / square
        design[3, i], design[4, i], design[5, i] = 2 * x * y / square, 2 * x * z / square, 2 * y * z / square
    found[:] = 0.0
    found[0] = np.exp(-np.median(logs)) if count else 1.0
    if count < 2 * _INDEPENDENT:
        samples[0] = 0.0
        return
    half, middle_u, middle_v = max(shape[0], shape[1]) / 2, (shape[1] - 1) / 2, (shape[0] - 1) / 2
    u_0, v_0 = samples[3].mean(), samples[4].mean()
    for i in range(count):
        s, t = (samples[3, i] - u_0) / half, (samples[4, i] - v_0) / half
        design[6, i], design[7, i] = s, t
        design[8, i], design[9, i], design[10, i] = s * s, t * t, s * t
    means = np.empty(5)
    for k in range(5):
        means[k] = design[6 + k].mean()
        design[6 + k] -= means[k]
    for k in range(3):
        for i in range(count):
            s, t = (samples[3, i] - middle_u) / half, (samples[4, i] - middle_v) / half
            total = 0.0
            for row in range(3):
                for column in range(3):
                    change = s * nearness[0, k, row, column] + t * nearness[1, k, row, column]
                    total += change * samples[row, i] * samples[column, i]
            design[11 + k, i] = total * np.exp(-2 * logs[i])
    worth, left, best = np.ones(count), np.empty(count), np.empty(_TERMS)
    spread, normal = max(logs.std(), 1e-3), np.empty((_TERMS, _TERMS + 1))
    information = np.empty_like(normal)
    weighted = np.empty(count)
    for _ in range(_ROUNDS):
        scale = _INDEPENDENT / count / spread**2
        for j in range(_TERMS):
            for i in range(count):
                weighted[i] = scale * worth[i] * design[j, i]
            for k in range(j, _TERMS + 1):
                other, total = design[k], 0.0
                for i in range(count):
                    total += weighted[i] * other[i]
                normal[j, k] = total
            normal[j, j] += _PRIOR[j]
        information[:] = normal
        _solve_symmetric(normal, best)
        left[:] = logs
        for k in range(_TERMS):
            for i in range(count):
                left[i] -= best[k] * design[k, i]
        for i in range(count):
            left[i] = abs(left[i])
        spread = 1.48 * np.median(left) + 1e-3
        for i in range(count):
            worth[i] = 1.0 / (1.0 + (left[i] / (2 * spread)) ** 2)
    for i in range(count):
        samples[0, i] = np.floor(left[i] / _GRID + 0.5) * _GRID
    for k in range(_TERMS):  # code compiled just now and code from numba's cache differ in the last bits
        best[k] = np.floor(best[k] / _GRID + 0.5) * _GRID
    found[0] = np.exp(-best[0])
    found[1], found[2], found[3] = best[1], best[3], best[4]
    found[4], found[5], found[6] = best[2], best[5], -best[1] - best[2]
    for axis in range(2):
        for k in range(3):
            for row in range(3):
                for column in range(3):
                    change = best[11 + k] * nearness[axis, k, row, column] / half
                    found[7 + 9 * axis + 3 * row + column] += change
    s, t, falloff = (middle_u - u_0) / half, (middle_v - v_0) / half, best[6:11]  # the centre, from the mean
    found[25] = falloff[0] * s + falloff[1] * t + falloff[2] * s * s + falloff[3] * t * t + falloff[4] * s * t
    found[25] -= (falloff * means).sum()
    found[26] = (falloff[0] + 2 * falloff[2] * s + falloff[4] * t) / half
    found[27] = (falloff[1] + 2 * falloff[3] * t + falloff[4] * s) / half
    found[28:31] = falloff[2:5] / half**2
    squares = 2.0 * ((best[1:6] ** 2).sum() + best[1] * best[2])
    unsure = _squares_of_uncertainty(information) / max(squares, _GRID**2)
    found[31] = np.floor(max(1.0 - unsure, 0.0) / _GRID + 0.5) * _GRID


@njit(cache=True)
def _squares_of_uncertainty(information: Any) -> float:
    """Return the sum of E's squared entries that its estimate has where E is 0.

    information: inverse covariance of the terms, (n, n + 1), of which the upper half is read.
    """
    total, column = 0.0, np.empty(len(information))
    for k in range(1, 6):
        given = information.copy()
        given[:, -1] = 0.0
        given[k, -1] = 1.0
        _solve_symmetric(given, column)
        total += 2.0 * column[k]
        if k == 1:
            total += 2.0 * column[2]  # e22 = -e00 - e11
    return total


@njit(cache=True)
def _solve_symmetric(a: Any, x: Any) -> None:
    """Solve A x = b for [A b], (n, n + 1), of which the upper half is read and overwritten."""
    size = len(x)
    for i in range(size):
        for j in range(i + 1, size):
            factor = a[i, j] / a[i, i]
            for k in range(j, size + 1):
                a[j, k] -= factor * a[i, k]
    for i in range(size - 1, -1, -1):
        x[i] = a[i, size]
        for k in range(i + 1, size):
            x[i] -= a[i, k] * x[k]
        x[i] /= a[i, i]


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _light_at(image: Any, table: Any, c: _Coefficients, v: int, u: int) -> tuple[Any, Any, Any, Any]:
    """Return r − a of a pixel, and the squared length of M⁻¹(r − a), 0 where it faces away."""
    pixel, inverse, ambient = image[v, u], c.inverse, c.ambient
    if table is None:
        r, g, b = pixel[0], pixel[1], pixel[2]
    else:
        r, g, b = table[pixel[0]], table[pixel[1]], table[pixel[2]]
    r, g, b = r - ambient[0], g - ambient[1], b - ambient[2]
    x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
    y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
    z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
    return r, g, b, x * x + y * y + z * z if z < 0 else np.float32(0.0)


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _samples_kernel(
    image: Any, table: Any, clipped: Any, white: Any, maps: Any, mask: Mask, labels: Any, c: _Coefficients,
    step: int, samples: Any,
) -> int:  # fmt: skip
    """Fill (5, n) with M⁻¹(r − a) and the place u, v on a grid; return how many are lit all around."""
    height, width = mask.shape
    mean = np.empty((3, 1), np.float32)
    inverse, ambient = c.inverse, c.ambient
    count, least = 0, c.darkest * c.darkest
    for v in range(step // 2, height, step):
        for u in range(step // 2, width, step):
            if v < 2 or u < 2 or v >= height - 2 or u >= width - 2 or not mask[v, u]:
                continue
            r, g, b, sound = np.float32(0), np.float32(0), np.float32(0), True
            for far_v, far_u in ((-_EDGE_PX, 0), (_EDGE_PX, 0), (0, -_EDGE_PX), (0, _EDGE_PX)):
                at_v, at_u = min(max(v + far_v, 0), height - 1), min(max(u + far_u, 0), width - 1)
                sound &= _light_at(image, table, c, at_v, at_u)[3] > least  # no backdrop
            for near_v in range(v - 2, v + 3, 2):  # a mean of nine has less noise
                for near_u in range(u - 2, u + 3, 2):
                    red, green, blue, square = _light_at(image, table, c, near_v, near_u)
                    sound &= mask[near_v, near_u] and square > least
                    if labels is not None:
                        sound &= labels[near_v, near_u] == ALL_LIT
                    if clipped is None:
                        sound &= max(red + ambient[0], green + ambient[1], blue + ambient[2]) < white
                    else:
                        sound &= not clipped[near_v, near_u]
                    r, g, b = r + red, g + green, b + blue
            ninth = np.float32(1 / _NEAR_PIXELS)
            mean[0, 0], mean[1, 0] = r * ninth + ambient[0], g * ninth + ambient[1]
            mean[2, 0] = b * ninth + ambient[2]
            if maps is not None:
                map_row(maps, v, u, mean[0], mean[1], mean[2])
            r, g, b = mean[0, 0] - ambient[0], mean[1, 0] - ambient[1], mean[2, 0] - ambient[2]
            x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
            y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
            z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
            length = np.sqrt(x * x + y * y + z * z)
            if sound and z < 0 and length > c.darkest and length < _LONGEST:
                samples[0, count], samples[1, count], samples[2, count] = x, y, z
                samples[3, count], samples[4, count] = u, v
                count += 1
    return count


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _slopes_row(
    line: Any, table: Any, maps: Any, inside: Any, c: _Coefficients, v: int, first: int, p: Any, q: Any,
    known: Any,
) -> None:  # fmt: skip
    """Put in the slopes p, q of the colours' own normals, and cos^1.5 of their inclination; 0 for no normal.

    A turn by ε moves the slope by ε / cos² along the inclination and ε / cos across. v, first: the place of
    the first pixel.
    """
    read_row(line, table, p, q, known)
    if maps is not None:
        map_row(maps, v, first, p, q, known)
    inverse, ambient, rays, one = c.inverse, c.ambient, c.rays, np.float32(1.0)
    i00, i01, i02 = inverse[0, 0], inverse[0, 1], inverse[0, 2]
    i10, i11, i12 = inverse[1, 0], inverse[1, 1], inverse[1, 2]
    i20, i21, i22 = inverse[2, 0], inverse[2, 1], inverse[2, 2]
    a0, a1, a2 = ambient[0], ambient[1], ambient[2]
    to_x, to_y = rays[0], rays[3]
    at_x = to_x * np.float32(first) + rays[1] * np.float32(v) + rays[2]
    at_y = to_y * np.float32(first) + rays[4] * np.float32(v) + rays[5]
    for u in range(len(p)):
        r, g, b = p[u] - a0, q[u] - a1, known[u] - a2
        x, y, z = i00 * r + i01 * g + i02 * b, i10 * r + i11 * g + i12 * b, i20 * r + i21 * g + i22 * b
        length = np.sqrt(x * x + y * y + z * z)
        good = inside[u] & (length > c.darkest) & (length < _LONGEST) & (z < np.float32(0.0))
        scale = one / length if good else one
        ray_x, ray_y = to_x * np.float32(u) + at_x, to_y * np.float32(u) + at_y
        facing = max(-(x * ray_x + y * ray_y + z) * scale, _LEAST_FACING)
        over = scale / facing
        p[u] = x * over
        q[u] = y * over
        known[u] = facing * np.sqrt(facing) if good else np.float32(0.0)


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _curl_kernel(
    image: Any, table: Any, maps: Any, mask: Mask, c: _Coefficients, angles: Any, places: Any, found: Any
) -> None:  # fmt: skip
    """Sum up the squared circulation, as an angle in radians, and its places, along the middle of cells.

    angles, places: (⌈h/16⌉, 16 ⌈w/16⌉), zeros, filled with every circulation and how much it counts.
    """
    for cell in prange(found.shape[1]):
        v = min(cell * _CELL + _CELL // 2 - 1, mask.shape[0] - 1 - _LOOP_PX)
        if v >= _LOOP_PX:
            _curl_row(image, table, maps, mask, c, v, angles[cell], places[cell])
            _medians_of_cells(angles[cell], places[cell], found[0, cell], found[1, cell])
    medians = found.copy()
    for cell in prange(found.shape[1]):
        around = medians[:, max(cell - 1, 0) : cell + 2]
        _squares_of_cells(angles[cell], places[cell], around, found[0, cell], found[1, cell])


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _curl_row(
    image: Any, table: Any, maps: Any, mask: Mask, c: _Coefficients, v: int, found: Any, places: Any
) -> None:
    width, zero, half, one = mask.shape[1], np.float32(0.0), np.float32(0.5), np.float32(1.0)
    first, last = _span(mask[v])
    # one array each, whose slices have no stride: eight pixels at a time
    p, q, known = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.float32)
    down, right, all_known = (
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
        np.ones(width, np.float32),
    )
    top_known, bottom_known = np.zeros(width, np.float32), np.zeros(width, np.float32)
    here = np.zeros(width, np.float32)
    top, bottom = max(v - _EDGE_PX, 0), min(v + _EDGE_PX, mask.shape[0] - 1)
    for row, to_known in ((top, top_known), (bottom, bottom_known)):
        _slopes_row(
            image[row, 3 * first : 3 * last], table, maps, mask[row, first:last], c, row, first,
            p[first:last], q[first:last], to_known[first:last],
        )  # fmt: skip
    for step in range(-_LOOP_PX, _LOOP_PX + 1):
        _slopes_row(
            image[v + step, 3 * first : 3 * last], table, maps, mask[v + step, first:last], c, v + step,
            first, p[first:last], q[first:last], known[first:last],
        )  # fmt: skip
        is_end = abs(step) == _LOOP_PX
        share, sign = half if is_end else one, one if step > 0 else -one
        for u in range(width):
            right[u] += share * q[u]
            all_known[u] = min(all_known[u], known[u])
        if is_end:
            for u in range(width):
                down[u] += sign * p[u]
        if step == 0:
            here[:] = known
    inner, reach = width - 2 * _LOOP_PX, 2 * _EDGE_PX + 1
    if inner < 1:
        return
    counted = np.zeros(width, np.float32)
    if width > reach:
        before, after = here[: width - reach + 1], here[reach - 1 :]
        over, under = top_known[_EDGE_PX:], bottom_known[_EDGE_PX:]
        to_share = counted[_EDGE_PX : width - _EDGE_PX]
        for u in range(len(to_share)):
            farther = min(before[u], after[u], over[u], under[u]) > zero
            to_share[u] = one if farther else zero
    around, good = np.zeros(inner, np.float32), np.ones(inner, np.float32)
    for i in range(2 * _LOOP_PX + 1):
        along, whole_known = down[i : i + inner], all_known[i : i + inner]
        share = half if i == 0 or i == 2 * _LOOP_PX else one
        for u in range(inner):
            around[u] += share * along[u]
            good[u] = min(good[u], whole_known[u])
    q_before, q_after = right[:inner], right[2 * _LOOP_PX :]
    to_found, to_places = found[_LOOP_PX : _LOOP_PX + inner], places[_LOOP_PX : _LOOP_PX + inner]
    of_here, of_counted = here[_LOOP_PX : _LOOP_PX + inner], counted[_LOOP_PX : _LOOP_PX + inner]
    for u in range(inner):
        to_found[u] = _PER_CIRCULATION * (around[u] - (q_after[u] - q_before[u])) * of_here[u]
        to_places[u] = max(of_counted[u], _EDGE_SHARE) if good[u] > zero else zero


@njit(cache=True)
def _median_of(values: Any, count: int) -> np.float32:
    """Sort the first of a few values in place; return their median."""
    for i in range(1, count):
        value, at = values[i], i
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value
    return np.float32(0.5) * (values[(count - 1) // 2] + values[count // 2])


@njit(cache=True)
def _take_cell(angles: Any, places: Any, cell: int, out: Any) -> tuple[np.float32, int]:
    """Fill out (16,) with the angles of a cell that have its largest weight; return it and their number."""
    here, weights = angles[cell * _CELL : (cell + 1) * _CELL], places[cell * _CELL : (cell + 1) * _CELL]
    largest, count = weights.max(), 0
    for i in range(_CELL):
        if weights[i] == largest:
            out[count] = here[i]
            count += 1
    return largest, count


@njit(cache=True)
def _medians_of_cells(angles: Any, places: Any, sums: Any, counts: Any) -> None:
    """Fill the median angle of every cell of a row times its weight, and the weight.

    Only the angles with a cell's largest weight count.
    """
    ordered = np.empty(_CELL, np.float32)
    for cell in range(len(sums)):
        largest, count = _take_cell(angles, places, cell, ordered)
        counts[cell] = largest * np.float32(count)
        sums[cell] = counts[cell] * _median_of(ordered, count)


@njit(cache=True)
def _squares_of_cells(angles: Any, places: Any, medians: Any, sums: Any, counts: Any) -> None:
    """Fill every cell's variance of normally distributed angles times its weight, by the median departure.

    medians: (2, 2 or 3, w), of this row of cells and those beside it, from `_medians_of_cells`. What the
    angles of 3×3 cells have in common is no noise: an error of M gives normals that belong to no surface,
    either. A codec's noise is alike all over a block, but not over 3×3 cells.
    """
    ordered = np.empty(_CELL, np.float32)
    for cell in range(len(sums)):
        _, count = _take_cell(angles, places, cell, ordered)
        beside = medians[:, :, max(cell - 1, 0) : cell + 2]
        shared = beside[0].sum() / max(beside[1].sum(), _EDGE_SHARE)
        for i in range(count):
            ordered[i] = abs(ordered[i] - shared)
        median = _median_of(ordered, count) * _PER_MEDIAN
        sums[cell] = counts[cell] * min(median * median, np.float32(1.0))


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _noise_of_cells(found: Any, noise: Any) -> None:
    """Fill (h, w), radians²: the mean over 3×3 cells, over 5×5 where those know nothing, or 0."""
    _, height, width = found.shape
    columns, zero = np.zeros((2, width + 2 * _WIDER), np.float32), np.float32(0.0)
    for v in range(height):
        for reach in range(1, _WIDER + 1):
            for k in range(2):
                to = columns[k, _WIDER : _WIDER + width]
                to[:] = zero
                for row in range(max(v - reach, 0), min(v + reach + 1, height)):
                    line = found[k, row]
                    for u in range(width):
                        to[u] += line[u]
            for u in range(width):
                if reach > 1 and noise[v, u] >= zero:
                    continue
                total, count = zero, zero
                for i in range(_WIDER + u - reach, _WIDER + u + reach + 1):
                    total += columns[0, i]
                    count += columns[1, i]
                unknown = np.float32(-1.0) if reach < _WIDER else zero
                noise[v, u] = total / count if count > zero else unknown


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _along_rows(noise: Any, rows: Any) -> None:
    """Fill (rows of cells, w) between the centres of the cells of a row, by linear interpolation."""
    height, width = noise.shape
    half = np.float32(0.5)
    for v in range(height):
        for k in range(width + 1):
            start = k * _CELL - _CELL // 2  # the centre of cell k - 1
            first = max(start, 0)
            to, before = rows[v, first : start + _CELL], noise[v, max(k - 1, 0)]
            slope = (noise[v, min(k, width - 1)] - before) * np.float32(1.0 / _CELL)
            before += slope * (np.float32(first - start) + half)
            for u in range(len(to)):
                to[u] = before + slope * np.float32(u)


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _noise_row(noise: Any, v: int, first: int, row: Any) -> None:
    """Fill (3, n) from pixel `first` on, between the centres of the rows of cells; linear too."""
    y = max((np.float32(v) + np.float32(0.5)) / np.float32(_CELL) - np.float32(0.5), np.float32(0.0))
    last = noise.shape[1] - 1
    up = min(int(y), last)
    t, one = y - np.float32(up), np.float32(1.0)
    for k in range(3):
        above, below, to = noise[k, up, first:], noise[k, min(up + 1, last), first:], row[k]
        for u in range(len(to)):
            to[u] = (one - t) * above[u] + t * below[u]


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _slow_changes_at(shape: Any, k: Any, u: int, v: int) -> Any:
    """Return M⁻¹ΔM of near lamps at a pixel, (9,), then f of `_fit_ellipsoid` there and its slope along u."""
    half, two = np.float32(0.5), np.float32(2.0)
    right, down = np.float32(u) - half * (shape[1] - 1), np.float32(v) - half * (shape[0] - 1)
    found = np.empty(11, np.float32)
    for i in range(9):
        found[i] = np.float32(right) * k[21 + i] + np.float32(down) * k[30 + i]
    found[9] = (
        k[39] + k[40] * right + k[41] * down + k[42] * right**2 + k[43] * down**2 + k[44] * right * down
    )
    found[10] = k[40] + two * k[42] * right + k[44] * down
    return found


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
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
    s0, s1, s2, s3, s4, s5, s6, s7, s8 = k[21], k[22], k[23], k[24], k[25], k[26], k[27], k[28], k[29]
    count = len(r)
    departures, rest = np.zeros(count + 2 * _BESIDE_PX, np.float32), np.empty(count, np.float32)
    for u in range(count):  # without a branch: eight pixels at a time
        red, green, blue = r[u] - a0, g[u] - a1, b[u] - a2
        x = i00 * red + i01 * green + i02 * blue
        y = i10 * red + i11 * green + i12 * blue
        z = i20 * red + i21 * green + i22 * blue
        size = np.sqrt(x * x + y * y + z * z)
        seen = (size > _SHORTEST) & (size < _LONGEST)
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
        foretold = max(one + along + longer + f0 + at * (f1 + at * f2), _LEAST_FACING)
        measured = max(size * inverse_albedo, _SHORTEST)
        departure = abs(measured * measured - foretold * foretold) / (measured * foretold) * half
        departure = min(departure, one)  # sinh of the log length
        departures[u + _BESIDE_PX] = departure * departure if seen else zero
        rest[u] = fixed + _PER_TURN * told * turn + _PER_NEARNESS * near + _PER_NOISE * (noise[u] + lost[u])
        r[u], g[u], b[u], length[u] = x, y, z, size
    if found is not None:
        _leave_out(r, g, b, found, unlit, noise, inside, rest)
    share_of_one = one / np.float32(2 * _BESIDE_PX + 1)
    for u in range(count):
        around = departures[u]
        for i in range(1, 2 * _BESIDE_PX + 1):
            around += departures[u + i]
        departure = max(departures[u + _BESIDE_PX], around * share_of_one)
        # Noise across the axis has one variance, along it `along_noise` times that. A normal that leans away
        # by t is turned by (1 + cos² t + along sin² t) / 2 of it, its length by sin² t + along cos² t, and
        # rarely by more than two standard deviations.
        facing = b[u] * b[u]
        leaning = one - facing
        of_turn = eight * noise[u] / (one + facing + along_noise * leaning)
        own = departure - of_turn * (leaning + along_noise * facing)
        own = max(_PER_DEPARTURE * own if unlit[u] == zero else zero, _PER_DEPARTURES * around_cell[u])
        total = rest[u] + own + unlit[u]
        angle = min(np.sqrt(total), _LARGEST_DEG) if length[u] > _SHORTEST else _LARGEST_DEG
        share = angle * _PER_HALF_WEIGHT
        bound[u] = angle if inside[u] else zero
        weight[u] = one / (one + share * share) if inside[u] else zero


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _leave_out(
    r: Any, g: Any, b: Any, found: Any, unlit: Any, noise: Any, inside: Any, rest: Any
) -> None:  # fmt: skip
    """Take from a row of squared bounds the noise of the colours' normals that those found do not have."""
    count, zero, four = len(r), np.float32(0.0), np.float32(4.0)
    reach = _LEFT_OUT_PX // 2
    apart = np.zeros(count + _LEFT_OUT_PX, np.float32)
    x, y, z = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
    read_row(found, None, x, y, z)
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


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _error_kernel(
    rgb: Any, normals: Any, mask: Mask, labels: Any, pairs: Any, noise: Any, constants: Any, error: Any,
    weight: Any,
) -> None:  # fmt: skip
    """Fill (h, w) with the bound in degrees and its weight; 0 outside the mask.

    normals: (h, 3 w), found. pairs: of `_pairs_of_lights`.
    """
    for v in prange(len(mask)):
        error[v, :] = np.float32(0.0)
        weight[v, :] = np.float32(0.0)
        first, last = _span(mask[v])
        if first == last:
            continue
        # what departs just outside counts, as where stored samples are read
        first, last = max(first - _BESIDE_PX, 0), min(last + _BESIDE_PX, mask.shape[1])
        count = last - first
        r, g, b = np.empty(count, np.float32), np.empty(count, np.float32), np.empty(count, np.float32)
        length, unlit = np.empty(count, np.float32), np.zeros(count, np.float32)
        row_noise = np.empty((3, count), np.float32)
        _noise_row(noise, np.int64(v), first, row_noise)
        read_row(rgb[v, 3 * first : 3 * last], None, r, g, b)
        found = None if labels is None else normals[v, 3 * first : 3 * last]
        if labels is not None:
            _unlit_row(r, g, b, found, labels[v, first:last], pairs, constants, unlit)
        _bound_row(
            r, g, b, found, unlit, row_noise, mask[v, first:last], constants,
            _slow_changes_at(mask.shape, constants, first, v), length, error[v, first:last],
            weight[v, first:last],
        )  # fmt: skip


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _unlit_row(
    r: Any, g: Any, b: Any, normals: Any, label: Any, pairs: Any, k: Any, unlit: Any
) -> None:  # fmt: skip
    """Fill the squared bounds of a row of pixels that not all lights reach, 0 of the others."""
    zero, one = np.float32(0.0), np.float32(1.0)
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
        red, green, blue, scale = r[u] - k[9], g[u] - k[10], b[u] - k[11], k[14]
        # M⁻¹(r − a) says in the plane of the two lights what the normal is, and nothing across it
        x = scale * (k[0] * red + k[1] * green + k[2] * blue)
        y = scale * (k[3] * red + k[4] * green + k[5] * blue)
        z = scale * (k[6] * red + k[7] * green + k[8] * blue)
        across = x * a0 + y * a1 + z * a2
        x, y, z = x - across * a0, y - across * a1, z - across * a2
        off = n0 * a0 + n1 * a1 + n2 * a2
        height = np.sqrt(max(one - x * x - y * y - z * z, zero))
        height = height if off > zero else -height
        x, y, z = x + height * a0, y + height * a1, z + height * a2
        size = max(np.sqrt(x * x + y * y + z * z), _SHORTEST)
        x, y, z = x / size, y / size, z / size
        squared = (x - n0) * (x - n0) + (y - n1) * (y - n1) + (z - n2) * (z - n2)
        behind = (x * l0 + y * l1 + z * l2 < zero) & (n0 * l0 + n1 * l1 + n2 * l2 < zero)
        if not behind and n2 - (off + off) * a2 < zero:  # the other normal faces the camera
            squared += np.float32(4.0) * off * off
        known = squared < np.float32(8.0)  # no NaN
        unlit[u] = max(_PER_DISTANCE * squared, _SHORTEST) if known else _LARGEST_DEG * _LARGEST_DEG


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _normals_and_errors_kernel(
    encoded: Any, table: Any, maps: Any, mask: Mask, noise: Any, constants: Any, limits: Any, out: Any
) -> None:
    """Fill normals (h, w, 3), valid, the bound in degrees and its weight (h, w), and clipped pixels a row."""
    height, width = mask.shape
    normals, valid, error, weight, clipped = out  # numba drops stores through a tuple's field inside prange
    darkest, clipped_factor, white, zero = limits[0], limits[1], limits[2], np.float32(0.0)
    for v in prange(height):
        r, g, b = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        length, row_noise = np.empty(width, np.float32), np.empty((3, width), np.float32)
        unlit, good = np.zeros(width, np.float32), np.empty(width, np.bool_)
        _noise_row(noise, np.int64(v), 0, row_noise)
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
        near = _slow_changes_at(mask.shape, constants, 0, v)
        _bound_row(r, g, b, None, unlit, row_noise, good, constants, near, length, error[v], weight[v])
        to_error, to_weight, to_valid, to_normals = error[v], weight[v], valid[v], normals[v]
        for u in range(width):
            kept = good[u] & (length[u] > darkest) & (length[u] < _LONGEST) & (b[u] < zero)
            to_valid[u] = kept
            to_error[u] = to_error[u] if kept else zero
            to_weight[u] = to_weight[u] if kept else zero
            r[u], g[u], b[u] = r[u] if kept else zero, g[u] if kept else zero, b[u] if kept else zero
        for u in range(width):
            to_normals[3 * u] = r[u]
            to_normals[3 * u + 1] = g[u]
            to_normals[3 * u + 2] = b[u]

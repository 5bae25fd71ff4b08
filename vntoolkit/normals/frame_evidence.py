"""What a frame tells of the errors of its normals: noise, lost relief, and a rig that is wrong.

- Noise of every kind (shot, read, quantisation, codec) turns normals at random. A surface's slopes (p, q)
  add up to 0 around a square, p along the rows and q along the columns; noise does not. Squares of 4 pixels
  show a codec's noise, too, which is alike over several pixels.
- An error ΔM of the rig or of the material's colour moves M⁻¹r from the unit sphere onto an ellipsoid,
  |M⁻¹r| ≈ 1 + nᵀE n with E the symmetric part of M⁻¹ΔM. The ellipsoid that fits the frame tells E, and E the
  turn of every normal, but for the rotation in M⁻¹ΔM, which leaves no trace. Of the turns, squared, those
  are taken away that a fit to so few independent samples has where E is 0. On a flat subject E02 and E12 are
  told well and turn its normals; the other entries are hardly told and hardly turn them.
- Under near lamps M is right at the picture's centre only. A lamp in the direction l at the distance d has at
  a place δ beside the centre, to first order, the direction times strength l + (3 l (l·δ) − δ) / d. That
  changes the length of M⁻¹r with the place and the direction, which tells d of each lamp.
- Blur averages relief away: of a lens, of motion, of colours that were interpolated. What it has left of
  relief as wide as itself foretells what is lost; see `lost_detail`.

`expected_error` makes angles of these.
"""

import math
from typing import Any, NamedTuple

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NOISE_CELL_PX
from vntoolkit.native import njit
from vntoolkit.normals.inversion import read_row, rows_of
from vntoolkit.normals.lost_detail import LEAST_BLUR_PX, detail_kernel, lost_over_left, side_of_squares
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.photometry.levelling import span_of
from vntoolkit.photometry.response import LightResponse, changes_of_near_lamps
from vntoolkit.spread import MEDIAN_TO_DEVIATION, robust_deviation
from vntoolkit.threads import one_blas_thread

SHORTEST, LONGEST = np.float32(1e-6), np.float32(1e18)  # lengths whose squares float32 holds
LEAST_FACING = np.float32(0.1)
_CELL = NOISE_CELL_PX  # noise changes slowly: one row of every cell tells it
_LOOP_PX = 2  # half a side of the squares: a codec's noise is alike over 4 pixels, its smallest blocks
# Standard deviations over a cell's median size. White noise of variance 1 adds up to 4 (1/4 + 3 + 1/4) around
# a square: the pixels at its corners count half. Of 16 squares that overlap the median, squared, is 1.166
# times that of many that do not.
_PER_MEDIAN = np.float32(MEDIAN_TO_DEVIATION / math.sqrt(14.0 * 1.166))
_EDGE_PX = 4  # from the subject's edge, which blur mixes with what lies behind
_LEAST_LIGHT, _GRID_PIXELS = 0.3, 4000  # of the length that a fiftieth exceeds, over a grid of pixels
_SAMPLES, _NEAR_PIXELS = 1000, 9
_MOST_PER_KNOWN = 20  # places of the grid that are looked at for a sample
_ROUNDS = 4
_GRID = 2.0**-16  # of log lengths that are fitted: finer than any bound, far coarser than their rounding
_ELLIPSOID_SPREAD = 0.05  # prior standard deviation of E's entries …
_FALLOFF_SPREAD = 0.1  # … of the slow change of brightness over the image …
_NEARNESS_SPREAD = 0.3  # … and of half the picture's larger side over a lamp's distance
_PRIOR = np.repeat([0.0, _ELLIPSOID_SPREAD**-2, _FALLOFF_SPREAD**-2, _NEARNESS_SPREAD**-2], [1, 5, 5, 3])
# E by its five entries e00, e11, e01, e02, e12, and their covariance where the nine of M⁻¹ΔM have variance 1.
_ENTRIES = np.zeros((5, 3, 3))
_ENTRIES[[0, 0, 1, 1], [0, 2, 1, 2], [0, 2, 1, 2]] = 1, -1, 1, -1
_ENTRIES[[2, 2, 3, 3, 4, 4], [0, 1, 0, 2, 1, 2], [1, 0, 2, 0, 2, 1]] = 1
_OF_EQUAL_ENTRIES = np.diag([2 / 3, 2 / 3, 1 / 2, 1 / 2, 1 / 2])
_OF_EQUAL_ENTRIES[[0, 1], [1, 0]] = -1 / 3
_INDEPENDENT = 100  # of the samples: neighbours share their errors


class RigModel(NamedTuple):
    """What the loops need to know, float32.

    inverse: M⁻¹ at the centre, (3, 3). ambient: (3,). rays: (6,), an affine map from a pixel to its ray.
    along: variance of equal noise in all channels along a normal that faces the camera, over that across it.
    darkest: length of M⁻¹(r − a) below which a pixel is black. nearness: (2, 3, 3, 3), M⁻¹ΔM that a step to
    the right or down makes with each lamp, times the lamp's distance over the step.
    """

    inverse: Any
    ambient: Any
    rays: Any
    along: np.float32
    darkest: np.float32
    nearness: Any


def model_of_rig(
    response: LightResponse, camera: Camera | None, relative_albedo: float = 1.0, darkest: float = 1e-6
) -> RigModel:
    """Return what the loops need of M, the camera and the brightness that M belongs to."""
    rays = np.zeros(6)
    if camera is not None and camera.is_perspective:
        inverse = np.linalg.inv(camera.matrix[:2, :2])
        rays = np.column_stack([inverse, -inverse @ camera.matrix[:2, 2]]).ravel()
    spread = response.inverse @ response.inverse.T
    along = 2.0 * spread[2, 2] / max(float(np.trace(spread) - spread[2, 2]), 1e-12)
    nearness = np.einsum("ij,akjl->akil", response.inverse, changes_of_near_lamps(response))
    return RigModel(
        inverse=(response.inverse / relative_albedo).astype(np.float32),
        ambient=response.ambient.astype(np.float32),
        rays=rays.astype(np.float32),
        along=np.float32(along),
        darkest=np.float32(darkest),
        nearness=nearness,
    )


def evidence_of_frame(
    image: Any, clipped: Mask, mask: Mask, labels: VisibilityLabels | None, c: RigModel, blur_px: float
) -> tuple[Any, Any, Any, Any]:
    """Return noise, where it was seen, what `evidence_row` reads, and the ellipsoid.

    image: (h, w, 3), linear, as the M of the picture's centre forms it. clipped, mask: (h, w).
    Noise: (⌈h/16⌉, ⌈w/16⌉), radians²; seen: the same, 0 where neighbours tell it. Rows: (3, ⌈h/16⌉, w), noise
    and lost relief, radians², and squared residuals from the ellipsoid. Ellipsoid: see `fit_ellipsoid`.
    """
    height, width = mask.shape
    cells = (-(-height // _CELL), -(-width // _CELL))
    found = np.zeros((2, *cells), np.float32)
    c = c._replace(darkest=_least_length(image, mask, c))
    lit = mask if labels is None else mask & (labels == ALL_LIT)  # a shadow's normals belong to no surface
    _curl_kernel(rows_of(image), lit, c, found)
    noise, rows = _means_of_cells(found), np.zeros((3, cells[0], width), np.float32)
    rows[0] = _along_rows(noise, width)
    known = int(found[1].sum()) * _CELL
    step = max(1, int(math.sqrt(max(known, mask.size // _MOST_PER_KNOWN) // _SAMPLES)))
    samples = np.empty((5, -(-height // step) * -(-width // step)))
    count = _samples_kernel(image, clipped, mask, labels, c, step, samples)
    ellipsoid, residuals = fit_ellipsoid(samples[:, :count], (height, width), c.nearness)
    u, v = samples[3:, :count].astype(np.intp) // _CELL
    sums = [np.bincount(v * cells[1] + u, weights, math.prod(cells)) for weights in (residuals**2, None)]
    around = _means_of_cells(np.array(sums, np.float32).reshape(2, *cells))
    by_noise = np.float32(1 / _NEAR_PIXELS) * noise  # at most, in a mean of nine
    rows[2] = _along_rows(np.maximum(around - by_noise, np.float32(0)), width)
    if blur_px >= LEAST_BLUR_PX:
        side, left = side_of_squares(blur_px), np.zeros((3, *cells), np.float32)
        detail_kernel(
            rows_of(image), clipped, mask, labels, c.inverse, c.ambient, np.float32(ellipsoid[0]), side, left
        )  # fmt: skip
        lost = np.float32(lost_over_left(left, blur_px, side)) * _means_of_cells(left[:2])
        rows[1] = _along_rows(lost, width)
    return noise, found[1], rows, ellipsoid


def _means_of_cells(found: Any) -> Any:
    """Return (h, w) means over 3×3 cells of sums and counts, (2, h, w), over 5×5 where those know nothing."""
    mean = np.zeros(found.shape[1:], np.float32)
    for side in (5, 3):
        total, count = (cv2.boxFilter(k, -1, (side, side), normalize=False, borderType=0) for k in found)
        known = count > 0.5  # sums of whole numbers that slide
        mean[known] = np.maximum(total[known], 0.0) / count[known]
    return mean


def _along_rows(cells: Any, width: int) -> Any:
    """Return (rows of cells, w), interpolated between the centres of the cells of a row."""
    height, across = cells.shape
    return cv2.resize(cells, (across * _CELL, height), interpolation=cv2.INTER_LINEAR)[:, :width]


@one_blas_thread()
def fit_ellipsoid(
    samples: FloatArray, shape: tuple[int, int], nearness: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Fit 1 / albedo, e00, e01, e02, e11, e12, e22 of |M⁻¹(r − a)| = albedo (1 + nᵀ(E + u U + v V) n + f),
    U, V, the numbers of f, brightness that changes slowly over the image, by 1, u, v, u², v², u v, the share
    of the turns by E, squared, that its own uncertainty does not explain, and the standard deviation of the
    nine entries of M⁻¹ΔM that makes such turns: (33,). Return it and how far the samples' log lengths depart.

    Regress the log length of M⁻¹(r − a) on the normal's squares, on what near lamps make of them and on f,
    robustly. samples: (5, n), M⁻¹(r − a) and the place u, v; here u and v count from the image's centre.
    shape: of the image. E, symmetric and without trace, is that of the picture's centre.
    """
    found, count = np.zeros(33), samples.shape[1]
    lengths = np.sqrt((samples[:3] ** 2).sum(axis=0))
    logs = np.log(lengths)
    found[0] = np.exp(-np.median(logs)) if count else 1.0
    if count < 2 * _INDEPENDENT:
        return found, np.zeros(count)
    x, y, z = n = samples[:3] / lengths
    half, middle, mean = max(shape) / 2, (np.array(shape[::-1]) - 1) / 2, samples[3:].mean(axis=1)
    s, t = (samples[3:] - mean[:, None]) / half
    falloff = np.stack([s, t, s * s, t * t, s * t])
    means = falloff.mean(axis=1)
    products = (n[:, None] * n).reshape(9, count)
    near = (samples[3:] - middle[:, None])[:, None] / half * (nearness.reshape(2, 3, 9) @ products)
    squares = [np.ones(count), x * x - z * z, y * y - z * z, 2 * x * y, 2 * x * z, 2 * y * z]
    design = np.vstack([*squares, falloff - means[:, None], near.sum(axis=0)])
    worth, spread = np.ones(count), max(logs.std(), 1e-3)
    for _ in range(_ROUNDS):
        weighted = design * (worth * (_INDEPENDENT / count / spread**2))
        information = weighted @ design.T + np.diag(_PRIOR)
        best = np.linalg.solve(information, weighted @ logs)
        left = np.abs(logs - best @ design)
        spread = robust_deviation(left) + 1e-3
        worth = 1.0 / (1.0 + (left / (2 * spread)) ** 2)
    best = _rounded(best)  # sums in another order differ in the last bits
    e00, e11, e01, e02, e12 = best[1:6]
    found[:7] = np.exp(-best[0]), e00, e01, e02, e11, e12, -e00 - e11
    found[7:25] = (np.einsum("k,akij->aij", best[11:], nearness) / half).ravel()
    f, (s, t) = best[6:11], (middle - mean) / half  # the picture's centre, from the samples' mean
    found[25] = f @ (np.array([s, t, s * s, t * t, s * t]) - means)
    found[26:28] = (f[0] + 2 * f[2] * s + f[4] * t) / half, (f[1] + 2 * f[3] * t + f[4] * s) / half
    found[28:31] = f[2:] / half**2
    # what E's entries turn these normals by, squared: as they were found, and by their uncertainty alone
    parts = _ENTRIES @ n
    turns = np.einsum("jin,kin->jk", parts, parts) - design[1:6] @ design[1:6].T
    turned = best[1:6] @ turns @ best[1:6]
    established = max(turned - np.sum(turns * np.linalg.inv(information)[1:6, 1:6]), 0.0)
    found[31] = _rounded(established / max(turned, _GRID**2))
    found[32] = _rounded(math.sqrt(established / np.sum(turns * _OF_EQUAL_ENTRIES)))
    return found, _rounded(left)


def _rounded(values: Any) -> Any:
    return np.floor(np.asarray(values) / _GRID + 0.5) * _GRID


def _least_length(image: Any, mask: Mask, c: RigModel) -> np.float32:
    """Return the length of M⁻¹(r − a) below which a pixel is backdrop, hair, or another paint."""
    step = max(1, math.isqrt(mask.size // _GRID_PIXELS))
    some = np.s_[step // 2 :: step, step // 2 :: step]
    with np.errstate(over="ignore", invalid="ignore"):
        x, y, z = c.inverse @ (image[some][mask[some]] - c.ambient).T
        squares = (x * x + y * y + z * z)[z < 0]
    squares = squares[squares > 0]
    if not squares.size:
        return c.darkest
    nearly_last = len(squares) - 1 - len(squares) // 50
    brightest = np.sqrt(min(np.partition(squares, nearly_last)[nearly_last], LONGEST))
    return max(c.darkest, np.float32(_LEAST_LIGHT) * brightest)


# Compiled loops. Rows are flat slices, whose loops begin at 0: only such loops are done eight pixels at a
# time.


@njit
def _light_at(image: Any, c: RigModel, v: int, u: int) -> tuple[Any, Any, Any, Any]:
    """Return r − a of a pixel, and the squared length of M⁻¹(r − a), 0 where it faces away."""
    pixel, inverse, ambient = image[v, u], c.inverse, c.ambient
    r, g, b = pixel[0] - ambient[0], pixel[1] - ambient[1], pixel[2] - ambient[2]
    x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
    y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
    z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
    return r, g, b, x * x + y * y + z * z if z < 0 else np.float32(0.0)


@njit
def _samples_kernel(
    image: Any, clipped: Any, mask: Mask, labels: Any, c: RigModel, step: int, samples: Any
) -> int:
    """Fill (5, n) with M⁻¹(r − a) and the place u, v on a grid; return how many are lit all around."""
    height, width = mask.shape
    inverse = c.inverse
    count, least = 0, c.darkest * c.darkest
    for v in range(step // 2, height, step):
        for u in range(step // 2, width, step):
            if v < 2 or u < 2 or v >= height - 2 or u >= width - 2 or not mask[v, u]:
                continue
            r, g, b, sound = np.float32(0), np.float32(0), np.float32(0), True
            for far_v, far_u in ((-_EDGE_PX, 0), (_EDGE_PX, 0), (0, -_EDGE_PX), (0, _EDGE_PX)):
                at_v, at_u = min(max(v + far_v, 0), height - 1), min(max(u + far_u, 0), width - 1)
                sound &= _light_at(image, c, at_v, at_u)[3] > least  # no backdrop
            for near_v in range(v - 2, v + 3, 2):  # a mean of nine has less noise
                for near_u in range(u - 2, u + 3, 2):
                    red, green, blue, square = _light_at(image, c, near_v, near_u)
                    sound &= mask[near_v, near_u] and square > least
                    if labels is not None:
                        sound &= labels[near_v, near_u] == ALL_LIT
                    sound &= not clipped[near_v, near_u]
                    r, g, b = r + red, g + green, b + blue
            ninth = np.float32(1 / _NEAR_PIXELS)
            r, g, b = r * ninth, g * ninth, b * ninth
            x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
            y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
            z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
            length = np.sqrt(x * x + y * y + z * z)
            if sound and z < 0 and length > c.darkest and length < LONGEST:
                samples[0, count], samples[1, count], samples[2, count] = x, y, z
                samples[3, count], samples[4, count] = u, v
                count += 1
    return count


@njit
def _slopes_row(line: Any, inside: Any, c: RigModel, v: int, first: int, p: Any, q: Any, known: Any) -> None:
    """Put in the slopes p, q of the colours' own normals, and cos^1.5 of their inclination; 0 for no normal.

    A turn by ε moves the slope by ε / cos² along the inclination and ε / cos across. v, first: the place of
    the first pixel.
    """
    read_row(line, p, q, known)
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
        good = inside[u] & (length > c.darkest) & (length < LONGEST) & (z < np.float32(0.0))
        scale = one / length if good else one
        ray_x, ray_y = to_x * np.float32(u) + at_x, to_y * np.float32(u) + at_y
        facing = max(-(x * ray_x + y * ray_y + z) * scale, LEAST_FACING)
        over = scale / facing
        p[u] = x * over
        q[u] = y * over
        known[u] = facing * np.sqrt(facing) if good else np.float32(0.0)


@njit
def _curl_kernel(image: Any, mask: Mask, c: RigModel, found: Any) -> None:
    """Sum up the squared circulation, as an angle in radians, and its places, along the middle of cells."""
    width = mask.shape[1]
    for cell in range(found.shape[1]):
        v = min(cell * _CELL + _CELL // 2 - 1, mask.shape[0] - 1 - _LOOP_PX)
        if v >= _LOOP_PX:
            sizes, places = np.empty(width, np.float32), np.zeros(width, np.bool_)
            _curl_row(image, mask, c, v, sizes, places)
            _squares_of_cells(sizes, places, found[0, cell], found[1, cell])


@njit
def _curl_row(image: Any, mask: Mask, c: RigModel, v: int, found: Any, places: Any) -> None:
    width, zero, half, one = mask.shape[1], np.float32(0.0), np.float32(0.5), np.float32(1.0)
    first, last = span_of(mask[v])
    # one array each, whose slices have no stride: eight pixels at a time
    p, q, known = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.float32)
    down, right = np.zeros(width, np.float32), np.zeros(width, np.float32)
    all_known, here = np.ones(width, np.float32), np.empty(width, np.float32)
    for step in range(-_LOOP_PX, _LOOP_PX + 1):
        _slopes_row(
            image[v + step, 3 * first : 3 * last], mask[v + step, first:last], c, v + step, first,
            p[first:last], q[first:last], known[first:last],
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
            here = known.copy()
    inner = width - 2 * _LOOP_PX
    if inner < 1:
        return
    around, good = np.zeros(inner, np.float32), np.ones(inner, np.float32)
    for i in range(2 * _LOOP_PX + 1):
        along, whole_known = down[i : i + inner], all_known[i : i + inner]
        share = half if i == 0 or i == 2 * _LOOP_PX else one
        for u in range(inner):
            around[u] += share * along[u]
            good[u] = min(good[u], whole_known[u])
    q_before, q_after = right[:inner], right[2 * _LOOP_PX :]
    to_found, to_places = found[_LOOP_PX : _LOOP_PX + inner], places[_LOOP_PX : _LOOP_PX + inner]
    of_here = here[_LOOP_PX : _LOOP_PX + inner]
    for u in range(inner):
        to_found[u] = abs(around[u] - (q_after[u] - q_before[u])) * of_here[u]
        to_places[u] = good[u] > zero


@njit
def _median_of(values: Any, count: int) -> np.float32:
    """Sort the first of a few values in place; return their median."""
    for i in range(1, count):
        value, at = values[i], i
        while at > 0 and values[at - 1] > value:
            values[at] = values[at - 1]
            at -= 1
        values[at] = value
    return np.float32(0.5) * (values[(count - 1) // 2] + values[count // 2])


@njit
def _squares_of_cells(sizes: Any, places: Any, sums: Any, counts: Any) -> None:
    """Fill every cell's sum of squared circulations, by their median size, and their number."""
    of_cell = np.empty(_CELL, np.float32)
    for cell in range(len(sums)):
        count = 0
        for u in range(cell * _CELL, min((cell + 1) * _CELL, len(sizes))):
            if places[u]:
                of_cell[count] = sizes[u]
                count += 1
        if count:
            deviation = _PER_MEDIAN * _median_of(of_cell, count)
            counts[cell] = np.float32(count)
            sums[cell] = counts[cell] * min(deviation * deviation, np.float32(1.0))


@njit
def evidence_row(noise: Any, v: int, first: int, row: Any) -> None:
    """Fill (3, n) from pixel `first` on, between the rows of cells; linear too."""
    y = max((np.float32(v) + np.float32(0.5)) / np.float32(_CELL) - np.float32(0.5), np.float32(0.0))
    last = noise.shape[1] - 1
    up = min(int(y), last)
    t, one = y - np.float32(up), np.float32(1.0)
    for k in range(3):
        above, below, to = noise[k, up, first:], noise[k, min(up + 1, last), first:], row[k]
        for u in range(len(to)):
            to[u] = (one - t) * above[u] + t * below[u]


@njit
def slow_changes_at(shape: Any, k: Any, u: int, v: int) -> Any:
    """Return M⁻¹ΔM of near lamps at a pixel, (9,), then f of `fit_ellipsoid` there and its slope along u."""
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

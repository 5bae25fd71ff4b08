"""What a frame tells of the errors of its normals: noise, lost relief, and a rig that is wrong.

- Noise of every kind (shot, read, quantisation, codec) turns normals at random. A surface's slopes (p, q)
  add up to 0 around a square, p along the rows and q along the columns; noise does not. Around the smallest
  squares that of single pixels shows. What squares of 4 pixels show beyond it is alike over several pixels,
  such as a codec's.
- An error ΔM of the rig or of the material's colour moves M⁻¹r from the unit sphere onto an ellipsoid,
  |M⁻¹r| ≈ 1 + nᵀE n with E the symmetric part of M⁻¹ΔM. The ellipsoid that fits the frame tells E, and E the
  turn of every normal, but for the rotation in M⁻¹ΔM, which leaves no trace. Of the turns, squared, those
  are taken away that a fit to so few independent samples has where E is 0. On a flat subject E02 and E12 are
  told well and turn its normals; the other entries are hardly told and hardly turn them. Near lamps,
  vignetting and wide highlights change the lengths slowly over the image: a quadratic of the place.
- Blur averages relief away: of a lens, of motion, of colours that were interpolated. What it has left of
  relief as wide as itself foretells what is lost; see `lost_detail`.

`expected_error` makes angles of these.
"""

import math
from typing import Any

import cv2
import numpy as np
from scipy import ndimage

from vntoolkit.arrays import Float32Array, FloatArray, Mask, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NOISE_CELL_PX
from vntoolkit.normals.lost_detail import LEAST_BLUR_PX, detail_left, lost_over_left, side_of_squares
from vntoolkit.photometry.frame import ALL_LIT, LinearFrame
from vntoolkit.photometry.response import LightResponse, scaled_normals_from_rgb
from vntoolkit.threads import one_blas_thread

SHORTEST, LONGEST = np.float32(1e-6), np.float32(1e18)  # lengths whose squares float32 holds
LEAST_FACING = np.float32(0.1)
_CELL = NOISE_CELL_PX  # noise changes slowly: one row of every cell tells it
_AROUND = np.array([0.5, 1.0, 1.0, 1.0, 0.5], np.float32)  # shares of the pixels of a side
_LOOP_PX = 2  # half a side of the larger squares: a codec's noise is alike over 4 pixels, its smallest blocks
# Standard deviations over a cell's median size. White noise of variance 1 adds up to 4 (1/4 + 3 + 1/4) around
# a square: the pixels at its corners count half. Of 16 squares that overlap the median, squared, is 1.166
# times that of many that do not.
_PER_MEDIAN = 1.4826 / math.sqrt(14.0 * 1.166)
_PER_SMALL = 1.4826 / math.sqrt(2.0 * 1.112)  # the same around squares of one pixel
_OF_ALIKE = 14.0 / 64.0  # of what is alike along a side of 4 pixels: 16 for each side, not 14 for all
_EDGE_PX = 4  # from the subject's edge, which blur mixes with what lies behind
_LEAST_LIGHT, _GRID_PIXELS = 0.3, 4000  # of the length that a fiftieth exceeds, over a grid of pixels
_SAMPLES = 1000
_MOST_PER_KNOWN = 20  # places of the grid that are looked at for a sample
_ROUNDS = 4
_WITHIN = 2.25  # spreads: a grazing tail pulls no more, and normal errors are used to five sixths
_GRID = 2.0**-16  # of log lengths that are fitted: finer than any bound, far coarser than their rounding
_ELLIPSOID_SPREAD = 0.05  # prior standard deviation of E's entries …
_FALLOFF_SPREAD = 0.1  # … and of the slow change of brightness over the image
_PRIOR = np.repeat([0.0, _ELLIPSOID_SPREAD**-2, _FALLOFF_SPREAD**-2], [1, 5, 5])
# E by its five entries e00, e11, e01, e02, e12, and their covariance where the nine of M⁻¹ΔM have variance 1.
_ENTRIES = np.zeros((5, 3, 3))
_ENTRIES[[0, 0, 1, 1], [0, 2, 1, 2], [0, 2, 1, 2]] = 1, -1, 1, -1
_ENTRIES[[2, 2, 3, 3, 4, 4], [0, 1, 0, 2, 1, 2], [1, 0, 2, 0, 2, 1]] = 1
_OF_EQUAL_ENTRIES = np.diag([2 / 3, 2 / 3, 1 / 2, 1 / 2, 1 / 2])
_OF_EQUAL_ENTRIES[[0, 1], [1, 0]] = -1 / 3
_INDEPENDENT = 100  # of the samples: neighbours share their errors


def evidence_of_frame(
    frame: LinearFrame,
    mask: Mask,
    labels: VisibilityLabels | None,
    response: LightResponse,
    camera: Camera | None,
    blur_px: float,
) -> tuple[Float32Array, Float32Array, Float32Array, FloatArray]:
    """Return noise, where it was seen, how far noise and lost relief turn normals, and the ellipsoid.

    response: one M. Noise: (⌈h/16⌉, ⌈w/16⌉), radians²; seen: the same, 0 where neighbours tell it. Turns:
    (h, w), radians². Ellipsoid: see `fit_ellipsoid`.
    """
    height, width = mask.shape
    cells = (-(-height // _CELL), -(-width // _CELL))
    least = _least_length(frame, mask, response)
    lit = mask if labels is None else mask & (labels == ALL_LIT)  # a shadow's normals belong to no surface
    found = _noise_of_cells(frame, lit, response, camera, least, cells)
    noise = _means_of_cells(found)
    known = int(found[1].sum()) * _CELL
    step = max(1, int(math.sqrt(max(known, mask.size // _MOST_PER_KNOWN) // _SAMPLES)))
    ellipsoid = fit_ellipsoid(_samples(frame, lit, response, least, step), (height, width))
    turns = noise
    if blur_px >= LEAST_BLUR_PX:
        side = side_of_squares(blur_px)
        left = detail_left(frame.rgb, lit & ~frame.clipped, response, ellipsoid[0], side)
        turns = noise + np.float32(lost_over_left(left, blur_px, side)) * _means_of_cells(left[:2])
    size = (_CELL * cells[1], _CELL * cells[0])
    turns = cv2.resize(turns, size, interpolation=cv2.INTER_LINEAR)[:height, :width]
    return noise, found[1], np.asarray(turns, np.float32), ellipsoid


def _least_length(frame: LinearFrame, mask: Mask, response: LightResponse) -> float:
    """Return the length of M⁻¹(r − a) below which a pixel is backdrop, hair, or another paint."""
    step = max(1, int(math.sqrt(mask.size // _GRID_PIXELS)))
    grid = (slice(step // 2, None, step),) * 2
    squares = _lit_squares(scaled_normals_from_rgb(frame.rgb[grid], response))[mask[grid]]
    ordered = np.sort(squares[squares > 0])
    if not ordered.size:
        return float(SHORTEST)
    brightest = math.sqrt(min(ordered[-1 - ordered.size // 50], LONGEST))
    return max(float(SHORTEST), _LEAST_LIGHT * brightest)


def _lit_squares(scaled: Float32Array) -> Float32Array:
    """Squared lengths of M⁻¹(r − a) (..., 3), 0 where it faces away."""
    return np.asarray(np.where(scaled[..., 2] < 0, np.square(scaled).sum(axis=-1), 0.0), np.float32)


def _samples(frame: LinearFrame, lit: Mask, response: LightResponse, least: float, step: int) -> FloatArray:
    """Return (5, n) M⁻¹(r − a) and the place u, v of the pixels of a grid that are lit all around."""
    h, w = lit.shape
    v, u = (each.ravel() for each in np.mgrid[step // 2 : h : step, step // 2 : w : step])
    inner = (v >= 2) & (u >= 2) & (v < h - 2) & (u < w - 2)
    v, u = v[inner], u[inner]
    v, u = v[lit[v, u]], u[lit[v, u]]
    sound, mean = np.ones(len(v), np.bool_), np.zeros((len(v), 3), np.float32)
    for far_v, far_u in ((-_EDGE_PX, 0), (_EDGE_PX, 0), (0, -_EDGE_PX), (0, _EDGE_PX)):
        beside = frame.rgb[np.clip(v + far_v, 0, h - 1), np.clip(u + far_u, 0, w - 1)]
        sound &= _lit_squares(scaled_normals_from_rgb(beside, response)) > least**2  # no backdrop
    for near_v in (v - 2, v, v + 2):  # a mean of nine has less noise
        for near_u in (u - 2, u, u + 2):
            rgb = frame.rgb[near_v, near_u]
            sound &= lit[near_v, near_u] & ~frame.clipped[near_v, near_u]
            sound &= _lit_squares(scaled_normals_from_rgb(rgb, response)) > least**2
            mean += rgb / np.float32(9)
    scaled = scaled_normals_from_rgb(mean, response)
    square = _lit_squares(scaled)
    sound &= (square > least**2) & (square < LONGEST)
    return np.vstack([scaled[sound].T, u[sound], v[sound]]).astype(np.float64)


def _noise_of_cells(
    frame: LinearFrame,
    lit: Mask,
    response: LightResponse,
    camera: Camera | None,
    least: float,
    cells: tuple[int, int],
) -> Float32Array:
    """Sum up variances of noise, radians², and their places, along the middle of cells: (2, ⌈h/16⌉, ⌈w/16⌉).

    They follow from the median circulations around squares of 4 pixels and of one. A turn by ε moves the
    slope by ε / cos² along the inclination and ε / cos across: a circulation counts by cos^1.5.
    """
    found, (h, w) = np.zeros((2, *cells), np.float32), lit.shape
    middle = np.minimum(np.arange(cells[0]) * _CELL + _CELL // 2 - 1, h - 1 - _LOOP_PX)
    if h <= 2 * _LOOP_PX or w <= 2 * _LOOP_PX:
        return found
    v = middle[:, None] + np.arange(-_LOOP_PX, _LOOP_PX + 1)
    n = np.moveaxis(scaled_normals_from_rgb(frame.rgb[v], response), -1, 0)
    length = np.sqrt(np.square(n).sum(axis=0))
    good = lit[v] & (length > least) & (length < LONGEST) & (n[2] < 0)
    towards = -n[2]
    if camera is not None and camera.is_perspective:
        inverse = np.linalg.inv(camera.matrix[:2, :2])
        x, y = np.moveaxis(
            (np.dstack(np.meshgrid(np.arange(w), v)) - camera.matrix[:2, 2]) @ inverse.T, -1, 0
        )
        towards = towards - (n[0] * x.reshape(*v.shape, w) + n[1] * y.reshape(*v.shape, w)).astype(np.float32)
    over = np.where(good, length, np.float32(1))
    facing = np.maximum(towards / over, LEAST_FACING)
    p, q = (n[:2] / (over * facing)) * good
    inner = slice(_LOOP_PX, w - _LOOP_PX)
    along = ndimage.correlate1d(p[:, -1] - p[:, 0], _AROUND, axis=1)[:, inner]
    down = np.tensordot(q, _AROUND, axes=(1, 0))
    large = along - (down[:, 2 * _LOOP_PX :] - down[:, : -2 * _LOOP_PX])
    along, down = p[:, _LOOP_PX + 1] - p[:, _LOOP_PX], q[:, _LOOP_PX + 1] + q[:, _LOOP_PX]
    small = 0.5 * (along[:, :-1] + along[:, 1:] - (down[:, 1:] - down[:, :-1]))[:, _LOOP_PX : 1 - _LOOP_PX]
    seen = np.lib.stride_tricks.sliding_window_view(good.all(axis=1), 2 * _LOOP_PX + 1, axis=1).all(axis=-1)
    medians = []
    for sizes in (large, small):
        padded = np.full((cells[0], cells[1] * _CELL), np.inf, np.float32)
        padded[:, inner] = np.where(seen, np.abs(sizes) * facing[:, _LOOP_PX, inner] ** 1.5, np.inf)
        ordered = np.sort(padded.reshape(*cells, _CELL), axis=2)
        count = np.isfinite(ordered).sum(axis=2)
        low, high = (np.maximum(at, 0)[..., None] // 2 for at in (count - 1, count))
        pair = np.take_along_axis(ordered, np.concatenate([low, high], axis=2), axis=2)
        medians.append(np.where(count > 0, pair.mean(axis=2), 0.0))
    single = np.square(_PER_SMALL * medians[1])
    alike = _OF_ALIKE * np.maximum(np.square(_PER_MEDIAN * medians[0]) - single, 0.0)
    found[0], found[1] = count * np.minimum(single + alike, 1.0), count
    return found


def _means_of_cells(found: Any) -> Any:
    """Return (h, w) means over 3×3 cells of sums and counts, (2, h, w), over 5×5 where those know nothing."""
    mean = np.zeros(found.shape[1:], np.float32)
    for side in (5, 3):
        total, count = (cv2.boxFilter(k, -1, (side, side), normalize=False, borderType=0) for k in found)
        known = count > 0.5  # sums of whole numbers that slide
        mean[known] = np.maximum(total[known], 0.0) / count[known]
    return mean


@one_blas_thread()
def fit_ellipsoid(samples: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Fit 1 / albedo, e00, e01, e02, e11, e12, e22 of |M⁻¹(r − a)| = albedo (1 + nᵀE n + f).

    Return them, (16,); the numbers of f, brightness that changes slowly over the image, by 1, u, v, u², v²,
    u v from the image's centre; the variance of the log lengths about that; the share of the turns by E,
    squared, that its own uncertainty does not explain; and the standard deviation of the nine entries of
    M⁻¹ΔM that makes such turns.

    Regress the log length of M⁻¹(r − a) on the normal's squares and on the place, robustly. samples: (5, n),
    M⁻¹(r − a) and the place u, v. shape: of the image.
    """
    found, count = np.zeros(16), samples.shape[1]
    lengths = np.sqrt((samples[:3] ** 2).sum(axis=0))
    logs = np.log(lengths)
    found[0] = np.exp(-np.median(logs)) if count else 1.0
    if count < 2 * _INDEPENDENT:
        return found
    x, y, z = n = samples[:3] / lengths
    half, middle, mean = max(shape) / 2, (np.array(shape[::-1]) - 1) / 2, samples[3:].mean(axis=1)
    s, t = (samples[3:] - mean[:, None]) / half
    falloff = np.stack([s, t, s * s, t * t, s * t])
    means = falloff.mean(axis=1)
    squares = [np.ones(count), x * x - z * z, y * y - z * z, 2 * x * y, 2 * x * z, 2 * y * z]
    design = np.vstack([*squares, falloff - means[:, None]])
    worth, spread = np.ones(count), max(logs.std(), 1e-3)
    for _ in range(_ROUNDS):
        weighted = design * (worth * (_INDEPENDENT / count / spread**2))
        information = weighted @ design.T + np.diag(_PRIOR)
        best = np.linalg.solve(information, weighted @ logs)
        left = np.abs(logs - best @ design)
        spread = 1.48 * np.median(left) + 1e-3
        worth = 1.0 / (1.0 + (left / (_WITHIN * spread)) ** 2) ** 2  # Geman and McClure's
    best = _rounded(best)  # sums in another order differ in the last bits
    e00, e11, e01, e02, e12 = best[1:6]
    found[:7] = np.exp(-best[0]), e00, e01, e02, e11, e12, -e00 - e11
    f, (s, t) = best[6:], (middle - mean) / half  # the picture's centre, from the samples' mean
    found[7] = f @ (np.array([s, t, s * s, t * t, s * t]) - means)
    found[8:10] = (f[0] + 2 * f[2] * s + f[4] * t) / half, (f[1] + 2 * f[3] * t + f[4] * s) / half
    found[10:13] = f[2:] / half**2
    found[13] = _rounded(spread) ** 2
    # what E's entries turn these normals by, squared: as they were found, and by their uncertainty alone
    parts = _ENTRIES @ n
    turns = np.einsum("jin,kin->jk", parts, parts) - design[1:6] @ design[1:6].T
    turned = best[1:6] @ turns @ best[1:6]
    established = max(turned - np.sum(turns * np.linalg.inv(information)[1:6, 1:6]), 0.0)
    found[14] = _rounded(established / max(turned, _GRID**2))
    found[15] = _rounded(math.sqrt(established / np.sum(turns * _OF_EQUAL_ENTRIES)))
    return found


def _rounded(values: Any) -> Any:
    return np.floor(np.asarray(values) / _GRID + 0.5) * _GRID

"""Relief that the camera has averaged away, foretold by what the same averaging takes from what is left.

A wave of slopes keeps the share a of its height in a blur of ½ px², as by weights ¼, ½, ¼. A second and a
third such blur take a (1 − a) and a² (1 − a) of what the picture has: their ratio is a, and a tells the
wave's length. A camera's blur of b px² kept a^(2b) of the wave, so that what the second blur takes, times
(a^(−2b) − 1) / (1 − a) / a, is what the camera took. Nothing of it is fitted to footage.

Noise turns normals in all directions alike, relief only along its slope: the curl of what a blur takes is
noise's alone, and tells how much of the rest is noise's too. Of a normal that leans away, the picture
foreshortens noise along the inclination, and with it the curl. The first blur's share is the noisiest and not
used.

Relief of one wavelength is foretold exactly. Of many, the short ones are lost first, and more is lost than
the ratio says: up to 4.8 times the variance where every octave holds as much. The mean of the two is taken.
"""

import math
from typing import Any

import numpy as np

from vntoolkit.geometry.maps import NOISE_CELL_PX
from vntoolkit.native import njit
from vntoolkit.normals.inversion import read_row
from vntoolkit.photometry.frame import ALL_LIT

LEAST_BLUR_PX = 0.3  # what a sharper picture loses is less than its other errors
_CELL = NOISE_CELL_PX
_SQUARES_A_BLUR, _MOST_SIDE = 0.75, 4  # squares hide noise, and leave the waves that two more blurs tell
_ROWS = 8  # of squares, which three blurs make two of
_BESIDE = 3  # squares that three blurs reach
_STEEPEST_STEP = np.float32(0.02)  # squared, radians²: an edge of a shadow or a fold is no relief
_DIMMEST, _BRIGHTEST = np.float32(0.5), np.float32(2.0)  # over the albedo: between backdrop and gloss
# Of equal noise in all pixels, what the second and the third blur take, over its squared curl.
_OF_NOISE = np.array([1.0212, 1.3276], np.float32)
_LEAST_SHARE, _MOST_SHARE = 0.3, 0.96  # of a wave that a blur keeps: 3 pixels, and 15
_OF_MANY_WAVES = 2.2  # the geometric mean of 1 and 4.8


def side_of_squares(blur_px: float) -> int:
    """Return the side in pixels of the squares whose normals are compared."""
    return min(max(round(_SQUARES_A_BLUR * blur_px), 1), _MOST_SIDE)


def lost_over_left(found: Any, blur_px: float, side: int) -> float:
    """Return the variance that blur has taken from a slope, over what `detail_kernel` finds left.

    found: of a whole frame, as `detail_kernel` fills it.
    """
    left, after = float(found[0].sum(dtype=np.float64)), float(found[2].sum(dtype=np.float64))
    if left <= 0.0:
        return 0.0
    share = math.sqrt(min(max(after / left, _LEAST_SHARE**2), _MOST_SHARE**2))
    taken = (share ** (-2.0 * (blur_px / side) ** 2) - 1.0) / (1.0 - share) / share
    return _OF_MANY_WAVES * 0.5 * taken**2  # of one of two directions


@njit
def detail_kernel(
    image: Any, clipped: Any, mask: Any, labels: Any, inverse: Any, ambient: Any, inverse_albedo: Any,
    side: int, found: Any,
) -> None:  # fmt: skip
    """Sum up what the second and the third blur take from normals, squared, without noise's part, radians².

    found: (3, ⌈h/16⌉, ⌈w/16⌉): the second's sums, how many there are, the third's sums.
    """
    height = len(mask)
    for cell in range(found.shape[1]):
        found[:, cell] = np.float32(0.0)
        top = cell * _CELL + (_CELL - _ROWS * side) // 2
        if cell % 2 == 0 and top >= 0 and top + _ROWS * side <= height:  # neighbours tell the others
            _detail_row(
                image, clipped, mask, labels, inverse, ambient, inverse_albedo, side, top, found[:, cell]
            )  # fmt: skip


@njit
def _detail_row(
    image: Any, clipped: Any, mask: Any, labels: Any, inverse: Any, ambient: Any, inverse_albedo: Any,
    side: int, top: int, found: Any,
) -> None:  # fmt: skip
    width = mask.shape[1]
    squares, zero = width // side, np.float32(0.0)
    inner = squares - 2 * _BESIDE - 1
    if inner < 1:
        return
    normals, sound = np.zeros((_ROWS, 3, width), np.float32), np.ones(squares, np.float32)
    for k in range(_ROWS):
        _squares_row(
            image, clipped, mask, labels, inverse, ambient, inverse_albedo, side, top + k * side, normals[k],
            sound,
        )  # fmt: skip
    near = np.ones(inner, np.float32)
    for k in range(2 * _BESIDE + 2):
        shifted = sound[k : k + inner]
        for i in range(inner):
            near[i] *= shifted[i]
    # what one, two, three blurs make of the two rows in the middle
    blurred = np.empty((3, 2, 3, squares), np.float32)
    for times in range(3):
        rows = _ROWS - 2 * (times + 1)
        for k in range(rows):  # in place: a row is not needed any more when it is overwritten
            for axis in range(3):
                _smooth(normals[k, axis], normals[k + 1, axis], normals[k + 2, axis], squares)
        for k in range(2):
            for axis in range(3):
                to, of_row = blurred[times, k, axis], normals[rows // 2 - 1 + k, axis]
                for i in range(squares):
                    to[i] = of_row[i]
                for _ in range(times + 1):
                    _smooth_along(to)
    p, q = np.empty((2, 2, squares), np.float32), np.empty((2, 2, squares), np.float32)
    square = np.empty((2, 2, squares), np.float32)
    for level in range(2):
        for k in range(2):
            _taken(blurred[level, k], blurred[level + 1, k], p[level, k], q[level, k], square[level, k])
    first = _BESIDE + 1
    taken, of_tilt = np.empty((2, inner), np.float32), np.empty(inner, np.float32)
    x, y, z = blurred[0, 0, 0], blurred[0, 0, 1], blurred[0, 0, 2]
    for i in range(inner):
        at, one = i + _BESIDE, np.float32(1.0)
        facing = z[at] * z[at] / (x[at] * x[at] + y[at] * y[at] + z[at] * z[at] + np.float32(1e-9))
        of_tilt[i] = (one + facing) / (one + facing * facing)
    for level in range(2):
        up, down, p_up, p_down = square[level, 0], square[level, 1], p[level, 0], p[level, 1]
        q_up, q_down, to, of_noise = q[level, 0], q[level, 1], taken[level], _OF_NOISE[level]
        for i in range(inner):
            at, beside = i + _BESIDE, i + first
            total = up[at] + up[beside] + down[at] + down[beside]
            near[i] = near[i] if total < np.float32(4.0) * _STEEPEST_STEP else zero
            curl = p_down[at] + p_down[beside] - p_up[at] - p_up[beside]
            curl -= q_up[beside] + q_down[beside] - q_up[at] - q_down[at]
            to[i] = np.float32(0.25) * (total - of_noise * of_tilt[i] * curl * curl)
    for i in range(inner):
        into = min(((i + first) * side) // _CELL, found.shape[1] - 1)
        found[0, into] += near[i] * taken[0, i]
        found[1, into] += near[i]
        found[2, into] += near[i] * taken[1, i]


@njit
def _taken(before: Any, after: Any, p: Any, q: Any, square: Any) -> None:
    """Fill what a blur takes from normals (3, n), across them: along u, along v, and all of it squared."""
    x, y, z = before[0], before[1], before[2]
    x_after, y_after, z_after = after[0], after[1], after[2]
    least = np.float32(1e-9)
    for i in range(len(p)):
        a, b, c = x_after[i] - x[i], y_after[i] - y[i], z_after[i] - z[i]
        along = (a * x[i] + b * y[i] + c * z[i]) / (x[i] * x[i] + y[i] * y[i] + z[i] * z[i] + least)
        a, b, c = a - along * x[i], b - along * y[i], c - along * z[i]
        p[i], q[i], square[i] = a, b, a * a + b * b + c * c


@njit
def _smooth(above: Any, here: Any, below: Any, count: int) -> None:
    """Put ¼, ½, ¼ of three rows into the first."""
    quarter, half = np.float32(0.25), np.float32(0.5)
    for i in range(count):
        above[i] = quarter * (above[i] + below[i]) + half * here[i]


@njit
def _smooth_along(row: Any) -> None:
    """Put ¼, ½, ¼ of three neighbours into the one in the middle; the ends stay."""
    quarter, half = np.float32(0.25), np.float32(0.5)
    source = row.copy()
    inner = len(row) - 2
    before, middle, after, to = source[:inner], source[1 : inner + 1], source[2:], row[1 : inner + 1]
    for i in range(inner):
        to[i] = quarter * (before[i] + after[i]) + half * middle[i]


@njit
def _squares_row(
    image: Any, clipped: Any, mask: Any, labels: Any, inverse: Any, ambient: Any, inverse_albedo: Any,
    side: int, top: int, normals: Any, sound: Any,
) -> None:  # fmt: skip
    """Fill the normals of a row of squares, (3, w), and put 0 where not all of a square is lit subject."""
    width, zero, one = mask.shape[1], np.float32(0.0), np.float32(1.0)
    x, y, z = normals[0], normals[1], normals[2]
    r, g, b = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    good = np.ones(width, np.float32)
    for v in range(top, top + side):
        read_row(image[v], r, g, b)
        inside = mask[v]
        for u in range(width):
            good[u] = good[u] if inside[u] & (not clipped[v, u]) else zero
        if labels is not None:
            for u in range(width):
                good[u] = good[u] if labels[v, u] == ALL_LIT else zero
        for u in range(width):
            x[u] += r[u]
            y[u] += g[u]
            z[u] += b[u]
    squares = width // side
    if side > 1:
        share = one / np.float32(side * side)
        for i in range(squares):
            red, green, blue, all_good = zero, zero, zero, one
            for u in range(i * side, (i + 1) * side):
                red, green, blue, all_good = red + x[u], green + y[u], blue + z[u], all_good * good[u]
            x[i], y[i], z[i], good[i] = red * share, green * share, blue * share, all_good
    i00, i01, i02 = inverse[0, 0], inverse[0, 1], inverse[0, 2]
    i10, i11, i12 = inverse[1, 0], inverse[1, 1], inverse[1, 2]
    i20, i21, i22 = inverse[2, 0], inverse[2, 1], inverse[2, 2]
    a0, a1, a2 = ambient[0], ambient[1], ambient[2]
    for i in range(squares):
        red, green, blue = x[i] - a0, y[i] - a1, z[i] - a2
        n0 = (i00 * red + i01 * green + i02 * blue) * inverse_albedo
        n1 = (i10 * red + i11 * green + i12 * blue) * inverse_albedo
        n2 = (i20 * red + i21 * green + i22 * blue) * inverse_albedo
        square = n0 * n0 + n1 * n1 + n2 * n2
        kept = (square > _DIMMEST * _DIMMEST) & (square < _BRIGHTEST * _BRIGHTEST) & (n2 < zero)
        x[i], y[i], z[i] = n0, n1, n2
        sound[i] = sound[i] * good[i] if kept else zero

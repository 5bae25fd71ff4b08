"""Light between the samples of a Bayer pattern, of which each pixel measures one colour.

The camera interpolates the other two, and takes their detail from the strongest. That is right where all
colours step alike: in the light, and not in what coloured yarn returns of it, less still across a seam. So
what was measured is divided by its reflectance first and then interpolated again. Where red was measured is
seen in the picture: what was interpolated follows from what is around, but for rounding (popescu2005).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from vntoolkit.arrays import FloatArray, LinearImage, Mask
from vntoolkit.native import njit

REACH_PX = 2  # of the interpolation
# By what the pattern blurs beyond the lens, in pixel² along an axis: samples that are averaged are 0 or 1
# away. Red and blue: 0, 1, 0 and 1 in the four places of the pattern, green: 0, 1/2, 1/2, 0; the mean.
_OF_INTERPOLATION = (1 / 2 + 1 / 2 + 1 / 4) / 3
_JUDGED = 1000  # pixels of each place in the pattern
_LEFT = 0.9  # of what the next best pattern leaves: ratios of variances of 8000 residuals scatter by 0.02
_RIDGE = 1e-9  # a picture without noise has no more than rounding in its window
_LEAST = 100  # pixels that tell 25 weights of an interpolation
_WINDOW = [(i, j) for i in range(-REACH_PX, REACH_PX + 1) for j in range(-REACH_PX, REACH_PX + 1)]
_HALF, _TWO, _FOUR, _FIVE, _SIX = (np.float32(n) for n in (0.5, 2.0, 4.0, 5.0, 6.0))
_EIGHTH, _THREE_HALVES = np.float32(0.125), np.float32(1.5)


def red_of_mosaic(rgb: LinearImage, mask: Mask) -> tuple[int, int] | None:
    """Return the row and the column, 0 or 1, in which red was measured first; None where nothing tells it.

    rgb: (h, w, 3). mask: (h, w), without clipped pixels. Each of the four patterns that there are is
    judged by how well what it has interpolated follows from what it has measured, by a linear rule.
    """
    inner = mask[REACH_PX:-REACH_PX, REACH_PX:-REACH_PX]
    places, windows = [(row, column) for row in (0, 1) for column in (0, 1)], []
    for row, column in places:
        v, u = np.nonzero(inner[row::2, column::2])
        if len(v) < _LEAST:
            return None
        chosen = slice(None, None, max(1, len(v) // _JUDGED))
        v, u = 2 * v[chosen] + row + REACH_PX, 2 * u[chosen] + column + REACH_PX
        windows.append(np.stack([rgb[v + i, u + j] for i, j in _WINDOW], axis=1).astype(np.float64))
    left = [sum(map(partial(_left_over, red=red), windows, places)) for red in places]
    best, second = np.argsort(left)[:2]
    return places[best] if left[best] < _LEFT * left[second] else None


def _left_over(window: FloatArray, place: tuple[int, int], red: tuple[int, int]) -> float:
    """Return the variance of what was interpolated, beyond a linear rule on what was measured around.

    window: (n, 25, 3), colours around pixels of a place in the pattern.
    """
    colours = [(place[0] + i + red[0]) % 2 + (place[1] + j + red[1]) % 2 for i, j in _WINDOW]
    measured = window[:, range(len(_WINDOW)), colours]
    middle = len(_WINDOW) // 2
    others = window[:, middle, [k for k in range(3) if k != colours[middle]]]
    matrix = measured.T @ measured
    matrix += _RIDGE * np.trace(matrix) * np.eye(len(matrix))
    rest = others - measured @ np.linalg.solve(matrix, measured.T @ others)
    return float((rest**2).mean())


def blur_of_lens_px(blur_px: float) -> float:
    """Standard deviation of the lens's blur, from that of a picture whose colours were interpolated."""
    return float(np.sqrt(max(blur_px**2 - _OF_INTERPOLATION, 0.0)))


@njit(cache=True, fastmath=True, error_model="numpy")
def take_measured(light: Any, n: int, merge: Any, colour: int, odd: int, out: Any) -> None:
    """Fill out with what each pixel of a row measured, of light (3 · n,) of the lamps.

    merge: (3, 3), light to colour. colour: the row's own, 0 or 2, measured by every second pixel; those
    between measured green. odd: 1 where the first pixel measured green, else 0.
    """
    m0, m1, m2 = merge[colour]
    g0, g1, g2 = merge[1]
    for j in range(len(out)):
        x, y, z = light[j], light[n + j], light[2 * n + j]
        out[j] = m0 * x + m1 * y + m2 * z if (j + odd) & 1 == 0 else g0 * x + g1 * y + g2 * z


@njit(cache=True, fastmath=True, error_model="numpy")
def interpolate(
    rows: Any, v: int, begin: int, split: Any, colour: int, odd: int, first: int, last: int, n: int, out: Any
) -> None:
    """Fill out (3 · n,) with light of the lamps, of part of the middle of five rows (malvar2004).

    rows: (5, REACH_PX + columns + REACH_PX) of `take_measured`, row v at v % 5. begin: column at which out
    begins. first, last: pixels of out, the last one not done. split: (3, 3), colour to light.
    """
    start, end = begin + first, begin + last + 2 * REACH_PX
    a, b, c = rows[(v - 2) % 5, start:end], rows[(v - 1) % 5, start:end], rows[v % 5, start:end]
    d, e = rows[(v + 1) % 5, start:end], rows[(v + 2) % 5, start:end]
    o0, o1, o2 = split[0, colour], split[1, colour], split[2, colour]
    g0, g1, g2 = split[0, 1], split[1, 1], split[2, 1]
    p0, p1, p2 = split[0, 2 - colour], split[1, 2 - colour], split[2, 2 - colour]
    light0, light1, light2 = out[first:last], out[n + first : n + last], out[2 * n + first : 2 * n + last]
    for j in range(len(light0)):
        here, near_row, near_column = c[j + 2], c[j + 1] + c[j + 3], b[j + 2] + d[j + 2]
        far_row, far_column = c[j] + c[j + 4], a[j + 2] + e[j + 2]
        corners = b[j + 1] + b[j + 3] + d[j + 1] + d[j + 3]
        green = _FOUR * here + _TWO * (near_row + near_column) - far_row - far_column
        across = _SIX * here + _TWO * corners - _THREE_HALVES * (far_row + far_column)
        along = _FIVE * here + _FOUR * near_row - far_row - corners + _HALF * far_column
        down = _FIVE * here + _FOUR * near_column - far_column - corners + _HALF * far_row
        is_own = (j + first + odd) & 1 == 0
        own = here if is_own else _EIGHTH * along
        green = _EIGHTH * green if is_own else here
        other = _EIGHTH * (across if is_own else down)
        light0[j] = o0 * own + g0 * green + p0 * other
        light1[j] = o1 * own + g1 * green + p1 * other
        light2[j] = o2 * own + g2 * green + p2 * other

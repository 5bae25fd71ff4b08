"""Relief that blur has averaged away, foretold by the relief that it has left.

A blur of standard deviation b leaves exp(−b²k²/2) of a wave of slopes with k radians a pixel. Little tells at
a place how much is missing: |M⁻¹r| falls by the square of it only, on even relief alike everywhere. But the
spectrum of relief has no sharp end. Beside the waves that are lost are waves that blur has only weakened. How
far the normals of squares as wide as the blur depart from the mean of their neighbours' is their variance;
times (b / side)⁴, as the square of b²k²/2, it foretells the variance of what is lost.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from vntoolkit.geometry.maps import NOISE_CELL_PX
from vntoolkit.native import njit
from vntoolkit.normals.inversion import read_row
from vntoolkit.photometry.frame import ALL_LIT
from vntoolkit.photometry.levelling import FLAGS, map_row

_CELL = NOISE_CELL_PX
_NARROWEST, _WIDEST = 2, 5  # pixels of a square: one shows noise, and three times five lie in a row of cells
_MOST = np.float32(0.1)  # of a squared difference, radians²: an edge of a shadow or a fold is no relief
_DIMMEST, _BRIGHTEST = np.float32(0.5), np.float32(2.0)  # over the albedo: between backdrop and gloss
# What noise of variance 1 on two components makes of the differences: 2 directions, 1 + 2 (1/2)² squares.
NOISE_IN_DIFFERENCES = 6.0


def side_of_squares(blur_px: float) -> int:
    """Return the side in pixels of the squares whose normals are compared."""
    return int(np.clip(round(blur_px), _NARROWEST, _WIDEST))


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def detail_kernel(
    image: Any, table: Any, clipped: Any, white: Any, maps: Any, mask: Any, labels: Any, inverse: Any,
    ambient: Any, inverse_albedo: Any, side: int, found: Any,
) -> None:  # fmt: skip
    """Sum up how far the normals of squares depart from the mean of their neighbours, squared, radians².

    Along rows and along columns together. found: (2, ⌈h/16⌉, ⌈w/16⌉), the sums and how many there are.
    """
    height = len(mask)
    for cell in prange(found.shape[1]):
        found[:, cell] = np.float32(0.0)
        top = cell * _CELL + (_CELL - 3 * side) // 2
        if top >= 0 and top + 3 * side <= height:
            _detail_row(
                image, table, clipped, white, maps, mask, labels, inverse, ambient, inverse_albedo, side,
                top, found[0, cell], found[1, cell],
            )  # fmt: skip


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _detail_row(
    image: Any, table: Any, clipped: Any, white: Any, maps: Any, mask: Any, labels: Any, inverse: Any,
    ambient: Any, inverse_albedo: Any, side: int, top: int, sums: Any, counts: Any,
) -> None:  # fmt: skip
    width, zero, half = mask.shape[1], np.float32(0.0), np.float32(0.5)
    # one array each, whose slices have no stride: eight pixels at a time
    x, y, z = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.float32)
    x_up, y_up, z_up = np.zeros(width, np.float32), np.zeros(width, np.float32), np.zeros(width, np.float32)
    x_down, y_down, z_down = (
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
    )
    good, good_up, good_down = (
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
        np.zeros(width, np.float32),
    )
    for k, to_x, to_y, to_z, to_good in (
        (0, x_up, y_up, z_up, good_up), (1, x, y, z, good), (2, x_down, y_down, z_down, good_down),
    ):  # fmt: skip
        _squares_row(
            image, table, clipped, white, maps, mask, labels, inverse, ambient, inverse_albedo, side,
            top + k * side, to_x, to_y, to_z, to_good,
        )  # fmt: skip
    inner = width // side - 2
    if inner < 1:
        return
    found, places = np.empty(inner, np.float32), np.empty(inner, np.float32)
    good_left, good_right, good_here = good[:inner], good[2:], good[1 : inner + 1]
    up_here, down_here = good_up[1 : inner + 1], good_down[1 : inner + 1]
    for i in range(inner):
        places[i] = good_here[i] * good_left[i] * good_right[i] * up_here[i] * down_here[i]
        found[i] = zero
    for here, above, below in ((x, x_up, x_down), (y, y_up, y_down), (z, z_up, z_down)):
        left, right, middle = here[:inner], here[2:], here[1 : inner + 1]
        over, under = above[1 : inner + 1], below[1 : inner + 1]
        for i in range(inner):
            along = middle[i] - half * (left[i] + right[i])
            across = middle[i] - half * (over[i] + under[i])
            found[i] += along * along + across * across
    for i in range(inner):
        into = min(((i + 1) * side + side // 2) // _CELL, len(sums) - 1)
        sums[into] += places[i] * min(found[i], _MOST)
        counts[into] += places[i]


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _squares_row(
    image: Any, table: Any, clipped: Any, white: Any, maps: Any, mask: Any, labels: Any, inverse: Any,
    ambient: Any, inverse_albedo: Any, side: int, top: int, x: Any, y: Any, z: Any, good: Any,
) -> None:  # fmt: skip
    """Fill the unit normals of a row of squares, and 1 where all of a square is lit and of the subject."""
    width, zero, one = mask.shape[1], np.float32(0.0), np.float32(1.0)
    r, g, b = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
    sound = np.ones(width, np.float32)
    for v in range(top, top + side):
        read_row(image[v], table, r, g, b)
        inside = mask[v]
        for u in range(width):
            if clipped is None:
                largest = max(r[u], g[u])  # of two at a time: numba makes SIMD of that
                kept = inside[u] & (max(largest, b[u]) < white)
            else:
                kept = inside[u] & (not clipped[v, u])
            sound[u] = sound[u] if kept else zero
        if labels is not None:
            for u in range(width):
                sound[u] = sound[u] if labels[v, u] == ALL_LIT else zero
        if maps is not None:
            map_row(maps, np.int64(v), 0, r, g, b)
        for u in range(width):
            x[u] += r[u]
            y[u] += g[u]
            z[u] += b[u]
    squares = width // side
    share = one / np.float32(side * side)
    for i in range(squares):
        red, green, blue, all_sound = zero, zero, zero, one
        for u in range(i * side, (i + 1) * side):
            red, green, blue, all_sound = red + x[u], green + y[u], blue + z[u], all_sound * sound[u]
        x[i], y[i], z[i], sound[i] = red, green, blue, all_sound
    i00, i01, i02 = inverse[0, 0], inverse[0, 1], inverse[0, 2]
    i10, i11, i12 = inverse[1, 0], inverse[1, 1], inverse[1, 2]
    i20, i21, i22 = inverse[2, 0], inverse[2, 1], inverse[2, 2]
    a0, a1, a2 = ambient[0], ambient[1], ambient[2]
    dimmest, brightest = _DIMMEST / inverse_albedo, _BRIGHTEST / inverse_albedo
    for i in range(squares):
        red, green, blue = x[i] * share - a0, y[i] * share - a1, z[i] * share - a2
        n0 = i00 * red + i01 * green + i02 * blue
        n1 = i10 * red + i11 * green + i12 * blue
        n2 = i20 * red + i21 * green + i22 * blue
        length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
        kept = (length > dimmest) & (length < brightest) & (n2 < zero)
        scale = one / length if kept else zero
        x[i], y[i], z[i] = n0 * scale, n1 * scale, n2 * scale
        good[i] = sound[i] if kept else zero

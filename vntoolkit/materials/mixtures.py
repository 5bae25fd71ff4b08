"""Mixtures of materials beside seams, which lens and Bayer pattern blur.

Light adds, so that the map of reflectances is blurred as the picture. Loops go over a chunk of a row, many
pixels at a time: their arrays are parts, at fixed places, of one array in single precision.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.native import njit

CHUNK_PX = 32
MOST_REACH_PX = 3  # to either side, over which a seam is blurred
_REACH_OF_BLUR = 2.5  # standard deviations
_WIDE = 48  # at least CHUNK_PX + 2 MOST_REACH_PX
_WINDOW = _WIDE * (2 * MOST_REACH_PX + 1)
_UNSURE = np.float32(0.3)  # standard deviation of a pixel's share, over the root of both shares' product
_LEAST_SHARE = np.float32(0.01)
_NONE, _ONE, _TINY = np.float32(0.0), np.float32(1.0), np.float32(1e-12)
# Places in the array that a chunk works in: means and contributions of the lamps, three rows each, both
# largest shares, and the reflectances that these are of.
_MEAN, _LIGHT, _FIRST, _SECOND, _OWN, _OTHER, _ROOM = (CHUNK_PX * row for row in (0, 3, 6, 7, 8, 11, 14))


def reach_of_blur(blur_px: float) -> int:
    """Pixels to either side that a blur takes light from, but for a hundredth."""
    return min(max(1, int(np.ceil(_REACH_OF_BLUR * blur_px))), MOST_REACH_PX)


def blur_weights(blur_px: float, reach: int = MOST_REACH_PX) -> FloatArray:
    """(n,), weights of a blur over the pixels of a window, `reach` to either side."""
    places = np.arange(-reach, reach + 1)
    found = np.exp(-0.5 * (places / max(blur_px, 1e-3)) ** 2)
    return np.asarray(found / found.sum())


def wide_weights(weights: FloatArray) -> tuple[np.float32, ...]:
    """Return weights of a blur over 2 MOST_REACH_PX + 1 pixels, 0 beyond its own reach."""
    found = np.pad(weights, MOST_REACH_PX - len(weights) // 2)
    return tuple(np.float32(weight) for weight in found)


@njit(cache=True)
def room_for(count: int) -> Any:
    """Return the arrays that a chunk of so many materials works in: shares (m, CHUNK_PX), and others."""
    return (
        np.zeros((count, CHUNK_PX), np.float32), np.zeros(_ROOM, np.float32),
        np.zeros(_WINDOW, np.float32), np.zeros(_WIDE, np.float32),
    )  # fmt: skip


@njit(cache=True, fastmath=True, error_model="numpy")
def fill_means(labels: Any, v: int, u: int, weights: Any, rho: Any, room: Any) -> int:
    """Fill shares and mean reflectances under the blur of CHUNK_PX pixels of row v from u on.

    weights: of `wide_weights`. room: of `room_for`; the means are at the beginning of its second array,
    (3 · CHUNK_PX,). Returns the labels that are there, bit m for label m; the shares of others are not
    filled.
    """
    shares, work, window, columns = room
    h, w = labels.shape
    left = u - MOST_REACH_PX
    for a in range(2 * MOST_REACH_PX + 1):
        row, line = labels[min(max(v + a - MOST_REACH_PX, 0), h - 1)], window[a * _WIDE : (a + 1) * _WIDE]
        if left >= 0 and left + _WIDE <= w:
            part = row[left : left + _WIDE]
            for j in range(len(line)):
                line[j] = part[j]
        else:
            for j in range(_WIDE):
                line[j] = row[min(max(left + j, 0), w - 1)]
    for j in range(3 * CHUNK_PX):
        work[j] = _NONE
    there = _labels_in(window)
    for m in range(len(rho)):
        if (there >> m) & 1:
            _blur_columns(window, np.float32(m), weights, columns)
            _blur_row(columns, weights, shares[m])
            _add(shares[m], rho[m, 0], rho[m, 1], rho[m, 2], work)
    return there


@njit(cache=True)
def _labels_in(window: Any) -> int:
    """Return the labels of a window, bit m for label m."""
    found = 0
    for j in range(_WINDOW):
        found |= 1 << int(window[j])
    return found


@njit(cache=True, fastmath=True, error_model="numpy")
def _blur_columns(window: Any, number: Any, weights: Any, columns: Any) -> None:
    w0, w1, w2, w3, w4, w5, w6 = weights
    for j in range(_WIDE):
        total = w0 if window[j] == number else _NONE
        total += w1 if window[_WIDE + j] == number else _NONE
        total += w2 if window[2 * _WIDE + j] == number else _NONE
        total += w3 if window[3 * _WIDE + j] == number else _NONE
        total += w4 if window[4 * _WIDE + j] == number else _NONE
        total += w5 if window[5 * _WIDE + j] == number else _NONE
        total += w6 if window[6 * _WIDE + j] == number else _NONE
        columns[j] = total


@njit(cache=True, fastmath=True, error_model="numpy")
def _blur_row(columns: Any, weights: Any, share: Any) -> None:
    w0, w1, w2, w3, w4, w5, w6 = weights
    for j in range(CHUNK_PX):
        total = w0 * columns[j] + w1 * columns[1 + j] + w2 * columns[2 + j] + w3 * columns[3 + j]
        share[j] = total + w4 * columns[4 + j] + w5 * columns[5 + j] + w6 * columns[6 + j]


@njit(cache=True, fastmath=True, error_model="numpy")
def _add(share: Any, rho0: Any, rho1: Any, rho2: Any, work: Any) -> None:
    for j in range(CHUNK_PX):
        work[j] += share[j] * rho0
        work[CHUNK_PX + j] += share[j] * rho1
        work[2 * CHUNK_PX + j] += share[j] * rho2


@njit(cache=True, fastmath=True, error_model="numpy")
def relight_mixtures(
    rgb: Any, labels: Any, v: int, u: int, near: Any, rho: Any, haze: Any, inverse: Any, split: Any,
    merge: Any, weights: Any, tolerance: Any, room: Any, out: Any,
) -> None:  # fmt: skip
    """Fill out (w, 3) where `near` (w,) among CHUNK_PX pixels of row v from u on: see `pixels.relit`."""
    there = fill_means(labels, v, u, weights, rho, room)
    shares, work, _, _ = room
    _fill_largest(shares, there, rho, work)
    stop = min(len(rgb) - u, CHUNK_PX)
    for j in range(stop):
        r, g, b = rgb[u + j, 0], rgb[u + j, 1], rgb[u + j, 2]
        for k in range(3):
            work[_LIGHT + CHUNK_PX * k + j] = split[k, 0] * r + split[k, 1] * g + split[k, 2] * b
    _shift(haze, inverse, tolerance, work)
    for j in range(stop):
        if near[u + j]:
            x, y, z = work[_LIGHT + j], work[_LIGHT + CHUNK_PX + j], work[_LIGHT + 2 * CHUNK_PX + j]
            for c in range(3):
                out[u + j, c] = merge[c, 0] * x + merge[c, 1] * y + merge[c, 2] * z


@njit(cache=True, fastmath=True, error_model="numpy")
def _fill_largest(shares: Any, there: int, rho: Any, work: Any) -> None:
    """Fill the largest and the second largest share, and the reflectances of the two; there: the labels."""
    for j in range(_FIRST, _ROOM):
        work[j] = _NONE
    for m in range(len(rho)):
        if (there >> m) & 1:
            _take_larger(shares[m], rho[m, 0], rho[m, 1], rho[m, 2], work)


@njit(cache=True, fastmath=True, error_model="numpy")
def _take_larger(share: Any, rho0: Any, rho1: Any, rho2: Any, work: Any) -> None:
    for j in range(CHUNK_PX):
        s, first, second = share[j], work[_FIRST + j], work[_SECOND + j]
        is_first, is_second = s > first, s > second
        own, other = work[_OWN + j], work[_OTHER + j]
        work[_OTHER + j] = own if is_first else (rho0 if is_second else other)
        work[_OWN + j] = rho0 if is_first else own
        own, other = work[_OWN + CHUNK_PX + j], work[_OTHER + CHUNK_PX + j]
        work[_OTHER + CHUNK_PX + j] = own if is_first else (rho1 if is_second else other)
        work[_OWN + CHUNK_PX + j] = rho1 if is_first else own
        own, other = work[_OWN + 2 * CHUNK_PX + j], work[_OTHER + 2 * CHUNK_PX + j]
        work[_OTHER + 2 * CHUNK_PX + j] = own if is_first else (rho2 if is_second else other)
        work[_OWN + 2 * CHUNK_PX + j] = rho2 if is_first else own
        work[_SECOND + j] = max(min(s, first), second)
        work[_FIRST + j] = max(s, first)


@njit(cache=True, fastmath=True, error_model="numpy")
def _shift(haze: Any, inverse: Any, tolerance: Any, work: Any) -> None:
    """Divide contributions by mean reflectances, which change along the line of the two materials mixed
    most, towards a normal of unit length.

    Where a seam runs is known to a part of a pixel. So the shares are uncertain, and the length, itself
    uncertain, corrects them (Gauss and Newton, twice).
    """
    matrix = (
        inverse[0, 0], inverse[0, 1], inverse[0, 2], inverse[1, 0], inverse[1, 1], inverse[1, 2],
        inverse[2, 0], inverse[2, 1], inverse[2, 2],
    )  # fmt: skip
    haze_ = (haze[0], haze[1], haze[2])
    for j in range(CHUNK_PX):
        s0, s1, s2 = work[_LIGHT + j], work[_LIGHT + CHUNK_PX + j], work[_LIGHT + 2 * CHUNK_PX + j]
        m0, m1, m2 = work[_MEAN + j], work[_MEAN + CHUNK_PX + j], work[_MEAN + 2 * CHUNK_PX + j]
        d0 = work[_OTHER + j] - work[_OWN + j]
        d1 = work[_OTHER + CHUNK_PX + j] - work[_OWN + CHUNK_PX + j]
        d2 = work[_OTHER + 2 * CHUNK_PX + j] - work[_OWN + 2 * CHUNK_PX + j]
        first, second = work[_FIRST + j], work[_SECOND + j]
        is_mixed = second >= _LEAST_SHARE
        ratio = tolerance / max(_UNSURE * _UNSURE * first * second, _TINY)
        light, mean, step = (s0, s1, s2), (m0, m1, m2), (d0, d1, d2)
        moved = _moved(_NONE, light, mean, step, matrix, haze_, first, second, ratio)
        moved = _moved(moved, light, mean, step, matrix, haze_, first, second, ratio)
        moved = moved if is_mixed else _NONE
        work[_LIGHT + j] = s0 / (m0 + moved * d0)
        work[_LIGHT + CHUNK_PX + j] = s1 / (m1 + moved * d1)
        work[_LIGHT + 2 * CHUNK_PX + j] = s2 / (m2 + moved * d2)


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _moved(
    moved: Any, s: Any, mean: Any, d: Any, inverse: Any, haze: Any, first: Any, second: Any, ratio: Any
) -> Any:
    """Return how far along d a mean reflectance is moved, from what was found before; tuples throughout."""
    q0 = _ONE / (mean[0] + moved * d[0])
    q1 = _ONE / (mean[1] + moved * d[1])
    q2 = _ONE / (mean[2] + moved * d[2])
    y0, y1, y2 = s[0] * q0, s[1] * q1, s[2] * q2
    x0, x1, x2 = y0 - haze[0], y1 - haze[1], y2 - haze[2]
    n0 = inverse[0] * x0 + inverse[1] * x1 + inverse[2] * x2
    n1 = inverse[3] * x0 + inverse[4] * x1 + inverse[5] * x2
    n2 = inverse[6] * x0 + inverse[7] * x1 + inverse[8] * x2
    length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY
    slope = (n0 * inverse[0] + n1 * inverse[3] + n2 * inverse[6]) * y0 * d[0] * q0
    slope += (n0 * inverse[1] + n1 * inverse[4] + n2 * inverse[7]) * y1 * d[1] * q1
    slope += (n0 * inverse[2] + n1 * inverse[5] + n2 * inverse[8]) * y2 * d[2] * q2
    slope /= -length
    found = slope * (slope * moved - length + _ONE) / (slope * slope + ratio)
    return min(max(found, -second), first)

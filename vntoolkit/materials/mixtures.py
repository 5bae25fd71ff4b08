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
_NONE, _ONE = np.float32(0.0), np.float32(1.0)
# Places in the array that a chunk works in: means and contributions of the lamps, three rows each, both
# largest shares, and the reflectances that these are of.
_LIGHT, _FIRST, _SECOND, _OWN, _OTHER, _ROOM = (CHUNK_PX * row for row in (3, 6, 7, 8, 11, 14))


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


def places_in_room() -> tuple[int, int, int, int, int]:
    """Return where contributions have room, and where `fill_largest` puts both shares, and reflectances."""
    return _LIGHT, _FIRST, _SECOND, _OWN, _OTHER


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
def fill_largest(shares: Any, there: int, rho: Any, work: Any) -> None:
    """Fill the largest and the second largest share, and the reflectances of the two; there: the labels.

    Where: see `places_in_room`.
    """
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

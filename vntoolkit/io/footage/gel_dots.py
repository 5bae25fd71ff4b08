"""Dots printed on a tactile gel: found in a frame, and filled in a change of colour.

Dots are small and darker than the gel around them in every channel, since black ink absorbs all light. A
closing of a channel removes what is dark and narrower than its window; where it lifts all three channels by a
good part, there is a dot. The steep flank of a dent is dark too, but not in every channel: what turns away
from one lamp turns towards another. A dot moves with the gel: in a change against the untouched gel it leaves
a dark spot where it is and a bright one where it was. Both are filled from the change around them, which is
smooth: along the row and along the column, between the nearest known pixels on both sides, the shorter gap
counting more.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import LinearImage, Mask
from vntoolkit.native import njit

_WINDOW_SHARE = 1 / 16  # of the shorter side: sensors print ten dots across and more, each half a gap wide
_DARKER = 0.15  # of the gel's brightness around it, at least
_FEWEST = 0.002  # of all pixels: less is dirt, and the gel has no dots
_MOST = 0.4  # more is a texture or the print of an object
_LARGEST = 3  # times the area of the median dot: what is larger is the print of an object
_SEARCHED_PX = 120  # shorter side of the picture that is searched; a dot is still some pixels wide


def find_dots(change: LinearImage, background: LinearImage) -> Mask:
    """Mask (h, w) of the dots in change + background, both linear (h, w, 3); nothing where there are none."""
    return _dots(_shrunk(change) + _shrunk(background), change.shape[:2])


def _shrunk(image: LinearImage) -> LinearImage:
    height, width = image.shape[:2]
    step = max(1, min(height, width) // _SEARCHED_PX)
    return np.asarray(cv2.resize(image, (width // step, height // step), interpolation=cv2.INTER_AREA))


def _dots(small: LinearImage, shape: tuple[int, int]) -> Mask:
    """Mask of `shape` of the dots in a frame that is shrunk."""
    height, width = shape
    window = 2 * max(1, round(min(small.shape[:2]) * _WINDOW_SHARE / 2)) + 1
    closed = cv2.morphologyEx(small, cv2.MORPH_CLOSE, np.ones((window, window), np.uint8))
    dark = _darker(small, closed, np.float32(1 - _DARKER))
    if not _FEWEST < dark.mean() < _MOST:
        return np.zeros((height, width), np.bool_)
    _, labels, stats, _ = cv2.connectedComponentsWithStats(dark)
    areas = stats[:, cv2.CC_STAT_AREA]
    usual = areas <= _LARGEST * np.median(areas[1:])
    usual[0] = False
    dark = usual[labels].astype(np.uint8)
    rims = cv2.dilate(dark, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.resize(rims, (width, height), interpolation=cv2.INTER_NEAREST) > 0)


class DotFilter:
    """Fills the dots of one gel in changes of colour."""

    def __init__(self, background: LinearImage) -> None:
        """background: the untouched gel, linear (h, w, 3)."""
        self._small = _shrunk(background)
        self.dots = _dots(self._small, background.shape[:2])
        self._any = bool(self.dots.any())

    def filled(self, change: LinearImage, unknown: Mask) -> tuple[LinearImage, Mask]:
        """Return the change (h, w, 3) with dots and `unknown` pixels (h, w) filled, and the pixels filled."""
        holes = unknown
        if self._any:
            holes = unknown | self.dots | _dots(_shrunk(change) + self._small, change.shape[:2])
        if not holes.any() or holes.all():
            return change, holes
        above, below = np.empty((2, *holes.shape), np.int16)
        _find_known_rows(holes, above, below)
        filled = np.empty_like(change)
        _fill(change, holes, above, below, filled)
        return filled, holes


@njit(cache=True)
def _darker(small, closed, share):  # type: ignore[no-untyped-def]  # pragma: no cover
    """1 where all channels are below this share of their closing."""
    height, width = small.shape[:2]
    dark = np.zeros((height, width), np.uint8)
    for v in range(height):
        for u in range(width):
            count = 0
            for c in range(3):
                count += small[v, u, c] < share * closed[v, u, c]
            dark[v, u] = count == 3
    return dark


@njit(cache=True)
def _find_known_rows(holes, above, below):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Of every pixel the nearest row in its column that is known, itself or above, itself or below.

    Beyond the picture where there is none: −1 and the height.
    """
    height, width = holes.shape
    for u in range(width):
        above[0, u] = -1 if holes[0, u] else 0
        below[height - 1, u] = height if holes[height - 1, u] else height - 1
    for v in range(1, height):
        for u in range(width):
            above[v, u] = above[v - 1, u] if holes[v, u] else v
    for v in range(height - 2, -1, -1):
        for u in range(width):
            below[v, u] = below[v + 1, u] if holes[v, u] else v


@njit(cache=True, parallel=True, error_model="numpy")
def _fill(change, holes, above, below, filled):  # type: ignore[no-untyped-def]  # pragma: no cover
    """From the nearest known pixels of row and column, the shorter gap counting more; 0 without any."""
    height, width = holes.shape
    one, zero = np.float32(1), np.float32(0)
    for row in prange(height):
        v, u = np.int64(row), 0  # unsigned, the loop's own number makes floats of differences
        line, to = change[v], filled[v]
        for x in range(width):
            to[x, 0], to[x, 1], to[x, 2] = line[x, 0], line[x, 1], line[x, 2]
        while u < width:
            if not holes[v, u]:
                u += 1
                continue
            end = u
            while end < width and holes[v, end]:
                end += 1
            across = np.float32(end - u)
            left, right = (u - 1 if u > 0 else end % width), (end if end < width else max(u - 1, 0))
            step = one / (across + one)
            for x in range(u, end):
                top, bottom = np.int64(above[v, x]), np.int64(below[v, x])
                gap = np.float32(bottom - top - 1)
                by_column = across * across / (across * across + gap * gap)
                by_row = one - by_column
                if end - u == width:
                    by_row, by_column = zero, one
                if bottom - top > height:
                    by_row, by_column = (zero if end - u == width else one), zero
                along = by_row * step * np.float32(x - u + 1)
                down = by_column * np.float32(v - top) / (gap + one)
                by_row, by_column = by_row - along, by_column - down
                first = top if top >= 0 else bottom % height
                last = bottom if bottom < height else first
                for c in range(3):
                    to[x, c] = (
                        by_row * line[left, c] + along * line[right, c]
                        + by_column * change[first, x, c] + down * change[last, x, c]
                    )  # fmt: skip
            u = end

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
        filled = np.array(change)
        _fill_rows(filled, holes)
        _fill_columns(change, filled, holes)
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


@njit(cache=True, parallel=True)
def _fill_rows(filled, holes):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Between the nearest known pixels of the row; a hole at its end takes the one it has."""
    height, width = holes.shape
    for v in prange(height):
        u = 0
        while u < width:
            if not holes[v, u]:
                u += 1
                continue
            end = u
            while end < width and holes[v, end]:
                end += 1
            before, after = (u - 1 if u > 0 else end), (end if end < width else u - 1)
            for x in range(u, end):
                share = np.float32((x - u + 1) / (end - u + 1))
                for c in range(3):
                    if end - u == width:
                        filled[v, x, c] = np.float32(0)
                    else:
                        filled[v, x, c] = (np.float32(1) - share) * filled[v, before, c] + (
                            share * filled[v, after, c]
                        )
            u = end


@njit(cache=True, parallel=True)
def _fill_columns(change, filled, holes):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Mix in what the column says, by the lengths of the gaps of column and row."""
    height, width = holes.shape
    for column in prange(width):
        u, v = np.int64(column), 0  # unsigned, the loop's own number makes floats of differences
        while v < height:
            if not holes[v, u]:
                v += 1
                continue
            end = v
            while end < height and holes[end, u]:
                end += 1
            gap = end - v
            if gap < height:
                before, after = (v - 1 if v > 0 else end), (end if end < height else v - 1)
                for y in range(v, end):
                    left, right = u, u
                    while left > 0 and holes[y, left - 1] and u - left < gap:
                        left -= 1
                    while right < width - 1 and holes[y, right + 1] and right - u < gap:
                        right += 1
                    across = right - left + 1
                    own = np.float32(across * across / (across * across + gap * gap))
                    share = np.float32((y - v + 1) / (gap + 1))
                    for c in range(3):
                        along = (np.float32(1) - share) * change[before, u, c] + share * change[after, u, c]
                        filled[y, u, c] += own * (along - filled[y, u, c])
            v = end

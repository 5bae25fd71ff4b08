"""Dots printed on a tactile gel: found in a frame, and filled in a change of colour.

Dots are small and darker than the gel around them in every channel, since black ink absorbs all light. A
closing of a channel removes what is dark and narrower than its window; where it lifts all three channels by a
good part, there is a dot. The steep flank of a dent is dark too, but not in every channel: what turns away
from one lamp turns towards another. A dot moves with the gel: in a change against the untouched gel it leaves
a dark spot where it is and a bright one where it was. Both are filled from the change around them, which is
smooth: along the row and along the column, between the nearest known pixels on both sides, the shorter gap
counting more.
"""

from typing import NamedTuple

import cv2
import numpy as np

from vntoolkit.arrays import Array, BoolArray, ByteArray, LinearImage, Mask, box_of
from vntoolkit.native import njit

_WINDOW_SHARE = 1 / 16  # of the shorter side: sensors print ten dots across and more, each half a gap wide
_DARKER = 0.15  # of the gel's brightness around it, at least
_FEWEST = 0.002  # of all pixels: less is dirt, and the gel has no dots
_MOST = 0.4  # more is a texture or the print of an object
_LARGEST = 3  # times the area of the median dot: what is larger is the print of an object
BLACK = 1e-6
_SEARCHED_PX = 120  # shorter side of the picture that is searched; a dot is still some pixels wide


def shrunk(image: LinearImage) -> LinearImage:
    """A picture (h, w, 3) as it is searched, its shorter side 120 to 239 pixels long.

    Means over squares of whole pixels; what is left over below and to the right is not searched.
    """
    step = step_of(image.shape)
    height, width = image.shape[0] // step, image.shape[1] // step
    whole = image[: height * step, : width * step]
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), dtype=np.float32)


def step_of(shape: tuple[int, ...]) -> int:
    """Side in pixels of the squares whose means `shrunk` takes."""
    return max(1, min(shape[:2]) // _SEARCHED_PX)


def _enlarged(small: ByteArray, shape: tuple[int, int]) -> Mask:
    step = step_of(shape)
    mask: Mask = np.zeros(shape, np.bool_)
    mask[: step * small.shape[0], : step * small.shape[1]] = small.repeat(step, 0).repeat(step, 1)
    return mask


def window_of(shape: tuple[int, ...]) -> int:
    """Side of a window that holds a dot, in a picture of this shape."""
    return 2 * max(1, round(min(shape[:2]) * _WINDOW_SHARE / 2)) + 1


def closed(picture: Array, window: int) -> Array:
    """A picture (h, w, 3) without what is dark and narrower than a window."""
    return np.asarray(cv2.morphologyEx(picture, cv2.MORPH_CLOSE, np.ones((window, window), np.uint8)))


class _Ink(NamedTuple):
    """A gel's dots at rest. area_px: of the median dot. share: median light there, of that around."""

    area_px: float
    share: np.float32


def _ink_at_rest(small: LinearImage, closed: LinearImage) -> _Ink | None:
    """The ink of the dots in a shrunk picture of the untouched gel; None where it has no dots."""
    dark = _in_all_channels(small < np.float32(1 - _DARKER) * closed).astype(np.uint8)
    if not _FEWEST < dark.mean() < _MOST:
        return None
    areas = cv2.connectedComponentsWithStats(dark)[2][1:, cv2.CC_STAT_AREA]
    shares = (small[dark > 0] / np.maximum(closed[dark > 0], BLACK)).max(axis=1)
    return _Ink(area_px=float(np.median(areas)), share=np.float32(np.median(shares)))


def _dots(small: LinearImage, closed: LinearImage, ink: _Ink) -> ByteArray:
    """1 at the dots and their rims in a shrunk picture: as dark as ink, also on an object's dark flank."""
    found = np.zeros(small.shape[:2], np.bool_)
    for share in (np.float32(1 - _DARKER), ink.share):
        dark = _in_all_channels(small < share * closed).astype(np.uint8)
        if np.count_nonzero(dark) < _MOST * dark.size:
            _, labels, stats, _ = cv2.connectedComponentsWithStats(dark)
            usual = stats[:, cv2.CC_STAT_AREA] <= _LARGEST * ink.area_px
            is_all_dots = bool(usual[1:].all())
            usual[0] = False
            found |= usual[labels]
            if is_all_dots:
                break
    return np.asarray(cv2.dilate(found.astype(np.uint8), np.ones((3, 3), np.uint8)), dtype=np.uint8)


class DotFilter:
    """Fills the dots of one gel in changes of colour."""

    def __init__(self, background: LinearImage) -> None:
        """background: the untouched gel, linear (h, w, 3)."""
        self._small = shrunk(background)
        self._bright = closed(self._small, window_of(self._small.shape))
        self._ink = _ink_at_rest(self._small, self._bright)
        self._found = np.zeros(self._small.shape[:2], np.uint8)
        if self._ink is not None:
            self._found = _dots(self._small, self._bright, self._ink)
        self.dots = _enlarged(self._found, background.shape[:2])

    def filled(self, change: LinearImage, unknown: Mask) -> tuple[LinearImage, Mask]:
        """Return the change (h, w, 3) with dots and `unknown` pixels (h, w) filled, and the pixels filled."""
        holes = unknown
        if self._ink is not None:
            holes = self._holes(change, unknown, self._ink)
        if not holes.any() or holes.all():
            return change, holes
        above, below = np.empty((2, *holes.shape), np.int16)
        _find_known_rows(holes, above, below)
        filled = change.copy()
        _fill(change, holes, above, below, filled)
        return filled, holes

    def _holes(self, change: LinearImage, unknown: Mask, ink: _Ink) -> Mask:
        """What is unknown, the dots of the gel at rest, and those of the frame where any has moved to.

        A dot that came to a place made it darker in every channel. So only the box of what became darker is
        searched, and a dot's neighbourhood around it.
        """
        moved = shrunk(change)
        height, width = moved.shape[:2]
        window = window_of(moved.shape)
        rows, columns = box_of(_in_all_channels(moved < np.float32(-_DARKER / 2) * self._bright))
        if rows.stop == 0:
            return unknown | self.dots
        box = (
            slice(max(rows.start - window, 0), min(rows.stop + window, height)),
            slice(max(columns.start - window, 0), min(columns.stop + window, width)),
        )
        frame = np.ascontiguousarray(moved[box] + self._small[box])
        found = self._found.copy()
        found[box] |= _dots(frame, closed(frame, window), ink)
        return unknown | _enlarged(found, unknown.shape)


def _in_all_channels(holds: BoolArray) -> Mask:
    """Where a condition (h, w, 3) holds in all channels, (h, w); numpy reduces a short axis much slower."""
    return holds[..., 0] & holds[..., 1] & holds[..., 2]


@njit
def _find_known_rows(holes, above, below):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Of every pixel the nearest known row in its column, above and below; −1 and the height for none."""
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


@njit
def _fill(change, holes, above, below, filled):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Fill the holes from what is known nearest in row and column, the shorter gap counting more."""
    height, width = holes.shape
    one, zero = np.float32(1), np.float32(0)
    for v in range(height):
        u, line, to = 0, change[v], filled[v]
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

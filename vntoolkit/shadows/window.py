"""The rectangle around a mask: where a figure fills a third of its frame, the rest shall take no time."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Mask
from vntoolkit.photometry.frame import LinearFrame

_MARGIN_PX = 4  # room for filters around the mask

Window = tuple[slice, slice]


def window_around(mask: Mask) -> Window:
    """Return (rows, columns) that hold all of `mask` and a margin; the whole image where it is empty."""
    if not mask.any():
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    return _span(np.asarray(mask.any(axis=1))), _span(np.asarray(mask.any(axis=0)))


def frame_in_window(frame: LinearFrame, window: Window) -> LinearFrame:
    """Return the frame's pixels in the window."""
    return LinearFrame(rgb=frame.rgb[window], clipped=frame.clipped[window], number=frame.number)


def in_whole_image(
    part: npt.NDArray[Any], window: Window, shape: tuple[int, ...], outside: Any = 0
) -> npt.NDArray[Any]:
    """Return an image of (h, w) = `shape` with `part` in the window and `outside` around it."""
    if part.shape[:2] == shape[:2]:
        return part
    whole = np.full((*shape[:2], *part.shape[2:]), outside, dtype=part.dtype)
    whole[window] = part
    return whole


def _span(used: npt.NDArray[np.bool_]) -> slice:
    first, last = int(used.argmax()), len(used) - int(used[::-1].argmax())
    return slice(max(first - _MARGIN_PX, 0), min(last + _MARGIN_PX, len(used)))

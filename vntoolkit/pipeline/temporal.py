"""What frames owe to other frames: the reference that fixes the free depth, and smoothing over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vntoolkit.io.captures import Capture
from vntoolkit.io.decoding import EncodedFrame
from vntoolkit.photometry.temporal import smoothed_over_time


def smoothed_frames(capture: Capture, block: range, sameness: float) -> Iterator[EncodedFrame]:
    """Yield a block's frames; with sameness > 0, each blended with the captured frames before and after it.

    The neighbours are those in the capture, not in the block: results do not depend on how frames are shared
    out. The first and the last frame of the capture have one neighbour; frames of floats are not blended.
    """
    if not sameness > 0:
        yield from capture.encoded_frames(block.start, block.stop, block.step)
        return
    last = capture.info.frame_count - 1
    if block.step == 1:
        start, stop = max(0, block.start - 1), min(last + 1, block.stop + 1)
        window: list[EncodedFrame] = []
        for frame in capture.encoded_frames(start, stop):
            window.append(frame)
            if len(window) == 3:
                yield _blended(window[0], window[1], window[2], sameness)
                window.pop(0)
            elif len(window) == 2 and start == block.start:
                yield _blended(window[0], window[0], window[1], sameness)
        if stop == block.stop:
            yield _blended(window[-2] if len(window) > 1 else window[-1], window[-1], window[-1], sameness)
        return
    for number in block:
        frames = list(capture.encoded_frames(max(0, number - 1), min(last, number + 1) + 1))
        here = number - frames[0].number
        yield _blended(
            frames[max(0, here - 1)], frames[here], frames[min(here + 1, len(frames) - 1)], sameness
        )


def _blended(before: EncodedFrame, now: EncodedFrame, after: EncodedFrame, sameness: float) -> EncodedFrame:
    if now.values.dtype not in (np.uint8, np.uint16):
        return now
    values = smoothed_over_time(before.values, now.values, after.values, now.bits, sameness)
    return replace(now, values=values, bits=16)

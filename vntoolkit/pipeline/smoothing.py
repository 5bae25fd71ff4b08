"""Smoothing over time: each frame is blended with the captured frames before and after it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import Array, UInt16Array
from vntoolkit.checks import require_positive
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.native import njit

_FULL = 65535


def smoothed_frames(capture: Capture, block: range, sameness: float) -> Iterator[EncodedFrame]:
    """Yield a block's frames, each blended with the captured frames before and after it.

    The neighbours are those in the capture, not in the block: results do not depend on how frames are shared
    out. The first and the last frame of the capture have one neighbour; frames of floats are not blended.
    """
    read: dict[int, EncodedFrame] = {}
    there = set(capture.present)
    for number in block:
        around = {number - 1, number, number + 1} & there
        if number in around:
            read = {n: read[n] if n in read else capture.encoded(n) for n in sorted(around)}
            now = read[number]
            yield _blended(read.get(number - 1, now), now, read.get(number + 1, now), sameness)


def _blended(before: EncodedFrame, now: EncodedFrame, after: EncodedFrame, sameness: float) -> EncodedFrame:
    if now.values.dtype not in (np.uint8, np.uint16):
        return now
    values = smoothed_over_time(before.values, now.values, after.values, now.bits, sameness)
    return replace(now, values=values, bits=16)


def smoothed_over_time(before: Array, now: Array, after: Array, bits: int, sameness: float) -> UInt16Array:
    """Blend stored integers (h, w, 3) of three frames; the result has 16 significant bits.

    sameness: s, as a share of full scale (stored values). A value at full scale stays there, so that clipped
    pixels are still known. Raises `BadInput` where sameness is not positive.
    """
    require_positive(sameness, "sameness")
    out = np.empty(now.shape, np.uint16)
    top = 2**bits - 1
    _blend(before, now, after, np.float32(_FULL / top), np.float32(0.5 / (sameness * top) ** 2), top, out)
    return out


@njit(cache=True)
def _blend(before, now, after, scale, sharpness, top, out):  # type: ignore[no-untyped-def]  # pragma: no cover
    height, width = now.shape[:2]
    for v in range(height):
        for u in range(width):
            d_before, d_after = np.float32(0), np.float32(0)
            for c in range(3):
                own = np.float32(now[v, u, c])
                d_before += (np.float32(before[v, u, c]) - own) ** 2
                d_after += (np.float32(after[v, u, c]) - own) ** 2
            w_before, w_after = np.exp(-d_before * sharpness), np.exp(-d_after * sharpness)
            inverse = scale / (np.float32(1) + w_before + w_after)
            for c in range(3):
                own = now[v, u, c]
                if own >= top:
                    out[v, u, c] = np.uint16(65535)
                    continue
                total = np.float32(own) + w_before * before[v, u, c] + w_after * after[v, u, c]
                out[v, u, c] = np.uint16(total * inverse + np.float32(0.5))

"""Smoothing over time: each frame is blended with the captured frames before and after it."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from vntoolkit.arrays import Array, UInt16Array
from vntoolkit.checks import require_positive
from vntoolkit.io.footage.captures import Capture
from vntoolkit.io.footage.decoding import EncodedFrame

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
    top = np.float32(2**bits - 1)
    own = now.astype(np.float32)
    total, weights = own.copy(), np.ones((*now.shape[:2], 1), np.float32)
    for other in (before.astype(np.float32), after.astype(np.float32)):
        squared = ((other - own) ** 2).sum(axis=2, keepdims=True)
        weight = np.exp(squared * np.float32(-0.5 / (sameness * top) ** 2))
        total, weights = total + weight * other, weights + weight
    blended = (total * (np.float32(_FULL) / top / weights) + np.float32(0.5)).astype(np.uint16)
    return np.where(now >= top, np.uint16(_FULL), blended)

"""Noise averaged over a frame and its two neighbours in time, where the picture rests.

A neighbour's pixel counts by how alike its colour is: exp(−d² / 2s²), d the distance of the two colours and s
the difference up to which they pass for the same surface at rest. Where something moves, the colours differ
and the frame keeps its own; so motion is not blurred, as a plain mean or a recursive filter would.
(Bilateral weights, Tomasi and Manduchi 1998, tomasi1998, along time.)
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from vntoolkit.checks import require_positive

_FULL = 65535


def smoothed_over_time(
    before: npt.NDArray[Any], now: npt.NDArray[Any], after: npt.NDArray[Any], bits: int, sameness: float
) -> npt.NDArray[np.uint16]:
    """Blend stored integers (h, w, 3) of three frames; the result has 16 significant bits.

    sameness: s, as a share of full scale (stored values). A value at full scale stays there, so that clipped
    pixels are still known. Raises `BadInput` where sameness is not positive.
    """
    require_positive(sameness, "sameness")
    out = np.empty(now.shape, np.uint16)
    top = 2**bits - 1
    _blend(before, now, after, np.float32(_FULL / top), np.float32(0.5 / (sameness * top) ** 2), top, out)
    return out


@njit(cache=True, nogil=True)
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

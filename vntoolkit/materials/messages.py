"""Labels of all pixels of a frame at once, by messages from pixel to pixel (kolmogorov2006).

A pixel sends its neighbour what each of the neighbour's labels would cost on its side of the picture. Pixels
are gone through in the order of reading, and back. So a patch with a wrong label is turned as a whole, where
turning a part of it costs more than it saves: in folds, where hardly a pixel tells its own label.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from vntoolkit.arrays import ByteArray, Float32Array, Mask
from vntoolkit.materials.reflectance import CAP
from vntoolkit.native import njit

_ROUNDS = 2  # there and back; three more change few patches
_NONE, _HALF, _ONE, _OF_CAP = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(CAP**-2)
_INFINITE = np.float32(np.inf)


def labels_by_messages(
    labels: ByteArray,
    active: Mask,
    prices: Float32Array,
    steps: Float32Array,
    logs: Float32Array,
    reach: int,
    seam: float,
) -> ByteArray:
    """Return labels (h, w) of little cost of the active pixels, among all; the others keep theirs.

    prices: (h, w, m), of each label of active pixels. steps: (h, w, 2, 6), of log s to the pixel `reach` to
    the right and below, and 1 over its variance, 0 for no step. logs: (m, 3), log ρ. seam: price of two
    pixels of two labels side by side.
    """
    found = labels.copy()
    _pass_messages(found, active, prices, steps, logs, reach, np.float32(seam / reach), _ROUNDS)
    return found


@njit(cache=True, parallel=True, error_model="numpy")
def _pass_messages(
    labels: Any, active: Any, prices: Any, steps: Any, z: Any, reach: int, seam: Any, rounds: int
) -> None:
    """Pixels that are `reach` apart are a picture of their own each time: nothing joins them to others."""
    h, w, count = prices.shape
    messages = np.zeros((h, w, 4, count), np.float32)  # from the left, above, the right, below
    for part in prange(reach * reach):
        top, left = part // reach, part % reach
        belief = np.empty(count, np.float32)
        for _there_and_back in range(rounds):
            for v in range(top, h, reach):
                for u in range(left, w, reach):
                    _send(labels, active, prices, steps, z, reach, seam, messages, v, u, 0, belief)
            for v in range(top + (h - 1 - top) // reach * reach, -1, -reach):
                for u in range(left + (w - 1 - left) // reach * reach, -1, -reach):
                    _send(labels, active, prices, steps, z, reach, seam, messages, v, u, 1, belief)
        for v in range(top, h, reach):
            for u in range(left, w, reach):
                if active[v, u]:
                    _decide(labels, prices, steps, z, reach, seam, messages, v, u, belief)


@njit(cache=True, inline="always", error_model="numpy")
def _send(
    labels: Any, active: Any, prices: Any, steps: Any, z: Any, reach: int, seam: Any, messages: Any,
    v: int, u: int, back: int, belief: Any,
) -> None:  # fmt: skip
    """Send a pixel's messages to the right and below, or back to the left and above."""
    count = len(belief)
    is_right, is_below = steps[v, u, 0, 3] > _NONE, steps[v, u, 1, 3] > _NONE
    is_left = u >= reach and steps[v, max(u - reach, 0), 0, 3] > _NONE
    is_above = v >= reach and steps[max(v - reach, 0), u, 1, 3] > _NONE
    later = (is_right + is_below) if back == 0 else (is_left + is_above)
    if later == 0:
        return
    earlier = (is_left + is_above) if back == 0 else (is_right + is_below)
    own, is_free = messages[v, u], active[v, u]
    if is_free:
        for m in range(count):
            belief[m] = (prices[v, u, m] + own[0, m] + own[1, m] + own[2, m] + own[3, m]) / max(
                earlier, later
            )
    for way in range(2):
        if back == 0:
            there = is_right if way == 0 else is_below
            a, b, step, sign = v + way * reach, u + (1 - way) * reach, steps[v, u, way], _ONE
        else:
            there = is_left if way == 0 else is_above
            a, b, sign = v - way * reach, u - (1 - way) * reach, -_ONE
            step = steps[max(a, 0), max(b, 0), way]
        if not there or not active[a, b]:
            continue
        sent, heard = messages[a, b, way + 2 * back], own[way + 2 * (1 - back)]
        d0, d1, d2, w0, w1, w2 = sign * step[0], sign * step[1], sign * step[2], step[3], step[4], step[5]
        least = _INFINITE
        for n in range(count):
            e0, e1, e2 = d0 - z[n, 0], d1 - z[n, 1], d2 - z[n, 2]
            best = _INFINITE
            for m in range(count):
                if not is_free and m != labels[v, u]:
                    continue
                y0, y1, y2 = e0 + z[m, 0], e1 + z[m, 1], e2 + z[m, 2]
                t = y0 * y0 * w0 + y1 * y1 * w1 + y2 * y2 * w2
                cost = _HALF * t / (_ONE + t * _OF_CAP) + (seam if m != n else _NONE)
                if is_free:
                    cost += belief[m] - heard[m]
                best = min(best, cost)
            sent[n] = best
            least = min(least, best)
        for n in range(count):
            sent[n] -= least


@njit(cache=True, inline="always", error_model="numpy")
def _decide(
    labels: Any, prices: Any, steps: Any, z: Any, reach: int, seam: Any, messages: Any, v: int, u: int,
    total: Any,
) -> None:  # fmt: skip
    """Give a pixel its label: those to the left and above have theirs, the others sent what theirs cost."""
    for m in range(len(total)):
        total[m] = prices[v, u, m] + messages[v, u, 2, m] + messages[v, u, 3, m]
    for way in range(2):
        a, b = v - way * reach, u - (1 - way) * reach
        if a < 0 or b < 0 or not steps[a, b, way, 3] > _NONE:
            continue
        step, n = steps[a, b, way], labels[a, b]
        for m in range(len(total)):
            y0, y1, y2 = step[0] - z[m, 0] + z[n, 0], step[1] - z[m, 1] + z[n, 1], step[2] - z[m, 2] + z[n, 2]
            t = y0 * y0 * step[3] + y1 * y1 * step[4] + y2 * y2 * step[5]
            total[m] += _HALF * t / (_ONE + t * _OF_CAP) + (seam if m != n else _NONE)
    labels[v, u] = total.argmin()

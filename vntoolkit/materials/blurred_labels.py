"""Labels beside seams, decided together with the blur of lens and Bayer pattern.

A pixel beside a seam shows a mixture. Light adds, so that the map of reflectances is blurred as the picture,
and a change of one label changes the mixtures around it. A change is made where with it normals are nearer to
unit length and shading goes on more evenly from pixel to pixel, by more than the longer seam costs. Blocks of
pixels are tried first, then pixel after pixel (besag1986).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.materials.pixels import (
    MaterialLabels,
    Seams,
    Spread,
    blur_weights,
    likeliest_blur_px,
    near_seams,
    variance_of_lengths,
)
from vntoolkit.materials.reflectance import CAP, Lamps
from vntoolkit.native import njit

_FIRST_BLUR_PX = 1.0  # of a lens and a Bayer pattern; sharper pictures show it, and are decided again
_SEAM_PRICE = 1.0  # of two pixels of two materials side by side
_SHARED = 4.0  # pixels that share their errors: texture and blur reach over 2 × 2
_BLOCK_PX, _BLOCK_SWEEPS, _SWEEPS = 4, 3, 5
_LOOK_PX = 2  # beside a block for labels that it may get
_ENOUGH = 0.01  # share of the pixels beside seams that change when all is settled
_LEAST_STEP = 0.01  # of log s from pixel to pixel
_JUDGED = 20_000  # pixels that tell how shading changes
_LEAST_LIGHT = 1e-4
_REACH_PX = 2  # of the blur
MARGIN_PX = _REACH_PX + 3  # around a pixel that may change, where its change is felt


class BlurredLabels:
    """Decides labels beside seams under a blur, which the first frame tells.

    lamps: with the noise of the pixels. logs: (m, 3), log ρ. spread: of the normals' lengths.
    """

    def __init__(self, lamps: Lamps, logs: Points, spread: Spread) -> None:
        self._lamps, self._logs, self._spread = lamps, logs, spread
        self._reflectances = np.exp(logs)
        self._seams: Seams | None = None
        self._precision = 1.0
        self._room: tuple[FloatArray, FloatArray, FloatArray, FloatArray] | None = None

    @property
    def seams(self) -> Seams:
        """What tells the mixtures beside seams."""
        assert self._seams is not None
        return self._seams

    def settled(self, values: FloatArray, lit: Mask, labels: MaterialLabels) -> MaterialLabels:
        """Return labels (h, w) from labels that may be wrong in patches, block by block, then by pixel.

        values: (h, w, 3), colours. lit: (h, w), where labels may change.
        """
        return self._decided(values, lit, labels, lit, _BLOCK_SWEEPS, _SWEEPS)

    def followed(self, values: FloatArray, lit: Mask, labels: MaterialLabels, near: Mask) -> MaterialLabels:
        """Return labels (h, w) from labels whose seams are off by a pixel.

        near: (h, w), at least what is within MARGIN_PX of a seam.
        """
        return self._decided(values, lit, labels, near, 0, 1)

    def _decided(
        self, values: FloatArray, lit: Mask, labels: MaterialLabels, near: Mask, of_blocks: int, sweeps: int
    ) -> MaterialLabels:
        if self._seams is not None:
            return self._moved(values, lit, labels, near, self._seams.blur_px, of_blocks, sweeps)
        known = lit, self._lamps, self._logs
        tolerance = variance_of_lengths(values, *known, labels)
        self._precision = 1.0 / (_SHARED * _variance_of_steps(values, *known, labels))
        found = self._moved(values, lit, labels, near, _FIRST_BLUR_PX, of_blocks, sweeps)
        blur_px = likeliest_blur_px(values, *known, self._spread, found)
        if blur_px != _FIRST_BLUR_PX:
            found = self._moved(values, lit, labels, near, blur_px, of_blocks, sweeps)
        self._seams = Seams(blur_px, tolerance)
        return found

    def _moved(
        self, values: FloatArray, lit: Mask, labels: MaterialLabels, near: Mask, blur_px: float,
        of_blocks: int, sweeps: int,
    ) -> MaterialLabels:  # fmt: skip
        weights = blur_weights(blur_px, _REACH_PX if blur_px > 0.0 else 0)
        lamps, found = self._lamps, labels.copy()
        room, near = self._room_for(values), lit & near
        _mix_all(values, found, near, lamps.split, self._reflectances, weights, _LEAST_LIGHT, *room)
        most_left = _ENOUGH * near_seams(labels, 1).sum() if sweeps > 1 else 0
        length = 1.0 / (self._spread.of_pixels**2 + _SHARED * self._spread.of_regions**2)
        for side, stride, look, most in (
            (_BLOCK_PX, _BLOCK_PX // 2, _LOOK_PX, of_blocks),
            (1, 1, 1, sweeps),
        ):
            for _ in range(most):
                changed = _move(
                    found, near, *room, self._reflectances, weights, lamps.haze, lamps.inverse, length,
                    self._precision, side, stride, look,
                )  # fmt: skip
                if changed <= most_left:
                    break
        return found

    def _room_for(self, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        if self._room is None or self._room[0].shape != values.shape:
            light, light_log, mixed, mixed_log = np.ones((4, *values.shape), np.float32)
            self._room = light, light_log, mixed, mixed_log
        return self._room


def _variance_of_steps(
    values: FloatArray, lit: Mask, lamps: Lamps, logs: Points, labels: MaterialLabels
) -> float:
    """Robust variance of the step of log s from pixel to pixel within materials, mean over the lamps."""
    rows = slice(None, None, max(1, int(lit.sum()) // _JUDGED))
    same = labels[rows, 1:] == labels[rows, :-1]
    both = lit[rows, 1:] & lit[rows, :-1] & same
    if not both.any():
        return _LEAST_STEP**2
    here, there = (
        np.maximum(part[both] @ lamps.split.T, lamps.noise) for part in (values[rows, :-1], values[rows, 1:])
    )
    steps = np.median(np.abs(np.log(there / here)), axis=0)
    return float(max((1.4826**2 * steps**2).mean(), _LEAST_STEP**2))


@njit(cache=True, parallel=True, error_model="numpy")
def _mix_all(
    values: Any, labels: Any, wanted: Any, split: Any, rho: Any, weights: Any, least: float, light: Any,
    light_log: Any, mixed: Any, mixed_log: Any,
) -> None:  # fmt: skip
    """Fill what every lamp contributes, its logarithm, and the mean reflectance under the blur."""
    h, w = labels.shape
    reach = weights.size // 2
    for v in prange(h):
        for u in range(w):
            if not wanted[v, u]:
                continue
            for k in range(3):
                s = (
                    split[k, 0] * values[v, u, 0]
                    + split[k, 1] * values[v, u, 1]
                    + split[k, 2] * values[v, u, 2]
                )
                light[v, u, k] = max(s, least)
                light_log[v, u, k] = np.log(light[v, u, k])
                mixed[v, u, k] = 0.0
            for a in range(-reach, reach + 1):
                for b in range(-reach, reach + 1):
                    m = labels[min(max(v + a, 0), h - 1), min(max(u + b, 0), w - 1)]
                    weight = weights[a + reach] * weights[b + reach]
                    for k in range(3):
                        mixed[v, u, k] += weight * rho[m, k]
            for k in range(3):
                mixed_log[v, u, k] = np.log(mixed[v, u, k])


@njit(cache=True, error_model="numpy")
def _price_around(
    lit: Any, light: Any, light_log: Any, mixed: Any, logs: Any, v: int, u: int, size: int, haze: Any,
    inverse: Any, length: float, precision: float,
) -> float:  # fmt: skip
    """Price of a window's lengths, without its rim, and of its steps. mixed, logs: (size, size, 3)."""
    total = 0.0
    x = np.empty(3)
    for a in range(size):
        for b in range(size):
            if not lit[v + a, u + b]:
                continue
            if 0 < a < size - 1 and 0 < b < size - 1:
                for k in range(3):
                    x[k] = light[v + a, u + b, k] / mixed[a, b, k] - haze[k]
                n = 0.0
                for i in range(3):
                    n += (inverse[i, 0] * x[0] + inverse[i, 1] * x[1] + inverse[i, 2] * x[2]) ** 2
                t = (np.sqrt(n) - 1.0) ** 2 * length
                total += 0.5 * t / (1.0 + t / (CAP * CAP))
            for way in range(2):
                c, d = a + way, b + 1 - way
                if c < size and d < size and lit[v + c, u + d]:
                    t = 0.0
                    for k in range(3):
                        rest = light_log[v + c, u + d, k] - logs[c, d, k]
                        rest -= light_log[v + a, u + b, k] - logs[a, b, k]
                        t += rest * rest
                    t *= precision
                    total += 0.5 * t / (1.0 + t / (CAP * CAP))
    return total


@njit(cache=True)
def _length_of_seam(labels: Any, v: int, u: int, side: int, m: int) -> float:
    """Neighbours of another label along the sides of a block and in it; m: its label, −1 for those it has."""
    count = 0.0
    for a in range(-1, side):
        for b in range(-1, side):
            inside = a >= 0 and b >= 0
            here = m if inside and m >= 0 else labels[v + a, u + b]
            if b >= 0:
                there = m if a + 1 < side and m >= 0 else labels[v + a + 1, u + b]
                count += here != there
            if a >= 0:
                there = m if b + 1 < side and m >= 0 else labels[v + a, u + b + 1]
                count += here != there
    return count


@njit(cache=True, parallel=True, error_model="numpy")
def _move(
    labels: Any, lit: Any, light: Any, light_log: Any, mixed: Any, mixed_log: Any, rho: Any, weights: Any,
    haze: Any, inverse: Any, length: float, precision: float, side: int, stride: int, look: int,
) -> int:  # fmt: skip
    """Give each block the label around it that costs least; return how many changed.

    Rows of blocks so far apart that they do not touch what the other sees are decided at the same time.
    """
    h, w = lit.shape
    count, reach = rho.shape[0], weights.size // 2
    margin = reach + 1
    size = side + 2 * margin
    first, rim = max(margin, look), margin + look
    rows = max((h - first - side - rim) // stride + 1, 0)
    apart = (size + margin + look) // stride + 1
    changes = np.zeros(max(rows, 1), np.int64)
    for phase in range(apart):
        for step in prange((rows - phase + apart - 1) // apart):
            row = phase + step * apart
            v = first + row * stride
            near = np.zeros(count, np.bool_)
            own, new = np.empty((size, size, 3)), np.empty((size, size, 3))
            own_logs, new_logs = np.empty((size, size, 3)), np.empty((size, size, 3))
            for u in range(first, w - side - rim, stride):
                is_lit = False
                for a in range(side):
                    for b in range(side):
                        is_lit |= lit[v + a, u + b]
                if not is_lit:
                    continue
                near[:] = False
                for a in range(-look, side + look):
                    for b in range(-look, side + look):
                        near[labels[v + a, u + b]] |= lit[v + a, u + b]
                same = labels[v, u]
                for a in range(side):
                    for b in range(side):
                        if labels[v + a, u + b] != same:
                            same = -1
                if same >= 0:
                    near[same] = False
                if not near.any():
                    continue
                for a in range(size):
                    for b in range(size):
                        for k in range(3):
                            own[a, b, k] = mixed[v + a - margin, u + b - margin, k]
                            own_logs[a, b, k] = mixed_log[v + a - margin, u + b - margin, k]
                place = v - margin, u - margin
                least = _price_around(
                    lit, light, light_log, own, own_logs, place[0], place[1], size, haze, inverse, length,
                    precision,
                ) + _SEAM_PRICE * _length_of_seam(labels, v, u, side, -1)  # fmt: skip
                best = -1
                for m in range(count):
                    if not near[m]:
                        continue
                    new[:] = own
                    new_logs[:] = own_logs
                    _shift_mixtures(new, labels, v, u, side, m, rho, weights, margin)
                    for a in range(1, size - 1):
                        for b in range(1, size - 1):
                            for k in range(3):
                                new_logs[a, b, k] = np.log(new[a, b, k])
                    price = _price_around(
                        lit, light, light_log, new, new_logs, place[0], place[1], size, haze, inverse, length,
                        precision,
                    ) + _SEAM_PRICE * _length_of_seam(labels, v, u, side, m)  # fmt: skip
                    if price < least - 1e-6:
                        least, best = price, m
                if best < 0:
                    continue
                changes[row] += 1
                new[:] = own
                _shift_mixtures(new, labels, v, u, side, best, rho, weights, margin)
                for a in range(size):
                    for b in range(size):
                        for k in range(3):
                            mixed[v + a - margin, u + b - margin, k] = new[a, b, k]
                            mixed_log[v + a - margin, u + b - margin, k] = np.log(new[a, b, k])
                labels[v : v + side, u : u + side] = best
    return changes.sum()


@njit(cache=True)
def _shift_mixtures(
    window: Any, labels: Any, v: int, u: int, side: int, m: int, rho: Any, weights: Any, margin: int
) -> None:
    """Change the mixtures (size, size, 3) around a block to those with label m in all of it."""
    reach = weights.size // 2
    for a in range(side):
        for b in range(side):
            old = labels[v + a, u + b]
            if old == m:
                continue
            for i in range(-reach, reach + 1):
                for j in range(-reach, reach + 1):
                    weight = weights[i + reach] * weights[j + reach]
                    for k in range(3):
                        window[a + i + margin, b + j + margin, k] += weight * (rho[m, k] - rho[old, k])

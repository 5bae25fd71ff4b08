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
from vntoolkit.materials.mixtures import blur_weights
from vntoolkit.materials.pixels import (
    MaterialLabels,
    Seams,
    Single,
    Spread,
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
_LEAST_LIGHT = np.float32(1e-4)
_LEAST_GAIN = 1e-4  # in nats: less is rounding
_REACH_PX = 2  # of the blur
MARGIN_PX = _REACH_PX + 3  # around a pixel that may change, where its change is felt
# Of the kernels, which count in single precision. The series of 2 artanh(z) / z in z².
_NONE, _HALF, _ONE, _MOST = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(CAP * CAP)
_SERIES = np.array([2.0, 2.0 / 3.0, 2.0 / 5.0, 2.0 / 7.0, 2.0 / 9.0], np.float32)


class BlurredLabels:
    """Decides labels beside seams under a blur, which the first frame tells.

    lamps: with the noise of the pixels. logs: (m, 3), log ρ. spread: of the normals' lengths.
    """

    def __init__(self, lamps: Lamps, logs: Points, spread: Spread) -> None:
        self._lamps, self._logs, self._spread = lamps, logs, spread
        self._reflectances = np.exp(logs)
        self._seams: Seams | None = None
        self._precision = 1.0
        self._room: Single | None = None

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
        weights = blur_weights(blur_px, _REACH_PX if blur_px > 0.0 else 0).astype(np.float32)
        lamps, found = self._lamps, labels.copy()
        split, rho, haze, inverse = (
            part.astype(np.float32) for part in (lamps.split, self._reflectances, lamps.haze, lamps.inverse)
        )
        room, near = self._room_for(lit.shape), lit & near
        _mix_all(values, found, near, split, rho, weights, room)
        most_left = _ENOUGH * near_seams(labels, 1).sum() if sweeps > 1 else 0
        length = 1.0 / (self._spread.of_pixels**2 + _SHARED * self._spread.of_regions**2)
        for side, stride, look, most in (
            (_BLOCK_PX, _BLOCK_PX // 2, _LOOK_PX, of_blocks),
            (1, 1, 1, sweeps),
        ):
            for _ in range(most):
                changed = _move(
                    found, near, room, rho, weights, haze, inverse, np.float32(length),
                    np.float32(self._precision), side, stride, look,
                )  # fmt: skip
                if changed <= most_left:
                    break
        return found

    def _room_for(self, shape: tuple[int, int]) -> Single:
        """(h, w, 9), the state of `_mix_all`."""
        if self._room is None or self._room.shape[:2] != shape:
            self._room = np.ones((*shape, 9), np.float32)
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
def _mix_all(values: Any, labels: Any, wanted: Any, split: Any, rho: Any, weights: Any, state: Any) -> None:
    """Fill state (h, w, 9): what each lamp contributes, the mean reflectance under the blur, log of the ratio
    of the two.

    split: (3, 3), rho: (m, 3) and weights in single precision.
    """
    h, w = labels.shape
    reach = weights.size // 2
    for v in prange(h):
        for u in range(w):
            if not wanted[v, u]:
                continue
            own, is_mixed = labels[v, u], False
            for a in range(max(v - reach, 0), min(v + reach + 1, h)):
                for b in range(max(u - reach, 0), min(u + reach + 1, w)):
                    is_mixed |= labels[a, b] != own
            for k in range(3):
                s = split[k, 0] * values[v, u, 0] + split[k, 1] * values[v, u, 1]
                s = max(s + split[k, 2] * values[v, u, 2], _LEAST_LIGHT)
                mean = rho[own, k]
                if is_mixed:
                    mean = _NONE
                    for a in range(-reach, reach + 1):
                        part = _NONE
                        for b in range(-reach, reach + 1):
                            m = labels[min(max(v + a, 0), h - 1), min(max(u + b, 0), w - 1)]
                            part += weights[b + reach] * rho[m, k]
                        mean += weights[a + reach] * part
                state[v, u, k] = s
                state[v, u, 3 + k] = mean
                state[v, u, 6 + k] = np.log(s / mean)


@njit(cache=True, fastmath=True, error_model="numpy")
def _price_of(
    light: Any, mixed: Any, shade: Any, inside: Any, across: Any, down: Any, size: int, haze: Any,
    inverse: Any, length: Any, precision: Any,
) -> Any:  # fmt: skip
    """Price of a window's lengths and of its steps of shading, all in single precision.

    light, mixed, shade: (3, size²). inside, across, down: (size²,), 1 where the length counts, and where the
    step to the right and that below do. The loops are so that eight pixels are taken at a time.
    """
    l0, l1, l2, m0, m1, m2 = light[0], light[1], light[2], mixed[0], mixed[1], mixed[2]
    i00, i01, i02 = inverse[0, 0], inverse[0, 1], inverse[0, 2]
    i10, i11, i12 = inverse[1, 0], inverse[1, 1], inverse[1, 2]
    i20, i21, i22 = inverse[2, 0], inverse[2, 1], inverse[2, 2]
    h0, h1, h2 = haze[0], haze[1], haze[2]
    total = _NONE
    for i in range(size * size):
        x0, x1, x2 = l0[i] / m0[i] - h0, l1[i] / m1[i] - h1, l2[i] / m2[i] - h2
        n0 = i00 * x0 + i01 * x1 + i02 * x2
        n1 = i10 * x0 + i11 * x1 + i12 * x2
        n2 = i20 * x0 + i21 * x1 + i22 * x2
        e = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) - _ONE
        t = e * e * length
        total += inside[i] * t / (_MOST + t)
    s0, s1, s2 = shade[0], shade[1], shade[2]
    for i in range(size * size - 1):
        d0, d1, d2 = s0[i + 1] - s0[i], s1[i + 1] - s1[i], s2[i + 1] - s2[i]
        t = (d0 * d0 + d1 * d1 + d2 * d2) * precision
        total += across[i] * t / (_MOST + t)
    for i in range(size * size - size):
        d0, d1, d2 = s0[i + size] - s0[i], s1[i + size] - s1[i], s2[i + size] - s2[i]
        t = (d0 * d0 + d1 * d1 + d2 * d2) * precision
        total += down[i] * t / (_MOST + t)
    return _HALF * _MOST * total


@njit(cache=True, fastmath=True, error_model="numpy")
def _shade_again(shade: Any, mixed: Any, new: Any, out: Any) -> None:
    """Fill log s less log of the new mixture: log(b / a) = 2 artanh((b − a) / (b + a)), by its series."""
    for k in range(3):
        was, a, b, become = shade[k], mixed[k], new[k], out[k]
        for i in range(was.size):
            z = (b[i] - a[i]) / (b[i] + a[i])
            y = z * z
            series = _SERIES[0] + y * (_SERIES[1] + y * (_SERIES[2] + y * (_SERIES[3] + y * _SERIES[4])))
            become[i] = was[i] - z * series


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
    labels: Any, lit: Any, state: Any, rho: Any, weights: Any, haze: Any, inverse: Any, length: Any,
    precision: Any, side: int, stride: int, look: int,
) -> int:  # fmt: skip
    """Give each block the label around it that costs least; return how many changed.

    Rows of blocks so far apart that they do not touch what the other sees are decided at the same time.
    state: of `_mix_all`; all numbers in single precision.
    """
    h, w = lit.shape
    margin = weights.size // 2 + 1
    size = side + 2 * margin
    first, rim = max(margin, look), margin + look
    rows = max((h - first - side - rim) // stride + 1, 0)
    apart = (size + margin + look) // stride + 1
    changes = np.zeros(max(rows, 1), np.int64)
    for phase in range(apart):
        for step in prange((rows - phase + apart - 1) // apart):
            row = phase + step * apart
            changes[row] = _move_row(
                labels, lit, state, rho, weights, haze, inverse, length, precision, side, stride,
                look, first + row * stride, first, w - side - rim,
            )  # fmt: skip
    return changes.sum()


@njit(cache=True, error_model="numpy")
def _move_row(
    labels: Any, lit: Any, state: Any, rho: Any, weights: Any, haze: Any, inverse: Any, length: Any,
    precision: Any, side: int, stride: int, look: int, v: int, start: int, stop: int,
) -> int:  # fmt: skip
    """`_move` for the blocks whose first row is v."""
    count, reach = rho.shape[0], weights.size // 2
    margin = reach + 1
    size = side + 2 * margin
    near = np.zeros(count, np.bool_)
    window = np.empty((5, 3, size * size), np.float32)
    own_light, own, own_shade, new, new_shade = window[0], window[1], window[2], window[3], window[4]
    sides = np.zeros((3, size * size), np.float32)
    inside, across, down = sides[0], sides[1], sides[2]
    changed = 0
    for u in range(start, stop, stride):
        is_lit = lit[v, u]
        if not is_lit and side == 1:
            continue
        for a in range(side):
            for b in range(side):
                is_lit |= lit[v + a, u + b]
        if not is_lit:
            continue
        for m in range(count):
            near[m] = False
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
        top, left, i = v - margin, u - margin, 0
        for a in range(top, top + size):
            for b in range(left, left + size):
                is_there = lit[a, b]  # else nothing may be there, and 0 times nothing is not 0
                for k in range(3):
                    own_light[k, i] = state[a, b, k] if is_there else _ONE
                    own[k, i] = state[a, b, 3 + k] if is_there else _ONE
                    own_shade[k, i] = state[a, b, 6 + k] if is_there else _NONE
                is_rim = a == top or b == left or a == top + size - 1 or b == left + size - 1
                inside[i] = is_there and not is_rim
                across[i] = is_there and b < left + size - 1 and lit[a, b + 1]
                down[i] = is_there and a < top + size - 1 and lit[a + 1, b]
                i += 1
        least = _price_of(
            own_light, own, own_shade, inside, across, down, size, haze, inverse, length, precision
        ) + _SEAM_PRICE * _length_of_seam(labels, v, u, side, -1)  # fmt: skip
        best = -1
        for m in range(count):
            if not near[m]:
                continue
            _shift_mixtures(own, labels, v, u, side, m, rho, weights, size, new)
            _shade_again(own_shade, own, new, new_shade)
            price = _price_of(
                own_light, new, new_shade, inside, across, down, size, haze, inverse, length, precision
            ) + _SEAM_PRICE * _length_of_seam(labels, v, u, side, m)  # fmt: skip
            if price < least - _LEAST_GAIN:
                least, best = price, m
        if best < 0:
            continue
        changed += 1
        _shift_mixtures(own, labels, v, u, side, best, rho, weights, size, new)
        for i in range(size * size):
            a, b = top + i // size, left + i % size
            if lit[a, b]:
                for k in range(3):
                    state[a, b, 3 + k] = new[k, i]
                    state[a, b, 6 + k] = np.log(own_light[k, i] / new[k, i])
        for a in range(side):
            for b in range(side):
                labels[v + a, u + b] = best
    return changed


@njit(cache=True, error_model="numpy")
def _shift_mixtures(
    window: Any, labels: Any, v: int, u: int, side: int, m: int, rho: Any, weights: Any, size: int, out: Any
) -> None:
    """Fill mixtures (3, size²) around a block from its own: those with label m in all of it."""
    width = weights.size
    for k in range(3):
        for i in range(size * size):
            out[k, i] = window[k, i]
    for a in range(side):
        for b in range(side):
            old = labels[v + a, u + b]
            if old == m:
                continue
            for k in range(3):
                step = rho[m, k] - rho[old, k]
                for i in range(width):
                    start = (a + i + 1) * size + b + 1
                    for j in range(width):
                        out[k, start + j] += weights[i] * weights[j] * step

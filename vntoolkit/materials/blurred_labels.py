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
from vntoolkit.materials.mixtures import CHUNK_PX, blur_weights, fill_means, room_for, wide_weights
from vntoolkit.materials.pixels import (
    SERIES,
    MaterialLabels,
    Seams,
    Single,
    Spread,
    likeliest_blur_px,
    near_seams,
    scattering,
    take_logs,
    variance_of_lengths,
)
from vntoolkit.materials.reflectance import CAP, Lamps
from vntoolkit.materials.split_frame import noise_of
from vntoolkit.native import njit

_FIRST_BLUR_PX = 1.0  # of a lens and a Bayer pattern; sharper pictures show it, and are decided again
_SEAM_PRICE = 1.0  # of two pixels of two materials side by side
_SHARED = 4.0  # pixels that share their errors: texture and blur reach over 2 × 2
_BLOCK_PX, _BLOCK_SWEEPS, _SWEEPS = 4, 1, 5
_LOOK_PX = 2  # beside a block for labels that it may get
_ENOUGH = 0.01  # share of the pixels beside seams that change when all is settled
_LEAST_STEP = 0.01  # of log s from pixel to pixel
_JUDGED = 20_000  # pixels that tell how shading changes
_LEAST_LIGHT = np.float32(1e-4)
_LEAST_GAIN = 1e-4  # in nats: less is rounding
_REACH_PX = 2  # of the blur
_MARGIN_PX = _REACH_PX + 1  # of a window around a block
_STRIP = 8  # rows, of pixels or of blocks: strips with one between them do not touch what the other sees
LANES = 8  # rows of windows take a multiple of it, and are done so many pixels at a time
MARGIN_PX = _REACH_PX + 3  # around a pixel that may change, where its change is felt
# Of the kernels, which count in single precision.
_ANY_MIXTURE = np.float32(100.0)  # that no change of a label makes 0
_NONE, _HALF, _ONE, _MOST = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(CAP * CAP)


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

    def with_logs(self, logs: Points) -> BlurredLabels:
        """Return the same for materials that were fitted again. logs: (m, 3), log ρ."""
        other = BlurredLabels(self._lamps, logs, self._spread)
        other._seams, other._precision = self._seams, self._precision
        return other

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

    def _in_single(self) -> tuple[Single, Single, Single, Single]:
        """Return split, ρ, haze and L⁻¹ in single precision."""
        lamps = self._lamps
        split, rho, haze, inverse = (
            part.astype(np.float32) for part in (lamps.split, self._reflectances, lamps.haze, lamps.inverse)
        )
        return split, rho, haze, inverse

    @property
    def _precision_of_lengths(self) -> np.float32:
        return np.float32(1.0 / (self._spread.of_pixels**2 + _SHARED * self._spread.of_regions**2))

    def _decided(
        self, values: FloatArray, lit: Mask, labels: MaterialLabels, near: Mask, of_blocks: int, sweeps: int
    ) -> MaterialLabels:
        if self._seams is not None:
            return self._moved(values, lit, labels, near, self._seams.blur_px, of_blocks, sweeps)
        known = lit, self._lamps, self._logs
        tolerance = variance_of_lengths(values, *known, labels)
        steps = _variance_of_steps(values, *known, labels)
        self._precision = 1.0 / (_SHARED * steps)
        found = self._moved(values, lit, labels, near, _FIRST_BLUR_PX, of_blocks, sweeps)
        blur_px = likeliest_blur_px(values, *known, self._spread, found)
        if blur_px != _FIRST_BLUR_PX:
            found = self._moved(values, lit, labels, near, blur_px, of_blocks, sweeps)
        first, second, third = np.linalg.norm(self._lamps.split * noise_of(values, lit), axis=1)
        self._seams = Seams(blur_px, tolerance, steps, (float(first), float(second), float(third)))
        return found

    def _moved(
        self, values: FloatArray, lit: Mask, labels: MaterialLabels, near: Mask, blur_px: float,
        of_blocks: int, sweeps: int,
    ) -> MaterialLabels:  # fmt: skip
        weights = blur_weights(blur_px, _REACH_PX).astype(np.float32)
        found = labels.copy()
        split, rho, haze, inverse = self._in_single()
        room, near = self._room_for(lit.shape), lit & near
        _mix_all(values, found, near, split, rho, wide_weights(weights), room)
        most_left = _ENOUGH * near_seams(labels, 1).sum() if sweeps > 1 else 0
        for by_blocks, most in ((True, of_blocks), (False, sweeps)):
            for _ in range(most):
                changed = _move(
                    found, near, room, rho, weights, haze, inverse, self._precision_of_lengths,
                    np.float32(self._precision), by_blocks,
                )  # fmt: skip
                if changed <= most_left:
                    break
        return found

    def _room_for(self, shape: tuple[int, int]) -> Single:
        """(10, h, w + …), the state of `_mix_all`; windows reach over the right edge."""
        h, w = shape[0], shape[1] + 2 * LANES
        if self._room is None or self._room.shape[1:] != (h, w):
            self._room = np.ones((10, h, w), np.float32)
            self._room[9] = 0.0
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
    """Fill state (10, h, w + …): what each lamp contributes, the mean reflectance under the blur, log of the
    ratio of the two, three planes each, and 1 where it is wanted, 0 elsewhere.

    split: (3, 3), rho: (m, 3) and weights, of `wide_weights`, in single precision.
    """
    h, w = labels.shape
    for v in prange(h):
        light, logs = np.ones(3 * CHUNK_PX, np.float32), np.empty(3 * CHUNK_PX, np.float32)
        exponent = np.empty(3 * CHUNK_PX, np.float32)
        room, u = room_for(len(rho)), 0
        _take_wanted(wanted[v], state[9, v])
        while u < w:
            if not wanted[v, u]:
                u += 1
                continue
            fill_means(labels, v, u, weights, rho, room)
            stop = min(w - u, CHUNK_PX)
            for j in range(stop):
                r, g, b = values[v, u + j, 0], values[v, u + j, 1], values[v, u + j, 2]
                for k in range(3):
                    s = split[k, 0] * r + split[k, 1] * g + split[k, 2] * b
                    light[CHUNK_PX * k + j] = s if s > _LEAST_LIGHT else _LEAST_LIGHT
            for j in range(3 * CHUNK_PX):
                logs[j] = light[j] / room[1][j]
            take_logs(logs, logs.view(np.int32), exponent)
            for k in range(3):
                part = slice(CHUNK_PX * k, CHUNK_PX * k + stop)
                state[k, v, u : u + stop] = light[part]
                state[3 + k, v, u : u + stop] = room[1][part]
                state[6 + k, v, u : u + stop] = logs[part]
            u += CHUNK_PX


@njit(cache=True)
def _take_wanted(wanted: Any, out: Any) -> None:
    for u in range(len(wanted)):
        out[u] = _ONE if wanted[u] else _NONE


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _move(
    labels: Any, lit: Any, state: Any, rho: Any, weights: Any, haze: Any, inverse: Any, length: Any,
    precision: Any, of_blocks: bool,
) -> int:  # fmt: skip
    """Give each pixel, or each of overlapping blocks, the label around it that costs least.

    Returns how many changed. Every second strip of rows is decided at the same time: what is between keeps
    what they see apart. state: of `_mix_all`; all numbers in single precision.
    """
    stride = _BLOCK_PX // 2 if of_blocks else 1
    beyond = _BLOCK_PX + _LOOK_PX - stride if of_blocks else 1
    rows = max((len(labels) - 2 * _MARGIN_PX - beyond) // stride, 0)
    strips = (rows + _STRIP - 1) // _STRIP
    changes = np.zeros(max(strips, 1), np.int64)
    for first in range(2):
        half = (strips - first + 1) // 2
        jump = scattering(half)
        for i in prange(half):
            strip = 2 * (i * jump % half) + first
            for row in range(strip * _STRIP, min((strip + 1) * _STRIP, rows)):
                if of_blocks:
                    changes[strip] += _move_row(
                        labels, lit, state, rho, weights, haze, inverse, length, precision, _BLOCK_PX,
                        _BLOCK_PX // 2, _LOOK_PX, 2 * LANES, _MARGIN_PX + stride * row,
                    )  # fmt: skip
                else:
                    changes[strip] += _move_row(
                        labels, lit, state, rho, weights, haze, inverse, length, precision, 1, 1, 1, LANES,
                        _MARGIN_PX + row,
                    )  # fmt: skip
    return changes.sum()


# What follows is compiled twice into `_move`, where the sizes of windows are constants: only so are many
# pixels done at a time. One array (parts, n) holds all of a window, rows of `lanes` pixels: parts are
# contributions, mixtures and shading of the lamps, where there are pixels, where lengths and steps count and
# where they may, the mixtures and the shading of another label, and what a pixel adds to mixtures around it.
_LIGHT, _MIXED, _SHADE, _THERE, _SIDES, _WHICH, _NEW, _NEW_SHADE, _KERNEL, _PARTS = (
    0, 3, 6, 9, 10, 13, 16, 19, 22, 23
)  # fmt: skip


@njit(cache=True, inline="always", error_model="numpy")
def _move_row(
    labels: Any, lit: Any, state: Any, rho: Any, weights: Any, haze: Any, inverse: Any, length: Any,
    precision: Any, side: int, stride: int, look: int, lanes: int, v: int,
) -> int:  # fmt: skip
    """Move the blocks whose first row is v."""
    count, margin = rho.shape[0], _MARGIN_PX
    size = side + 2 * margin
    n = (size * lanes + 31) // 32 * 32
    window, changed = np.zeros(_PARTS * n, np.float32), 0
    _fill_constants(window, weights, size, lanes, n)
    matrix = (
        inverse[0, 0], inverse[0, 1], inverse[0, 2], inverse[1, 0], inverse[1, 1], inverse[1, 2],
        inverse[2, 0], inverse[2, 1], inverse[2, 2],
    )  # fmt: skip
    ambient = (haze[0], haze[1], haze[2])
    beside, last_moved = np.zeros(lit.shape[1], np.bool_), -2
    if side == 1:
        _find_beside(labels[v - 1], labels[v], labels[v + 1], beside)
    for u in range(margin, lit.shape[1] - side - margin - look, stride):
        if side == 1 and not (beside[u] and lit[v, u]) and u > last_moved + 1:
            continue
        near = _labels_near(labels, lit, v, u, side, look)
        if not near:
            continue
        for k in range(10):
            for a in range(size):
                for b in range(0, lanes, LANES):
                    _copy(state[k, v - margin + a], u - margin + b, window, k * n + a * lanes + b)
        for k in range(_MIXED, _MIXED + 3):  # what is not there counts nothing, and must stay finite
            for i in range(n):
                there = window[_THERE * n + i]
                window[k * n + i] = there * window[k * n + i] + (_ONE - there) * _ANY_MIXTURE
        for k in range(_NEW_SHADE, _NEW_SHADE + 3):  # first and last row, which no change reaches
            for i in range(lanes):
                window[k * n + i] = window[(k - _NEW_SHADE + _SHADE) * n + i]
                to = (size - 1) * lanes + i
                window[k * n + to] = window[(k - _NEW_SHADE + _SHADE) * n + to]
        _fill_sides(window, lanes, n)
        least = _price_of_lengths(window, _MIXED, size, lanes, n, ambient, matrix, length)
        least += _price_of_steps(window, _SHADE, size, lanes, n, precision)
        least += _SEAM_PRICE * _length_of_seam(labels, v, u, side, -1)
        best, last = -1, -1
        for m in range(count):
            if not (near >> m) & 1:
                continue
            _mix_again(window, labels, v, u, side, m, rho, size, lanes, n)
            last = m
            price = _price_of_steps(window, _NEW_SHADE, size, lanes, n, precision)
            price += _SEAM_PRICE * _length_of_seam(labels, v, u, side, m)
            if price >= least:
                continue
            price += _price_of_lengths(window, _NEW, size, lanes, n, ambient, matrix, length)
            if price < least - _LEAST_GAIN:
                least, best = price, m
        if best < 0:
            continue
        changed, last_moved = changed + 1, u
        if best != last:
            _mix_again(window, labels, v, u, side, best, rho, size, lanes, n)
        for k in range(6):
            for a in range(1, size - 1):
                for b in range(1, size - 1):
                    if window[_THERE * n + a * lanes + b] > _NONE:
                        state[3 + k, v - margin + a, u - margin + b] = window[(_NEW + k) * n + a * lanes + b]
        for a in range(side):
            for b in range(side):
                labels[v + a, u + b] = best
    return changed


@njit(cache=True)
def _find_beside(above: Any, row: Any, below: Any, out: Any) -> None:
    """Fill where a row's pixels have a neighbour of another label; nothing at the ends."""
    for u in range(1, len(out) - 1):
        m = row[u]
        out[u] = (above[u] != m) | (below[u] != m) | (row[u - 1] != m) | (row[u + 1] != m)


@njit(cache=True, inline="always")
def _copy(values: Any, begin: int, out: Any, to: int) -> None:
    """Copy LANES numbers at once: all are read before any is written, which may be the same place."""
    v, o = values[begin : begin + LANES], out[to : to + LANES]
    o[0], o[1], o[2], o[3], o[4], o[5], o[6], o[7] = v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7]


@njit(cache=True)
def _labels_near(labels: Any, lit: Any, v: int, u: int, side: int, look: int) -> int:
    """Return which labels a block may get, bit m for label m; 0 for none."""
    own, is_lit, around = 0, False, 0
    for a in range(v, v + side):
        for b in range(u, u + side):
            is_lit |= lit[a, b]
            own |= 1 << labels[a, b]
    if not is_lit:
        return 0
    for a in range(v - look, v + side + look):
        for b in range(u - look, u + side + look):
            around |= (1 << labels[a, b]) * lit[a, b]
    return around & ~own if own & (own - 1) == 0 else around


@njit(cache=True)
def _fill_constants(window: Any, weights: Any, size: int, lanes: int, n: int) -> None:
    """Fill where a window's lengths, steps to the right, and steps below may count, and the kernel."""
    for i in range(_NEW * n):
        window[i] = _ONE
    for i in range(n):
        a, b = i // lanes, i % lanes
        window[_WHICH * n + i] = 0 < a < size - 1 and 0 < b < size - 1
        window[(_WHICH + 1) * n + i] = a < size and b + 1 < size
        window[(_WHICH + 2) * n + i] = a + 1 < size and b < size
    for a in range(weights.size):
        for b in range(weights.size):
            window[_KERNEL * n + a * lanes + b] = weights[a] * weights[b]


@njit(cache=True, inline="always")
def _fill_sides(window: Any, lanes: int, n: int) -> None:
    """Fill where lengths and steps count: where pixels are, and both of a step's."""
    for i in range(n):
        window[_SIDES * n + i] = window[_THERE * n + i] * window[_WHICH * n + i]
    for i in range(n - 1):
        both = window[_THERE * n + i] * window[_THERE * n + i + 1]
        window[(_SIDES + 1) * n + i] = both * window[(_WHICH + 1) * n + i]
    for i in range(n - lanes):
        both = window[_THERE * n + i] * window[_THERE * n + i + lanes]
        window[(_SIDES + 2) * n + i] = both * window[(_WHICH + 2) * n + i]


@njit(cache=True, inline="always", error_model="numpy")
def _price_of_steps(window: Any, shade: int, size: int, lanes: int, n: int, precision: Any) -> Any:
    """Price of a window's steps of shading; shade: the part that counts.

    Only the steps down from its first row and to its last one count there: others stay as they are.
    """
    total = _NONE
    for i in range(lanes, (size - 1) * lanes):
        d0 = window[shade * n + i + 1] - window[shade * n + i]
        d1 = window[(shade + 1) * n + i + 1] - window[(shade + 1) * n + i]
        d2 = window[(shade + 2) * n + i + 1] - window[(shade + 2) * n + i]
        t = (d0 * d0 + d1 * d1 + d2 * d2) * precision
        total += window[(_SIDES + 1) * n + i] * t / (_MOST + t)
    for i in range((size - 1) * lanes):
        d0 = window[shade * n + i + lanes] - window[shade * n + i]
        d1 = window[(shade + 1) * n + i + lanes] - window[(shade + 1) * n + i]
        d2 = window[(shade + 2) * n + i + lanes] - window[(shade + 2) * n + i]
        t = (d0 * d0 + d1 * d1 + d2 * d2) * precision
        total += window[(_SIDES + 2) * n + i] * t / (_MOST + t)
    return _HALF * _MOST * total


@njit(cache=True, inline="always", error_model="numpy")
def _price_of_lengths(
    window: Any, mixed: int, size: int, lanes: int, n: int, haze: Any, matrix: Any, length: Any
) -> Any:
    """Price of a window's lengths; mixed: the part that counts."""
    total = _NONE
    for i in range(lanes, (size - 1) * lanes):
        x0 = window[_LIGHT * n + i] / window[mixed * n + i] - haze[0]
        x1 = window[(_LIGHT + 1) * n + i] / window[(mixed + 1) * n + i] - haze[1]
        x2 = window[(_LIGHT + 2) * n + i] / window[(mixed + 2) * n + i] - haze[2]
        n0 = matrix[0] * x0 + matrix[1] * x1 + matrix[2] * x2
        n1 = matrix[3] * x0 + matrix[4] * x1 + matrix[5] * x2
        n2 = matrix[6] * x0 + matrix[7] * x1 + matrix[8] * x2
        e = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) - _ONE
        t = e * e * length
        total += window[_SIDES * n + i] * t / (_MOST + t)
    return _HALF * _MOST * total


@njit(cache=True, inline="always", error_model="numpy")
def _mix_again(
    window: Any, labels: Any, v: int, u: int, side: int, m: int, rho: Any, size: int, lanes: int, n: int
) -> None:
    """Fill the mixtures around a block with label m in all of it, and the shading.

    log(b / a) = 2 artanh((b − a) / (b + a)), by its series.
    """
    for k in range(3):
        for i in range(lanes, (size - 1) * lanes):
            window[(_NEW + k) * n + i] = window[(_MIXED + k) * n + i]
        for a in range(side):
            for b in range(side):
                step, to = rho[m, k] - rho[labels[v + a, u + b], k], (_NEW + k) * n + (a + 1) * lanes + b + 1
                if step != _NONE:
                    for i in range((2 * _REACH_PX + 1) * lanes):
                        window[to + i] += step * window[_KERNEL * n + i]
        for i in range(lanes, (size - 1) * lanes):
            was, become = window[(_MIXED + k) * n + i], window[(_NEW + k) * n + i]
            z = (become - was) / (become + was)
            y = z * z
            series = SERIES[0] + y * (SERIES[1] + y * (SERIES[2] + y * (SERIES[3] + y * SERIES[4])))
            window[(_NEW_SHADE + k) * n + i] = window[(_SHADE + k) * n + i] - z * series


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

"""From the materials of regions to those of pixels.

Shading goes on where a material ends. So the step of log s from pixel to pixel tells whether a seam is there,
and of which materials: lines of pixels are decided at once, by that and by the unit length of normals. Lens
and Bayer pattern then blur the seams. Light adds, so that the map of reflectances is blurred as the picture.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.materials.mixtures import MOST_REACH_PX, blur_weights
from vntoolkit.materials.reflectance import CAP, Lamps, bias_of_noise, length_and_variance
from vntoolkit.native import njit
from vntoolkit.photometry.levelling import span_of

Single = npt.NDArray[np.float32]
MaterialLabels = npt.NDArray[np.uint8]
INDEPENDENT_PX = 64.0  # pixels that share their errors: lamps, gloss and ambient light change slowly
_SEAM_PRICE = np.float32(1.0)  # of two pixels of two materials side by side
_NO_LABEL = 255
_GOLDEN = 0.618  # section: its multiples lie evenly
_SHARES = 16  # that threads add up alone
_NONE, _HALF, _ONE, _OF_CAP = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(CAP**-2)
_INFINITE = np.float32(np.inf)
# The series of 2 artanh(z) / z in z².
SERIES = tuple(np.float32(2.0 / k) for k in (1, 3, 5, 7, 9))
_ROOT, _LOG_2 = np.float32(np.sqrt(2.0)), np.float32(np.log(2.0))
_LEAST_STEP = 0.01  # of log s from pixel to pixel
_MOST, _MOST_SIGMAS = 0.8, 1.2816  # quantile of the steps that is of shading, not of paint, and its distance
_AROUND = 3  # pixels of a chain to each side that a change moves, but for a few
_SWEEPS, _SETTLED = 4, 0.002  # at most, and share of the pixels that change when all is settled
_BLURS_PX = (0.0, 0.5, 0.7, 1.0, 1.4)  # standard deviations that are tried
_BLURRED_PX = 0.6  # from where a step of paint takes three pixels
_REACH_BLURRED = 3
_JUDGED = 4000  # pixels beside seams that tell the blur
_JUDGED_STEPS = 20_000  # pixels of the rows that tell how far shading changes


class Spread(NamedTuple):
    """Standard deviation of normals' lengths beyond noise, which no other material explains.

    of_regions: from region to region: uneven dye, light between folds. of_pixels: within them: knit, gloss.
    """

    of_regions: float
    of_pixels: float


class Seams(NamedTuple):
    """What tells the light on a pixel in one of several materials, or in a mixture of two beside a seam.

    blur_px: standard deviation of the picture's blur. tolerance: variance of normals' lengths, with noise.
    steps: variance of the step of log light from pixel to pixel. noise: standard deviation of a pixel's
    contribution of each lamp.
    """

    blur_px: float
    tolerance: float
    steps: float
    noise: tuple[float, float, float]


class PixelLabeller:
    """Decides labels of pixels, of the frame that it looks at.

    The first frame tells the blur and how far shading changes.

    lamps: with the noise of the pixels. logs: (m, 3), log ρ. blur_px: standard deviation of seams' blur.
    """

    def __init__(self, lamps: Lamps, logs: Points, spread: Spread) -> None:
        self._lamps, self._logs, self.spread = lamps, logs, spread
        self._reach = 1
        self._room: tuple[Single, Single] | None = None
        self._steps_of: tuple[int, float] | None = None  # reach and variance of those that the room has
        self._variance: float | None = None
        self._tolerance = spread.of_pixels**2 + INDEPENDENT_PX * spread.of_regions**2
        self.blur_px = 0.0
        self._values: FloatArray = np.empty((0, 0, 3))
        self._lit: Mask = np.empty((0, 0), np.bool_)
        self._of_lengths: tuple[Single, MaterialLabels]

    def with_logs(self, logs: Points) -> PixelLabeller:
        """Return the same for materials that were fitted again. logs: (m, 3), log ρ."""
        other = PixelLabeller(self._lamps, logs, self.spread)
        other._reach, other._variance, other.blur_px = self._reach, self._variance, self.blur_px
        return other

    def look_at(self, values: FloatArray, lit: Mask) -> None:
        """Take the frame that is decided next. values: (h, w, 3), colours. lit: (h, w), where they count."""
        self._values, self._lit = values, lit
        self._of_lengths = np.zeros(lit.shape, np.float32), np.full(lit.shape, _NO_LABEL, np.uint8)
        self._steps_of = None

    def decided(self, labels: MaterialLabels, active: Mask) -> MaterialLabels:
        """Return labels (h, w) of little cost, from labels (h, w), line by line.

        active: pixels that are decided, among all labels. The first frame tells the blur.
        """
        active = active & self._lit
        allowed = np.full(labels.shape, 2 ** len(self._logs) - 1, np.uint16)
        if self._variance is not None:
            return self._by_lines(labels, active, allowed, _SWEEPS)
        known = self._values, self._lit, self._lamps, self._logs, self.spread
        found = self._by_lines(labels, active, allowed, _SWEEPS)
        self.blur_px = likeliest_blur_px(*known, found)
        if self.blur_px >= _BLURRED_PX:
            self._reach, self._variance = _REACH_BLURRED, None
            found = self._by_lines(labels, active, allowed, _SWEEPS)
            self.blur_px = likeliest_blur_px(*known, found)
        return found

    def followed(self, labels: MaterialLabels, active: Mask, any_label: Mask, sweeps: int) -> MaterialLabels:
        """Return labels (h, w) of little cost, from those of the frame before.

        active: pixels that are decided, among the labels around them, or, where `any_label`, a mask, is True,
        among all.
        """
        active = active & self._lit
        allowed = np.full(labels.shape, 2 ** len(self._logs) - 1, np.uint16)
        _labels_around(labels, any_label, active, allowed)
        return self._by_lines(labels, active, allowed, sweeps)

    def prices(self, labels: MaterialLabels) -> Single:
        """(h, w), nats that each pixel's length costs under its label, and the steps to right and below.

        They are kept, and found again where labels change.
        """
        assert self._variance is not None
        lamps, (out, before) = self._lamps, self._of_lengths
        _price(
            self._values, self._lit, labels, before, lamps.split, self._logs, lamps.haze, lamps.inverse,
            lamps.mixing, lamps.noise, self._tolerance, self._reach, self._steps(), out,
        )  # fmt: skip
        before[...] = labels
        return out

    def _by_lines(
        self, labels: MaterialLabels, active: Mask, allowed: npt.NDArray[np.uint16], sweeps: int
    ) -> MaterialLabels:
        """Decide rows and columns in turn, each whole line at once (viterbi1967), until hardly any change."""
        lamps, logs, reach = self._lamps, self._logs, self._reach
        unary = self._room_for(self._values)[1]
        _price_lengths(
            self._values, lamps.split, np.exp(-logs), lamps.haze, lamps.inverse, lamps.mixing, lamps.noise,
            self._tolerance, active, allowed, unary,
        )  # fmt: skip
        if self._variance is None:
            self._variance = _shading_variance(self._values, self._lit, lamps, reach)
        steps, z = self._steps(), logs.astype(np.float32)
        found, extents, when = labels.copy(), _extents(active), np.zeros(labels.shape, np.uint8)
        far = max(labels.shape) if sweeps == _SWEEPS else _AROUND
        for sweep in range(sweeps):
            changed = 0
            for k in range(4):
                upright, first = k < 2, k % 2
                changed += _decide_lines(
                    found, steps, unary, active, allowed, z, reach, upright, first,
                    extents[0 if upright else 1], 4 * sweep + k + 1, far, when,
                )  # fmt: skip
            if changed <= _SETTLED * np.count_nonzero(active):
                break
        return found

    def _steps(self) -> Single:
        """(h, w, 2, 6), of `_take_steps`, of the frame that is looked at."""
        assert self._variance is not None
        steps, lamps = self._room_for(self._values)[0], self._lamps
        if self._steps_of != (self._reach, self._variance):
            self._steps_of = self._reach, self._variance
            split, deviation = lamps.split.astype(np.float32), lamps.noise.astype(np.float32)
            _take_steps(
                self._values, self._lit, split, deviation, np.float32(self._variance), self._reach, steps
            )
        return steps

    def _room_for(self, values: FloatArray) -> tuple[Single, Single]:
        """Return arrays for steps and for prices; new ones would cost a frame 20 ms."""
        shape = values.shape[:2]
        if self._room is None or self._room[0].shape[:2] != shape:
            self._room = (
                np.zeros((*shape, 2, 6), np.float32), np.empty((*shape, len(self._logs)), np.float32)
            )  # fmt: skip
        return self._room


def variance_of_lengths(
    values: FloatArray, lit: Mask, lamps: Lamps, logs: Points, labels: MaterialLabels
) -> float:
    """Robust variance of the normals' lengths: of noise, texture, gloss, and light between folds."""
    chosen = np.flatnonzero(lit)[:: max(1, lit.size // _JUDGED_STEPS)]
    s = values.reshape(-1, 3)[chosen] @ lamps.split.T
    normals = (s * np.exp(-logs[labels.ravel()[chosen]]) - lamps.haze) @ lamps.inverse.T
    return max((1.4826 * float(np.median(np.abs(np.linalg.norm(normals, axis=1) - 1.0)))) ** 2, 1e-6)


def _shading_variance(values: FloatArray, lit: Mask, lamps: Lamps, reach: int) -> float:
    """Variance of the step of log s over `reach` pixels by shape and texture, beyond noise."""
    rows = slice(None, None, max(1, lit.size // _JUDGED_STEPS))
    both = lit[rows, reach:] & lit[rows, :-reach]
    if not both.any():
        return _LEAST_STEP**2
    here, there = (
        np.maximum(part[both] @ lamps.split.T, lamps.noise)
        for part in (values[rows, :-reach], values[rows, reach:])
    )
    steps = np.abs(np.log(there / here))
    noise = np.median((lamps.noise / here) ** 2 + (lamps.noise / there) ** 2)
    return float(max((np.quantile(steps, _MOST) / _MOST_SIGMAS) ** 2 - noise, _LEAST_STEP**2))


@njit(cache=True, fastmath=True, error_model="numpy")
def take_logs(values: Any, bits: Any, exponent: Any) -> None:
    """Replace values (n,), positive, by their logarithms: the exponent's and a series of the rest.

    bits: the same numbers as integers. exponent: room for n.
    """
    for j in range(len(values)):
        exponent[j] = np.float32((bits[j] >> 23) - 127)
        bits[j] = (bits[j] & 0x7FFFFF) | 0x3F800000
    for j in range(len(values)):
        z = (values[j] - _ROOT) / (values[j] + _ROOT)
        y = z * z
        series = SERIES[0] + y * (SERIES[1] + y * (SERIES[2] + y * (SERIES[3] + y * SERIES[4])))
        values[j] = (exponent[j] + _HALF) * _LOG_2 + z * series


@njit(cache=True, parallel=True, error_model="numpy")
def _take_steps(
    values: Any, lit: Any, split: Any, deviation: Any, variance: Any, reach: int, out: Any
) -> None:
    """Fill out (h, w, 2, 6): the step of log s to the pixel `reach` to the right and below, and 1 over its
    variance by shading and noise; 0 where either is not lit. All but values in single precision.
    """
    h, w = lit.shape
    light, noise = np.empty((h, 3, w), np.float32), np.empty((h, 3, w), np.float32)
    for v in prange(h):
        bits, exponent = light[v].view(np.int32), np.empty(w, np.float32)
        first, last = span_of(lit[v])
        for k in range(3):
            for u in range(first, last):
                s = split[k, 0] * np.float32(values[v, u, 0]) + split[k, 1] * np.float32(values[v, u, 1])
                s = max(s + split[k, 2] * np.float32(values[v, u, 2]), deviation[k])
                light[v, k, u] = s
                noise[v, k, u] = (deviation[k] / s) * (deviation[k] / s)
            take_logs(light[v, k, first:last], bits[k, first:last], exponent)
    for v in prange(h):
        first, last = span_of(lit[v])
        out[v, :first], out[v, last:] = _NONE, _NONE
        for u in range(first, last):
            for way in range(2):
                a, b = v + way * reach, u + (1 - way) * reach
                both = a < h and b < w and lit[v, u] and lit[min(a, h - 1), min(b, w - 1)]
                for k in range(3):
                    out[v, u, way, k] = light[a, k, b] - light[v, k, u] if both else _NONE
                    noises = noise[v, k, u] + noise[a, k, b] if both else _NONE
                    out[v, u, way, 3 + k] = _ONE / (variance + noises) if both else _NONE


@njit(cache=True, inline="always", error_model="numpy")
def _take_light(rgb: Any, split: Any, deviation: Any, s: Any) -> None:
    """Fill s (3,), what every lamp contributes to a colour."""
    for k in range(3):
        s[k] = max(split[k, 0] * rgb[0] + split[k, 1] * rgb[1] + split[k, 2] * rgb[2], deviation[k])


@njit(cache=True, parallel=True, error_model="numpy")
def _price_lengths(
    values: Any, split: Any, q: Any, haze: Any, inverse: Any, mixing: Any, deviation: Any, tolerance: float,
    active: Any, allowed: Any, unary: Any,
) -> None:  # fmt: skip
    """Fill the price of the length of active pixels for each material that is allowed."""
    h, w = active.shape
    count = q.shape[0]
    bias = np.array([bias_of_noise(q[m], inverse, mixing) for m in range(count)])
    for v in prange(h):
        j, s = np.empty(3), np.empty(3)
        for u in range(w):
            if not active[v, u]:
                continue
            _take_light(values[v, u], split, deviation, s)
            for m in range(count):
                if (allowed[v, u] >> m) & 1:
                    e, variance = length_and_variance(s, q[m], haze, inverse, mixing, bias[m], j)
                    t = e * e / (variance + tolerance)
                    unary[v, u, m] = 0.5 * t / (1.0 + t / (CAP * CAP))


@njit(cache=True, parallel=True, error_model="numpy")
def _price(
    values: Any, lit: Any, labels: Any, before: Any, split: Any, z: Any, haze: Any, inverse: Any,
    mixing: Any, deviation: Any, tolerance: float, reach: int, steps: Any, out: Any,
) -> None:  # fmt: skip
    """Fill `out` with each pixel's price of its length and of its steps to right and below.

    before: labels under which `out` is filled already. steps: of `_take_steps`.
    """
    h, w = lit.shape
    q = np.exp(-z)
    bias = np.array([bias_of_noise(q[m], inverse, mixing) for m in range(z.shape[0])])
    for v in prange(h):
        j, s = np.empty(3), np.empty(3)
        for u in range(w):
            if not lit[v, u]:
                continue
            m, is_new = labels[v, u], labels[v, u] != before[v, u]
            if u + reach < w:
                is_new |= labels[v, u + reach] != before[v, u + reach]
            if v + reach < h:
                is_new |= labels[v + reach, u] != before[v + reach, u]
            if not is_new:
                continue
            _take_light(values[v, u], split, deviation, s)
            e, spread = length_and_variance(s, q[m], haze, inverse, mixing, bias[m], j)
            t = e * e / (spread + tolerance)
            total = 0.5 * t / (1.0 + t / (CAP * CAP))
            for way in range(2):
                if steps[v, u, way, 3] > _NONE:
                    n = labels[v + way * reach, u + (1 - way) * reach]
                    total += _change(steps[v, u, way], z[m], z[n])
            out[v, u] = total


@njit(cache=True, parallel=True)
def _labels_around(labels: Any, any_label: Any, active: Any, allowed: Any) -> None:
    """Leave each active pixel the labels that are within the window around it, and none active that has one.

    any_label: (h, w), pixels that are left all.
    """
    h, w = labels.shape
    beside = np.empty((h, w), np.uint16)
    for v in prange(h):
        there = np.zeros(w + 2 * MOST_REACH_PX, np.uint16)
        _take_bits(labels[v], there[MOST_REACH_PX : MOST_REACH_PX + w])
        _any_of(there, 2 * MOST_REACH_PX + 1, beside[v])
    for v in prange(h):
        there = np.zeros(w, np.uint16)
        for a in range(max(v - MOST_REACH_PX, 0), min(v + MOST_REACH_PX + 1, h)):
            _add_any(beside[a], there)
        for u in range(w):
            if active[v, u] and not any_label[v, u]:
                allowed[v, u] = there[u]
                active[v, u] = there[u] & (there[u] - 1) != 0


@njit(cache=True)
def _take_bits(labels: Any, out: Any) -> None:
    for u in range(len(labels)):
        out[u] = 1 << labels[u]


@njit(cache=True)
def _extents(active: Any) -> Any:
    """Return where the active pixels of each row (h, 2) and of each column (w, 2) begin and end."""
    h, w = active.shape
    rows, columns = np.zeros((h, 2), np.int64), np.zeros((w, 2), np.int64)
    rows[:, 0], columns[:, 0] = w, h
    for v in range(h):
        for u in range(w):
            if active[v, u]:
                rows[v, 0] = min(rows[v, 0], u)
                rows[v, 1] = u + 1
                columns[u, 0] = min(columns[u, 0], v)
                columns[u, 1] = v + 1
    return rows, columns


@njit(cache=True, inline="always", error_model="numpy")
def _change(step: Any, one: Any, other: Any) -> Any:
    """Price of a step, of `_take_steps`, from one material to another: how little shading goes on."""
    t = _NONE
    for k in range(3):
        rest = step[k] - other[k] + one[k]
        t += rest * rest * step[3 + k]
    return _HALF * t / (_ONE + t * _OF_CAP)


@njit(cache=True)
def scattering(count: int) -> int:
    """Return k so that i k mod count, i = 0, 1 … count − 1, takes every number once and neighbours far apart.

    Threads get i in a row each. So they share the work evenly wherever in a picture it is.
    """
    k = max(int(_GOLDEN * count), 1)
    while True:
        a, b = k, count
        while b:
            a, b = b, a % b
        if a <= 1:
            return k
        k += 1


@njit(cache=True, parallel=True, error_model="numpy")
def _decide_lines(
    labels: Any, steps: Any, unary: Any, active: Any, allowed: Any, z: Any, reach: int, upright: bool,
    first: int, extents: Any, now: int, far: int, changed: Any,
) -> int:  # fmt: skip
    """Give every second row or column its labels of least cost, those beside it being as they are.

    Return how many changed. upright: rows. A chain goes over every pixel, or leaps over blurred ones: then
    chains alternate. extents: (lines, 2), where the active pixels of each line begin and end. z, steps,
    unary: in single precision. changed: (h, w), number of the call, counted from 1, in which a label changed
    last. now: number of this call. The fourth before it was of the same lines; labels along whose chain
    nothing changed since as near as `far` are left as they are: deciding them again would move hardly any.
    """
    h, w, count = unary.shape
    lines, length = (h, w) if upright else (w, h)
    changes = np.zeros(_SHARES, np.int64)
    for part in prange(_SHARES):
        # Of every pixel: the labels that it may get, what each costs, and which of the pixel before it needs.
        number, kinds = np.zeros(length, np.int64), np.empty((length, count), np.int64)
        total, source = np.empty((length, count), np.float32), np.zeros((length, count), np.int64)
        waits = np.ones(length, np.bool_)
        for line in range(first + 2 * part, lines, 2 * _SHARES):
            begin, end = extents[line]
            if now > 4 and not _find_waiting(changed, line, reach, upright, now - 4, far, waits):
                continue
            for offset in range(reach):
                t = begin + offset
                while t < end:
                    start = t
                    while t < end and waits[t] and (active[line, t] if upright else active[t, line]):
                        t += reach
                    if t == start:
                        t += reach
                        continue
                    _decide_chain(
                        labels, steps, unary, allowed, z, reach, upright, line, start, t, number, kinds,
                        total, source,
                    )  # fmt: skip
                    taken = total[t - reach, : number[t - reach]].argmin()
                    for back in range(t - reach, start - 1, -reach):
                        v, u = (line, back) if upright else (back, line)
                        if labels[v, u] != kinds[back, taken]:
                            labels[v, u], changed[v, u] = kinds[back, taken], now
                            changes[part] += 1
                        taken = source[back, taken]
    return changes.sum()


@njit(cache=True, error_model="numpy")
def _decide_chain(
    labels: Any, steps: Any, unary: Any, allowed: Any, z: Any, reach: int, upright: bool, line: int,
    start: int, stop: int, number: Any, kinds: Any, total: Any, source: Any,
) -> None:  # fmt: skip
    """Fill what the labels of a chain cost, from its start to each of its pixels."""
    count = unary.shape[2]
    seam = _SEAM_PRICE / np.float32(reach)  # so many pairs have a seam between them
    down, right = (0, reach) if upright else (reach, 0)  # along the chain
    along, aside = (0, 1) if upright else (1, 0)
    for at in range(start, stop, reach):
        v, u = (line, at) if upright else (at, line)
        found, before = 0, at - reach
        for m in range(count):
            if (allowed[v, u] >> m) & 1:
                kinds[at, found], total[at, found] = m, unary[v, u, m]
                found += 1
        number[at] = found
        if v >= right and u >= down:
            a, b = v - right, u - down
            if steps[a, b, aside, 3] > _NONE:
                _add_change(steps[a, b, aside], _ONE, labels[a, b], kinds[at], z, seam, found, total[at])
        if steps[v, u, aside, 3] > _NONE:
            n = labels[v + right, u + down]
            _add_change(steps[v, u, aside], -_ONE, n, kinds[at], z, seam, found, total[at])
        if at + reach >= stop and steps[v, u, along, 3] > _NONE:  # else the pixel there asks back
            n = labels[v + down, u + right]
            _add_change(steps[v, u, along], -_ONE, n, kinds[at], z, seam, found, total[at])
        if before < 0 or not steps[v - down, u - right, along, 3] > _NONE:
            continue
        step = steps[v - down, u - right, along]
        if before < start:
            n = labels[v - down, u - right]
            _add_change(step, _ONE, n, kinds[at], z, seam, found, total[at])
            continue
        d0, d1, d2, w0, w1, w2 = step[0], step[1], step[2], step[3], step[4], step[5]
        for p in range(found):
            m, least, best = kinds[at, p], _INFINITE, 0
            x0, x1, x2 = d0 - z[m, 0], d1 - z[m, 1], d2 - z[m, 2]
            for q in range(number[before]):
                n = kinds[before, q]
                y0, y1, y2 = x0 + z[n, 0], x1 + z[n, 1], x2 + z[n, 2]
                rest = y0 * y0 * w0 + y1 * y1 * w1 + y2 * y2 * w2
                cost = total[before, q] + _HALF * rest / (_ONE + rest * _OF_CAP)
                cost += seam if n != m else _NONE
                best = q if cost < least else best
                least = min(cost, least)
            total[at, p] += least
            source[at, p] = best


@njit(cache=True, inline="always", error_model="numpy")
def _add_change(step: Any, sign: Any, n: int, kinds: Any, z: Any, seam: Any, found: int, total: Any) -> None:
    """Add the price of a step from label n, or, where the sign is −1, to it, for each kind here."""
    d0, d1, d2 = sign * step[0] + z[n, 0], sign * step[1] + z[n, 1], sign * step[2] + z[n, 2]
    w0, w1, w2 = step[3], step[4], step[5]
    for p in range(found):
        m = kinds[p]
        y0, y1, y2 = d0 - z[m, 0], d1 - z[m, 1], d2 - z[m, 2]
        rest = y0 * y0 * w0 + y1 * y1 * w1 + y2 * y2 * w2
        total[p] += _HALF * rest / (_ONE + rest * _OF_CAP) + (seam if n != m else _NONE)


@njit(cache=True)
def _find_waiting(
    changed: Any, line: int, reach: int, upright: bool, since: int, far: int, waits: Any
) -> bool:
    """Fill where on a line labels wait to be decided again; return whether any does.

    They do near a label that changed, on the line or beside it, after call `since`, which decided the line.
    changed: see `_decide_lines`.
    """
    lines, length, is_any = changed.shape[0 if upright else 1], len(waits), False
    waits[:] = False
    for at in (line - reach, line, line + reach):
        if 0 <= at < lines:
            for t in range(length):
                if (changed[at, t] if upright else changed[t, at]) > since:
                    is_any = True
                    for k in range(max(t - far * reach, t % reach), min(t + far * reach + 1, length), reach):
                        waits[k] = True
    return is_any


# Blur.


def likeliest_blur_px(
    values: FloatArray, lit: Mask, lamps: Lamps, logs: Points, spread: Spread, labels: MaterialLabels
) -> float:
    """The standard deviation of the blur under which normals beside seams are most nearly of unit length."""
    beside = np.flatnonzero(_beside_seams(labels, lit))
    v, u = np.unravel_index(beside[:: max(1, len(beside) // _JUDGED)], labels.shape)
    if not len(v):
        return 0.0
    tolerance = spread.of_pixels**2 + spread.of_regions**2
    s = values[v, u] @ lamps.split.T
    costs = [
        _cost_of_blur(
            v,
            u,
            s,
            labels,
            np.exp(logs),
            blur_weights(blur),
            lamps.haze,
            lamps.inverse,
            lamps.mixing,
            tolerance,
        )
        for blur in _BLURS_PX
    ]
    return _BLURS_PX[int(np.argmin(costs))]


@njit(cache=True, parallel=True)
def near_seams(labels: Any, reach: int) -> Any:
    """True where another label is within a window, `reach` to either side."""
    h, w = labels.shape
    near, beside, below = np.empty((h, w), np.bool_), np.empty((h, w), np.bool_), np.empty((h, w), np.bool_)
    for v in prange(h):
        seams = np.zeros(w + 2 * reach, np.bool_)
        if w > 1:
            _differ(labels[v, :-1], labels[v, 1:], seams[reach : reach + w - 1])
        _any_of(seams, 2 * reach, beside[v])
        _differ(labels[v], labels[min(v + 1, h - 1)], seams[reach : reach + w])
        _any_of(seams, 2 * reach + 1, below[v])
    for v in prange(h):
        near[v] = False
        for a in range(max(v - reach, 0), min(v + reach + 1, h)):
            _add_any(beside[a], near[v])
            if a < v + reach:
                _add_any(below[a], near[v])
    return near


@njit(cache=True)
def _differ(one: Any, other: Any, out: Any) -> None:
    for u in range(len(one)):
        out[u] = one[u] != other[u]


@njit(cache=True)
def _any_of(flags: Any, count: int, out: Any) -> None:
    """Fill out (n,) with whether any of flags u … u + count − 1 is true."""
    out[:] = 0
    for shift in range(count):
        _add_any(flags[shift : shift + len(out)], out)


@njit(cache=True)
def _add_any(flags: Any, out: Any) -> None:
    for u in range(len(out)):
        out[u] |= flags[u]


@njit(cache=True, parallel=True)
def _beside_seams(labels: Any, lit: Any) -> Any:
    h, w = labels.shape
    out = np.zeros((h, w), np.bool_)
    for v in prange(h):
        for u in range(w):
            if lit[v, u]:
                for way in range(4):
                    a = v + 2 * (way == 3) - 2 * (way == 2)
                    b = u + 2 * (way == 1) - 2 * (way == 0)
                    if 0 <= a < h and 0 <= b < w and lit[a, b] and labels[a, b] != labels[v, u]:
                        out[v, u] = True
    return out


@njit(cache=True, error_model="numpy")
def _mix(v: int, u: int, labels: Any, rho: Any, weights: Any, shares: Any, out: Any) -> None:
    """Fill each material's share of the window around a pixel (m,), and the mean reflectance."""
    h, w = labels.shape
    reach = weights.size // 2
    shares[:] = 0.0
    for a in range(-reach, reach + 1):
        row = min(max(v + a, 0), h - 1)
        for b in range(-reach, reach + 1):
            shares[labels[row, min(max(u + b, 0), w - 1)]] += weights[a + reach] * weights[b + reach]
    out[:] = 0.0
    for m in range(shares.size):
        if shares[m] > 0.0:
            for k in range(3):
                out[k] += shares[m] * rho[m, k]


@njit(cache=True, parallel=True, error_model="numpy")
def _cost_of_blur(
    v: Any, u: Any, s: Any, labels: Any, rho: Any, weights: Any, haze: Any, inverse: Any, mixing: Any,
    tolerance: float,
) -> float:  # fmt: skip
    totals = np.zeros(_SHARES)
    for share in prange(_SHARES):
        mean, q, j, shares = np.empty(3), np.empty(3), np.empty(3), np.empty(rho.shape[0])
        for i in range(share, v.size, _SHARES):
            _mix(v[i], u[i], labels, rho, weights, shares, mean)
            for k in range(3):
                q[k] = 1.0 / mean[k]
            bias = bias_of_noise(q, inverse, mixing)
            e, variance = length_and_variance(s[i], q, haze, inverse, mixing, bias, j)
            t = e * e / (variance + tolerance)
            totals[share] += 0.5 * t / (1.0 + t / (CAP * CAP))
    return totals.sum()

"""From the materials of regions to those of pixels, and what a frame would look like in one material.

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
from vntoolkit.materials.reflectance import CAP, Lamps, bias_of_noise, length_and_variance
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

MaterialLabels = npt.NDArray[np.uint8]
INDEPENDENT_PX = 64.0  # pixels that share their errors: lamps, gloss and ambient light change slowly
_SEAM_PRICE = 1.0  # of two pixels of two materials side by side
_LEAST_STEP = 0.01  # of log s from pixel to pixel
_MOST, _MOST_SIGMAS = 0.8, 1.2816  # quantile of the steps that is of shading, not of paint, and its distance
_SWEEPS, _SETTLED = 4, 0.002  # at most, and share of the pixels that change when all is settled
_BLURS_PX = (0.0, 0.5, 0.7, 1.0, 1.4)  # standard deviations that are tried
_BLURRED_PX = 0.6  # from where a step of paint takes three pixels
_REACH_BLURRED = 3
_WINDOW = 3  # pixels to either side over which a seam is blurred
_JUDGED = 4000  # pixels beside seams that tell the blur
_JUDGED_STEPS = 60_000  # pixels of the rows that tell how far shading changes


class Spread(NamedTuple):
    """Standard deviation of normals' lengths beyond noise, which no other material explains.

    of_regions: from region to region: uneven dye, light between folds. of_pixels: within them: knit, gloss.
    """

    of_regions: float
    of_pixels: float


def decided(
    values: FloatArray, lit: Mask, lamps: Lamps, logs: Points, spread: Spread, labels: MaterialLabels,
    active: Mask, blur_px: float | None = None, any_label: bool = True,
) -> tuple[MaterialLabels, float]:  # fmt: skip
    """Return labels (h, w) of little cost, from labels (h, w), and how far seams are blurred.

    values: (h, w, 3) float32, colours. active: pixels that are decided, among all labels or those around
    them. blur_px: standard deviation, found where not given.
    """
    active = active & lit
    allowed = np.full(labels.shape, 2 ** len(logs) - 1, np.uint16)
    if not any_label:
        _labels_around(labels, active, allowed)
    is_given = blur_px is not None
    reach = _REACH_BLURRED if (blur_px or 0.0) >= _BLURRED_PX else 1
    while True:
        found = _of_least_cost(values, lit, lamps, logs, spread, labels, active, allowed, reach)
        if not is_given:
            blur_px = _blur_px(values, lit, lamps, logs, spread, found)
        assert blur_px is not None
        if is_given or reach > 1 or blur_px < _BLURRED_PX:
            return found, blur_px
        reach = _REACH_BLURRED


def relit(
    frame: LinearFrame,
    response: LightResponse,
    labels: MaterialLabels,
    reflectances: Points,
    blur_px: float = 0.0,
) -> LinearFrame:
    """Return the frame as it would be with the calibration material everywhere: r' = Cᵀ (C⁻ᵀ r ∘ 1/ρ).

    labels: (h, w), numbers of the reflectances (m, 3). blur_px: standard deviation of the blur of
    seams. Ambient light falls on the material too: it is divided by ρ with the rest.
    """
    split = response.contributions_from_rgb
    merge = np.linalg.inv(split)
    values = np.asarray(reflectances, np.float64)
    matrices = np.array([merge @ np.diag(1.0 / rho) @ split for rho in values])
    out = np.empty(frame.rgb.shape, np.float32)
    _relight(
        np.ascontiguousarray(frame.rgb), labels, matrices.astype(np.float32), values, split, merge,
        _weights(blur_px), blur_px > 0.0 and len(values) > 1, out,
    )  # fmt: skip
    return LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)


def colours_of(reflectances: Points, response: LightResponse) -> FloatArray:
    """(m, 3), linear colour 0 to 1 of each material in the light of all three lamps, balanced to white.

    White is the calibration material, or the strongest material where one returns more.
    """
    colours = np.abs(np.linalg.inv(response.contributions_from_rgb).T)
    seen = np.asarray(reflectances) @ colours / colours.sum(axis=0)
    return np.asarray(seen / max(1.0, float(seen.max())))


def _of_least_cost(
    values: FloatArray, lit: Mask, lamps: Lamps, logs: Points, spread: Spread, labels: MaterialLabels,
    active: Mask, allowed: npt.NDArray[np.uint16], reach: int,
) -> MaterialLabels:  # fmt: skip
    """Decide rows and columns in turn, each whole line at once (viterbi1967), until hardly any change."""
    light, noise = np.empty(values.shape), np.empty(values.shape)
    unary = np.empty((*lit.shape, len(logs)))
    tolerance = spread.of_pixels**2 + INDEPENDENT_PX * spread.of_regions**2
    _prepare(
        values, lamps.split, np.exp(-logs), lamps.haze, lamps.inverse, lamps.mixing, lamps.noise, tolerance,
        active, lit, reach, light, noise, unary,
    )  # fmt: skip
    variance = _shading_variance(values, lit, lamps, reach)
    found = labels.copy()
    for _ in range(_SWEEPS):
        changed = 0
        for upright in (True, False):
            for first in (0, 1):
                changed += _decide_lines(
                    found, light, noise, lit, unary, active, allowed, logs, variance, reach, upright, first
                )
        if changed <= _SETTLED * active.sum():
            break
    return found


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


@njit(cache=True, parallel=True, error_model="numpy")
def _prepare(
    values: Any, split: Any, q: Any, haze: Any, inverse: Any, mixing: Any, deviation: Any, tolerance: float,
    active: Any, lit: Any, reach: int, light: Any, noise: Any, unary: Any,
) -> None:  # fmt: skip
    """Fill log s and its variance by noise where it is asked for, and each material's price of the length."""
    h, w = active.shape
    count = q.shape[0]
    bias = np.array([bias_of_noise(q[m], inverse, mixing) for m in range(count)])
    for v in prange(h):
        j, s = np.empty(3), np.empty(3)
        for u in range(w):
            wanted = active[v, u]
            for way in range(4):
                a = v + (way == 3) * reach - (way == 2) * reach
                b = u + (way == 1) * reach - (way == 0) * reach
                wanted |= 0 <= a < h and 0 <= b < w and active[a, b]
            if not (wanted and lit[v, u]):
                continue
            for k in range(3):
                s[k] = max(
                    split[k, 0] * values[v, u, 0]
                    + split[k, 1] * values[v, u, 1]
                    + split[k, 2] * values[v, u, 2],
                    deviation[k],
                )
                light[v, u, k] = np.log(s[k])
                noise[v, u, k] = (deviation[k] / s[k]) ** 2
            if active[v, u]:
                for m in range(count):
                    e, variance = length_and_variance(s, q[m], haze, inverse, mixing, bias[m], j)
                    t = e * e / (variance + tolerance)
                    unary[v, u, m] = 0.5 * t / (1.0 + t / (CAP * CAP))


@njit(cache=True, parallel=True)
def _labels_around(labels: Any, active: Any, allowed: Any) -> None:
    """Leave each active pixel the labels that are within the window around it."""
    h, w = labels.shape
    for v in prange(h):
        for u in range(w):
            if active[v, u]:
                found = 0
                for a in range(max(v - _WINDOW, 0), min(v + _WINDOW + 1, h)):
                    for b in range(max(u - _WINDOW, 0), min(u + _WINDOW + 1, w)):
                        found |= 1 << labels[a, b]
                allowed[v, u] = found


@njit(cache=True, error_model="numpy")
def _change(here: Any, there: Any, weight: Any, one: Any, other: Any) -> float:
    """Price of log s here in one material and there in another: how little shading goes on."""
    t = 0.0
    for k in range(3):
        rest = there[k] - other[k] - here[k] + one[k]
        t += rest * rest * weight[k]
    return 0.5 * t / (1.0 + t / (CAP * CAP))


@njit(cache=True, parallel=True, error_model="numpy")
def _decide_lines(
    labels: Any, light: Any, noise: Any, lit: Any, unary: Any, active: Any, allowed: Any, z: Any,
    variance: float, reach: int, upright: bool, first: int,
) -> int:  # fmt: skip
    """Give every second row or column its labels of least cost, those beside it being as they are.

    Return how many changed. upright: rows. A chain goes over every pixel, or leaps over blurred ones: then
    chains alternate.
    """
    h, w, count = unary.shape
    lines, length = (h, w) if upright else (w, h)
    changes = np.zeros(lines, np.int64)
    for i in prange((lines - first + 1) // 2):
        line = 2 * i + first
        some = False
        for t in range(length):
            some |= active[line, t] if upright else active[t, line]
        if not some:
            continue
        weight = np.empty(3)
        total = np.empty((length, count))
        source = np.zeros((length, count), np.uint8)
        for offset in range(reach):
            for t in range(offset, length, reach):
                v, u = (line, t) if upright else (t, line)
                if not active[v, u]:
                    continue
                for m in range(count):
                    total[t, m] = unary[v, u, m] if (allowed[v, u] >> m) & 1 else np.inf
                for way in range(4):  # back and on along the line, then to either side
                    along = (way == 1) * reach - (way == 0) * reach
                    aside = (way == 3) * reach - (way == 2) * reach
                    a, b = (v + aside, u + along) if upright else (v + along, u + aside)
                    if a < 0 or b < 0 or a >= h or b >= w or not lit[a, b] or (way == 1 and active[a, b]):
                        continue
                    for k in range(3):
                        weight[k] = 1.0 / (variance + noise[v, u, k] + noise[a, b, k])
                    if way == 0 and active[a, b]:
                        for m in range(count):
                            if not (allowed[v, u] >> m) & 1:
                                continue
                            least = np.inf
                            for n in range(count):
                                if total[t - reach, n] < least:
                                    cost = total[t - reach, n]
                                    cost += _change(light[a, b], light[v, u], weight, z[n], z[m])
                                    if reach == 1 and n != m:
                                        cost += _SEAM_PRICE
                                    if cost < least:
                                        least = cost
                                        source[t, m] = n
                            total[t, m] += least
                    else:
                        n = labels[a, b]
                        for m in range(count):
                            total[t, m] += _change(light[a, b], light[v, u], weight, z[n], z[m])
                            if reach == 1 and n != m:
                                total[t, m] += _SEAM_PRICE
                    if reach > 1:
                        n = labels[v + (a - v) // reach, u + (b - u) // reach]
                        for m in range(count):
                            if n != m:
                                total[t, m] += _SEAM_PRICE
                goes_on = t + reach < length
                if goes_on:
                    goes_on = active[v, u + reach] if upright else active[v + reach, u]
                if goes_on:
                    continue
                best = total[t].argmin()
                back = t
                while True:
                    v, u = (line, back) if upright else (back, line)
                    changes[line] += labels[v, u] != best
                    labels[v, u] = best
                    best = source[back, best]
                    back -= reach
                    if back < 0:
                        break
                    if not (active[line, back] if upright else active[back, line]):
                        break
    return changes.sum()


# Blur.


def _weights(blur_px: float) -> FloatArray:
    """(n,), weights of a blur over the pixels of a window."""
    places = np.arange(-_WINDOW, _WINDOW + 1)
    found = np.exp(-0.5 * (places / max(blur_px, 1e-3)) ** 2)
    return np.asarray(found / found.sum())


def _blur_px(
    values: FloatArray, lit: Mask, lamps: Lamps, logs: Points, spread: Spread, labels: MaterialLabels
) -> float:
    """The standard deviation of the blur under which normals beside seams are most nearly of unit length."""
    v, u = np.nonzero(_beside_seams(labels, lit))
    step = max(1, len(v) // _JUDGED)
    v, u = v[::step], u[::step]
    if not len(v):
        return 0.0
    tolerance = spread.of_pixels**2 + spread.of_regions**2
    s = values[v, u] @ lamps.split.T
    costs = [
        _cost_of_blur(
            v, u, s, labels, np.exp(logs), _weights(blur), lamps.haze, lamps.inverse, lamps.mixing, tolerance
        )
        for blur in _BLURS_PX
    ]
    return _BLURS_PX[int(np.argmin(costs))]


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
def _mixed(v: int, u: int, labels: Any, rho: Any, weights: Any, out: Any) -> bool:
    """Fill the mean reflectance over the window around a pixel; return whether it holds a seam."""
    h, w = labels.shape
    own = labels[v, u]
    is_mixed = False
    for a in range(max(v - _WINDOW, 0), min(v + _WINDOW + 1, h)):
        for b in range(max(u - _WINDOW, 0), min(u + _WINDOW + 1, w)):
            is_mixed |= labels[a, b] != own
    if not is_mixed:
        return False
    out[:] = 0.0
    total = 0.0
    for a in range(max(v - _WINDOW, 0), min(v + _WINDOW + 1, h)):
        for b in range(max(u - _WINDOW, 0), min(u + _WINDOW + 1, w)):
            weight = weights[a - v + _WINDOW] * weights[b - u + _WINDOW]
            total += weight
            for k in range(3):
                out[k] += weight * rho[labels[a, b], k]
    for k in range(3):
        out[k] /= total
    return True


@njit(cache=True, error_model="numpy")
def _cost_of_blur(
    v: Any, u: Any, s: Any, labels: Any, rho: Any, weights: Any, haze: Any, inverse: Any, mixing: Any,
    tolerance: float,
) -> float:  # fmt: skip
    total = 0.0
    mean, q, j = np.empty(3), np.empty(3), np.empty(3)
    for i in range(v.size):
        if _mixed(v[i], u[i], labels, rho, weights, mean):
            for k in range(3):
                q[k] = 1.0 / mean[k]
            bias = bias_of_noise(q, inverse, mixing)
            e, variance = length_and_variance(s[i], q, haze, inverse, mixing, bias, j)
            t = e * e / (variance + tolerance)
            total += 0.5 * t / (1.0 + t / (CAP * CAP))
    return total


@njit(cache=True, parallel=True, error_model="numpy")
def _relight(
    rgb: Any,
    labels: Any,
    matrices: Any,
    rho: Any,
    split: Any,
    merge: Any,
    weights: Any,
    is_blurred: bool,
    out: Any,
) -> None:
    h, w = labels.shape
    for v in prange(h):
        mean, light = np.empty(3), np.empty(3)
        for u in range(w):
            r, g, b = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
            if is_blurred and _mixed(v, u, labels, rho, weights, mean):
                for k in range(3):
                    light[k] = (split[k, 0] * r + split[k, 1] * g + split[k, 2] * b) / mean[k]
                for c in range(3):
                    out[v, u, c] = merge[c, 0] * light[0] + merge[c, 1] * light[1] + merge[c, 2] * light[2]
                continue
            a = matrices[labels[v, u]]
            for c in range(3):
                out[v, u, c] = a[c, 0] * r + a[c, 1] * g + a[c, 2] * b

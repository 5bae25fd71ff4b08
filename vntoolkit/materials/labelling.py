"""Which material each pixel is of, where the reflectances are known, and what it would look like in one.

A pixel's price for a material is how far its normal then is from unit length. A wrong material too gives unit
length along some curve of the surface, so prices are averaged over neighbours, but not across steps of the
colour. Neighbours agree where that costs little. Beside a seam, each pixel goes to the side that its normal
continues.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.materials.reflectance import CAP, bias_of_noise, length_and_variance
from vntoolkit.materials.regions import edges_of
from vntoolkit.materials.split_frame import SplitFrame, split_frame
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

MaterialLabels = npt.NDArray[np.uint8]
TOLERANCE = 0.02  # standard deviation of a normal's length, beyond noise, that is no sign of another material
_REACH_PX = 10.0  # over which prices are averaged where nothing parts the pixels
_NOISE_STEP = 2.0  # standard deviations of a step that noise makes
_STEP_UNKNOWN = 4.0  # at the rim of a shadow
_AGREEMENT = 0.4  # what a neighbour of the same label takes off a price
_SWEEPS = 8
_HABIT = 0.3  # what the label of the frame before takes off a price
_SEAM = 2  # blocks to a seam within which pixels are decided one by one
_BEND = 0.1  # relative change of a lamp's share over that distance
_FEWEST = 3  # blocks of a label that tell how its side goes on


class MaterialLabeller:
    """MaterialLabels frame after frame; the labels of the frame before are preferred.

    response: with light colours. reflectances: (m, 3), relative to the calibration material.
    """

    def __init__(self, response: LightResponse, reflectances: Points) -> None:
        self._response = response
        self._logs = np.log(np.asarray(reflectances, dtype=np.float64))
        self._before: MaterialLabels | None = None

    def forget(self) -> None:
        """Drop the labels of the frame before, so that a sequence may start anywhere."""
        self._before = None

    def labels(self, frame: LinearFrame, mask: Mask) -> MaterialLabels:
        """Return (h, w) labels, numbers of the materials; 0 outside the mask. mask: (h, w).

        frame: every lamp as strong as at the centre.
        """
        if len(self._logs) == 1 or not mask.any():
            return np.zeros(mask.shape, np.uint8)
        split = split_frame(frame, self._response, mask)
        costs = prices(split, edges_of(split), self._logs)
        if self._before is not None and self._before.shape == split.lit.shape:
            costs -= _HABIT * (np.arange(len(costs))[:, None, None] == self._before)
        coarse = smoothed(costs)
        self._before = coarse
        return sharpened(frame, split, coarse, self._logs, mask)


def relit(
    frame: LinearFrame, response: LightResponse, labels: MaterialLabels, reflectances: Points
) -> LinearFrame:
    """Return the frame as it would be with the calibration material everywhere: r' = Cᵀ (C⁻ᵀ r ∘ 1/ρ).

    Ambient light falls on the material too: it is divided by ρ with the rest.
    """
    split = response.contributions_from_rgb
    merge = np.linalg.inv(split)
    matrices = np.array([merge @ np.diag(1.0 / rho) @ split for rho in np.asarray(reflectances, np.float64)])
    out = np.empty(frame.rgb.shape, np.float32)
    _relight(np.ascontiguousarray(frame.rgb), labels, matrices.astype(np.float32), out)
    return LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)


def colours_of(reflectances: Points, response: LightResponse) -> FloatArray:
    """(m, 3), linear colour 0 to 1 of each material in the light of all three lamps, balanced to white.

    White is the calibration material, or the strongest material where one returns more.
    """
    colours = np.abs(np.linalg.inv(response.contributions_from_rgb).T)
    seen = np.asarray(reflectances) @ colours / colours.sum(axis=0)
    return np.asarray(seen / max(1.0, float(seen.max())))


@njit(cache=True, parallel=True)
def _relight(rgb: Any, labels: Any, matrices: Any, out: Any) -> None:
    h, w = labels.shape
    for v in prange(h):
        for u in range(w):
            a = matrices[labels[v, u]]
            r, g, b = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
            for c in range(3):
                out[v, u, c] = a[c, 0] * r + a[c, 1] * g + a[c, 2] * b


# Prices, averaged up to the steps of the colour.


def prices(split: SplitFrame, edge: FloatArray, logs: Points, tolerance: float = TOLERANCE) -> FloatArray:
    """Return (m, h, w), the mean price of each material around each pixel, 0 to CAP²/2.

    edge: (h, w), see `edges_of`. logs: (m, 3), log ρ. tolerance: standard deviation of lengths beyond noise.
    """
    known = np.where(np.isfinite(edge), edge, _STEP_UNKNOWN)
    excess = np.maximum(known * known - _NOISE_STEP**2, 0.0)
    decay = np.exp(-(1.0 + excess) / _REACH_PX)
    lamps = split.lamps
    total = np.empty((len(logs), *split.lit.shape))
    _price_kernel(
        split.contributions,
        split.lit,
        np.exp(-logs),
        lamps.haze,
        lamps.inverse,
        lamps.mixing,
        tolerance,
        total,
    )
    _spread_all(total, decay)
    weight = split.lit[None].astype(np.float64)
    _spread_all(weight, decay)
    return np.asarray(total / np.maximum(weight, 1e-300))


@njit(cache=True, parallel=True, error_model="numpy")
def _price_kernel(
    s: Any, lit: Any, q: Any, haze: Any, inverse: Any, mixing: Any, tolerance: float, out: Any
) -> None:
    h, w = lit.shape
    bias = np.array([bias_of_noise(q[m], inverse, mixing) for m in range(q.shape[0])])
    for v in prange(h):
        j = np.empty(3)
        for u in range(w):
            for m in range(q.shape[0]):
                out[m, v, u] = 0.0
                if lit[v, u]:
                    e, variance = length_and_variance(s[v, u], q[m], haze, inverse, mixing, bias[m], j)
                    t = e * e / (variance + tolerance * tolerance)
                    out[m, v, u] = 0.5 * t / (1.0 + t / (CAP * CAP))


@njit(cache=True, parallel=True)
def _spread_all(planes: Any, decay: Any) -> None:
    for m in prange(planes.shape[0]):
        _spread(planes[m], decay)


@njit(cache=True)
def _spread(plane: Any, decay: Any) -> None:
    """Add to each pixel what the others hold, less with every pixel on the way: along rows, then columns."""
    h, w = plane.shape
    left = np.zeros(w)
    for v in range(h):
        carried = 0.0
        for u in range(w):
            left[u] = carried
            carried = (carried + plane[v, u]) * decay[v, u]
        carried = 0.0
        for u in range(w - 1, -1, -1):
            own = plane[v, u]
            plane[v, u] = own + (left[u] + carried) * decay[v, u]
            carried = (carried + own) * decay[v, u]
    above = np.zeros((h, w))
    row = np.zeros(w)
    for v in range(h):
        for u in range(w):
            above[v, u] = row[u]
            row[u] = (row[u] + plane[v, u]) * decay[v, u]
    row[:] = 0.0
    for v in range(h - 1, -1, -1):
        for u in range(w):
            own = plane[v, u]
            plane[v, u] = own + (above[v, u] + row[u]) * decay[v, u]
            row[u] = (row[u] + own) * decay[v, u]


# From prices to labels.


def smoothed(costs: FloatArray) -> MaterialLabels:
    """Return labels (h, w) of least price, of prices (m, h, w); neighbours agree where that costs little.

    Iterated conditional modes (besag1986).
    """
    labels = costs.argmin(axis=0).astype(np.uint8)
    if len(costs) > 1:
        for _ in range(_SWEEPS):
            if not _agree(costs, labels):
                break
    return labels


@njit(cache=True)
def _agree(costs: Any, labels: Any) -> bool:
    count, h, w = costs.shape
    changed = False
    like = np.zeros(count)
    for v in range(h):
        for u in range(w):
            like[:] = 0.0
            for i in range(max(v - 1, 0), min(v + 2, h)):
                for j in range(max(u - 1, 0), min(u + 2, w)):
                    if i != v or j != u:
                        like[labels[i, j]] += _AGREEMENT
            best, least = 0, np.inf
            for m in range(count):
                price = costs[m, v, u] - like[m]
                if price < least:
                    best, least = m, price
            if best != labels[v, u]:
                labels[v, u] = best
                changed = True
    return changed


def sharpened(
    frame: LinearFrame, split: SplitFrame, coarse: MaterialLabels, logs: Points, mask: Mask,
    tolerance: float = TOLERANCE,
) -> MaterialLabels:  # fmt: skip
    """Label all pixels; those near a seam by unit length and by the normals that they continue."""
    lamps = split.lamps
    out = np.zeros(mask.shape, np.uint8)
    _sharpen(
        np.ascontiguousarray(frame.rgb), mask, split.contributions, split.lit, coarse, np.exp(-logs),
        lamps.split, lamps.haze, lamps.inverse, lamps.mixing * split.factor, lamps.noise * split.factor,
        tolerance, out,
    )  # fmt: skip
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _sharpen(
    rgb: Any, mask: Any, s: Any, lit: Any, coarse: Any, q: Any, unmix: Any, haze: Any, inverse: Any,
    mixing: Any, noise: Any, tolerance: float, out: Any,
) -> None:  # fmt: skip
    height, width = coarse.shape
    factor = (mask.shape[0] + height - 1) // height
    count = q.shape[0]
    bias = np.array([bias_of_noise(q[m], inverse, mixing) for m in range(count)])
    for i in prange(height):
        j, light = np.empty(3), np.empty(3)
        share, seen = np.zeros((count, 3)), np.zeros(count)
        for k in range(width):
            share[:] = 0.0
            seen[:] = 0.0
            alone = True
            for a in range(max(i - _SEAM, 0), min(i + _SEAM + 1, height)):
                for b in range(max(k - _SEAM, 0), min(k + _SEAM + 1, width)):
                    m = coarse[a, b]
                    if lit[a, b] and (a != i or b != k):
                        seen[m] += 1.0
                        for c in range(3):
                            share[m, c] += s[a, b, c] * q[m, c]
                        alone = alone and m == coarse[i, k]
            for v in range(i * factor, min((i + 1) * factor, mask.shape[0])):
                for u in range(k * factor, min((k + 1) * factor, mask.shape[1])):
                    if not mask[v, u]:
                        continue
                    out[v, u] = coarse[i, k]
                    if alone or not lit[i, k]:
                        continue
                    for c in range(3):
                        light[c] = (
                            unmix[c, 0] * rgb[v, u, 0]
                            + unmix[c, 1] * rgb[v, u, 1]
                            + unmix[c, 2] * rgb[v, u, 2]
                        )
                    least = np.inf
                    for m in range(count):
                        if seen[m] < _FEWEST:
                            continue
                        e, variance = length_and_variance(light, q[m], haze, inverse, mixing, bias[m], j)
                        price = e * e / (variance + tolerance * tolerance)
                        for c in range(3):
                            mean = share[m, c] / seen[m]
                            off = light[c] * q[m, c] - mean
                            price += (
                                off
                                * off
                                / (noise[c] * noise[c] * q[m, c] * q[m, c] + _BEND * _BEND * mean * mean)
                            )
                        if price < least:
                            least = price
                            out[v, u] = m

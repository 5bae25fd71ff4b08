"""Which material each pixel is of, where the reflectances are known, and what it would look like in one.

A region's price for a material is how far its normals then are from unit length. A wrong material gives unit
length along some curve too, so that neighbours are asked as well: from one material to another log s steps by
the logarithm of the ratio of their reflectances, and within one it does not step.

Beside a seam a lens blurs two materials into each other. Light adds, so such a pixel has the mean reflectance
of both, by a share that gives its normal unit length and continues the normals around it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points
from vntoolkit.materials.reflectance import CAP, Lamps, bias_of_noise, length_and_variance
from vntoolkit.materials.regions import SHADING_STEP, Regions, regions_of
from vntoolkit.materials.split_frame import SplitFrame, split_frame
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

MaterialLabels = npt.NDArray[np.uint8]
INDEPENDENT_PX = 64.0  # pixels that share their errors: lamps, gloss and ambient light change slowly
_TOLERANCE = 0.04  # standard deviation of a normal's length beyond noise: uneven dye, light between folds
_SEAM_PRICE = 1.0  # of a neighbour of another material, where the reflectances are known
_SWEEPS = 12
_PATCH_SWEEPS = 4
_HABIT = 0.3  # what the label of the frame before takes off a price
_SHARES = 3  # steps of the share of the second material in a blurred pixel
_SEAM = 5  # blocks that a lens and a Bayer pattern blur to either side of a seam
_REACH = 7  # blocks from which the normals are continued
_BLEND_PRICE = 2.0  # of a blend: most pixels are of one material
_FLAT = 50.0  # squared blocks: keeps a plane through few of them level
_BEND = 0.1  # relative change of a lamp's share over that distance


class MaterialLabeller:
    """Labels frame after frame; those of the frame before are preferred.

    response: with light colours. reflectances: (m, 3), relative to the calibration material. palette: (p, 3),
    these and then their blends, two by two. labels() gives numbers of the palette, materials_of() turns them
    into numbers of materials.
    """

    def __init__(self, response: LightResponse, reflectances: Points) -> None:
        self._response = response
        values = np.asarray(reflectances, dtype=np.float64)
        self._logs = np.log(values)
        palette, owners = [*values], [*range(len(values))]
        for one in range(len(values)):
            for other in range(one + 1, len(values)):
                for step in range(_SHARES):
                    share = (step + 1) / (_SHARES + 1)
                    palette.append((1.0 - share) * values[one] + share * values[other])
                    owners.append(one if share <= 0.5 else other)
        self.palette: Points = np.array(palette)
        self._owners = np.array(owners, np.uint8)
        self._before: MaterialLabels | None = None

    def forget(self) -> None:
        """Drop the labels of the frame before, so that a sequence may start anywhere."""
        self._before = None

    def materials_of(self, labels: MaterialLabels) -> MaterialLabels:
        """Return (h, w), the number of the material that most of each pixel is of."""
        return np.asarray(self._owners[labels])

    def labels(self, frame: LinearFrame, mask: Mask) -> MaterialLabels:
        """Return (h, w), numbers of the palette; 0 outside the mask. mask: (h, w).

        frame: every lamp as strong as at the centre.
        """
        if len(self._logs) == 1 or not mask.any():
            return np.zeros(mask.shape, np.uint8)
        split = split_frame(frame, self._response, mask)
        regions = regions_of(split)
        costs = prices(regions, self._logs, split.lamps, _TOLERANCE)
        if self._before is not None and self._before.shape == split.lit.shape:
            costs -= _HABIT * _shares(self._before, regions, len(self._logs))
        of_regions = agreed(costs, self._logs, regions, _SEAM_PRICE)
        coarse = np.zeros(split.lit.shape, np.uint8)
        if regions.count:
            coarse = of_regions[regions.labels].astype(np.uint8)
        self._before = coarse
        return self._blended(frame, split, coarse, regions.plain, mask)

    def _blended(
        self, frame: LinearFrame, split: SplitFrame, coarse: MaterialLabels, plain: Mask, mask: Mask
    ) -> MaterialLabels:
        lamps = split.lamps
        out = np.zeros(mask.shape, np.uint8)
        _blend(
            np.ascontiguousarray(frame.rgb), mask, split.contributions, split.lit, plain, coarse,
            1.0 / self.palette, len(self._logs), lamps.split, lamps.haze, lamps.inverse,
            lamps.mixing * split.factor, lamps.noise * split.factor, out,
        )  # fmt: skip
        return out


def relit(
    frame: LinearFrame, response: LightResponse, labels: MaterialLabels, reflectances: Points
) -> LinearFrame:
    """Return the frame as it would be with the calibration material everywhere: r' = Cᵀ (C⁻ᵀ r ∘ 1/ρ).

    labels: (h, w), numbers of the reflectances (m, 3). Ambient light falls on the material too: it is divided
    by ρ with the rest.
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


# Labels of regions.


def prices(regions: Regions, logs: Points, lamps: Lamps, tolerance: float) -> FloatArray:
    """Return (n, m), the mean price of each material for the samples of each region, 0 to CAP²/2.

    logs: (m, 3), log ρ. tolerance: standard deviation of lengths beyond noise.
    """
    out = np.empty((regions.count, len(logs)))
    _prices(
        regions.samples,
        regions.counts,
        np.exp(-logs),
        lamps.haze,
        lamps.inverse,
        lamps.mixing,
        tolerance,
        out,
    )
    return out


def agreed(
    costs: FloatArray, logs: Points, regions: Regions, seam: float, start: IntArray | None = None
) -> IntArray:
    """Return labels (n,) of least cost of prices (n, m) and steps between neighbours.

    seam: price of a neighbour of another material, however well the step fits. start: (n,) labels.

    Iterated conditional modes (besag1986), of regions and then of patches of regions of one label.
    """
    labels = (costs.argmin(axis=1) if start is None else start).astype(np.int64)
    weights = regions.sizes / INDEPENDENT_PX
    edges = regions.starts, regions.neighbours, regions.steps, regions.contacts
    for _ in range(_PATCH_SWEEPS):
        _agree(costs, weights, labels, logs, *edges, seam, _SWEEPS)
        if not _turn_patches(costs, weights, labels, logs, *edges, seam):
            break
    return labels


def total_cost(costs: FloatArray, labels: IntArray, logs: Points, regions: Regions, seam: float) -> float:
    """Nats of prices (n, m) and of steps between neighbours, under labels (n,)."""
    return float(
        _total(
            costs, regions.sizes / INDEPENDENT_PX, labels, logs, regions.starts, regions.neighbours,
            regions.steps, regions.contacts, seam,
        )
    )  # fmt: skip


def _shares(labels: MaterialLabels, regions: Regions, count: int) -> FloatArray:
    """(n, m), share of each material in each region."""
    key = regions.labels[regions.plain] * count + labels[regions.plain]
    votes = np.bincount(key, minlength=regions.count * count).reshape(regions.count, count)
    return np.asarray(votes / np.maximum(votes.sum(axis=1, keepdims=True), 1))


@njit(cache=True, parallel=True, error_model="numpy")
def _prices(
    samples: Any, counts: Any, q: Any, haze: Any, inverse: Any, mixing: Any, tolerance: float, out: Any
) -> None:
    materials = q.shape[0]
    bias = np.array([bias_of_noise(q[m], inverse, mixing) for m in range(materials)])
    for i in prange(samples.shape[0]):
        j = np.empty(3)
        for m in range(materials):
            total = 0.0
            for p in range(counts[i]):
                e, variance = length_and_variance(samples[i, p], q[m], haze, inverse, mixing, bias[m], j)
                t = e * e / (variance + tolerance * tolerance)
                total += 0.5 * t / (1.0 + t / (CAP * CAP))
            out[i, m] = total / max(counts[i], 1)


@njit(cache=True, inline="always")
def _step_cost(step: Any, one: Any, other: Any, seam: float) -> float:
    """Price of a step of log s from a material to another: how badly their ratio explains it."""
    t = 0.0
    for k in range(3):
        rest = (step[k] - other[k] + one[k]) / SHADING_STEP
        t += rest * rest
    return 0.5 * t / (1.0 + t / (CAP * CAP)) + seam


@njit(cache=True)
def _agree(
    costs: Any, weights: Any, labels: Any, logs: Any, starts: Any, neighbours: Any, steps: Any, contacts: Any,
    seam: float, sweeps: int,
) -> None:  # fmt: skip
    count = costs.shape[1]
    for _ in range(sweeps):
        changed = False
        for i in range(costs.shape[0]):
            best, least, own = labels[i], np.inf, np.inf
            for m in range(count):
                cost = weights[i] * costs[i, m]
                for e in range(starts[i], starts[i + 1]):
                    b = labels[neighbours[e]]
                    cost += contacts[e] * _step_cost(steps[e], logs[m], logs[b], 0.0 if m == b else seam)
                if m == labels[i]:
                    own = cost
                if cost < least:
                    best, least = m, cost
            if best != labels[i] and least < own - 1e-9:
                labels[i] = best
                changed = True
        if not changed:
            break


@njit(cache=True)
def _turn_patches(
    costs: Any,
    weights: Any,
    labels: Any,
    logs: Any,
    starts: Any,
    neighbours: Any,
    steps: Any,
    contacts: Any,
    seam: float,
) -> bool:
    """Give whole patches of one label another where that costs less; return whether any changed."""
    n, count = costs.shape
    patch = np.full(n, -1, np.int64)
    queue = np.empty(n, np.int64)
    total = np.empty(count)
    changed = False
    for first in range(n):
        if patch[first] >= 0:
            continue
        own = labels[first]
        patch[first] = first
        queue[0] = first
        size, done = 1, 0
        total[:] = 0.0
        while done < size:
            i = queue[done]
            done += 1
            for m in range(count):
                total[m] += weights[i] * costs[i, m]
            for e in range(starts[i], starts[i + 1]):
                j = neighbours[e]
                b = labels[j]
                if b == own and patch[j] < 0:
                    patch[j] = first
                    queue[size] = j
                    size += 1
                if patch[j] != first:
                    for m in range(count):
                        total[m] += contacts[e] * _step_cost(
                            steps[e], logs[m], logs[b], 0.0 if m == b else seam
                        )
        best = total.argmin()
        if best != own and total[best] < total[own] - 1e-9:
            changed = True
            for k in range(size):
                labels[queue[k]] = best
    return changed


@njit(cache=True)
def _total(
    costs: Any,
    weights: Any,
    labels: Any,
    logs: Any,
    starts: Any,
    neighbours: Any,
    steps: Any,
    contacts: Any,
    seam: float,
) -> float:
    total = 0.0
    for i in range(costs.shape[0]):
        total += weights[i] * costs[i, labels[i]]
        for e in range(starts[i], starts[i + 1]):
            j = neighbours[e]
            if j > i:
                a, b = labels[i], labels[j]
                total += contacts[e] * _step_cost(steps[e], logs[a], logs[b], 0.0 if a == b else seam)
    return total


# Pixels beside seams.


@njit(cache=True, error_model="numpy")
def _at_origin(plane: Any, value: Any, out: Any) -> None:
    """Fill the value at (0, 0) of the planes (3,) of least squares, of their moments; flat where unknown."""
    flat = _FLAT * plane[0]
    a, b, c = plane[3] + flat, plane[4], plane[5] + flat
    determinant = a * c - b * b
    u, v = (c * plane[1] - b * plane[2]) / determinant, (a * plane[2] - b * plane[1]) / determinant
    weight = plane[0] - u * plane[1] - v * plane[2]
    for k in range(3):
        out[k] = (value[k, 0] - u * value[k, 1] - v * value[k, 2]) / weight


@njit(cache=True, parallel=True, error_model="numpy")
def _blend(
    rgb: Any, mask: Any, s: Any, lit: Any, plain: Any, coarse: Any, q: Any, count: int, unmix: Any, haze: Any,
    inverse: Any, mixing: Any, noise: Any, out: Any,
) -> None:  # fmt: skip
    height, width = coarse.shape
    factor = (mask.shape[0] + height - 1) // height
    for i in prange(height):
        j, light, around = np.empty(3), np.empty(3), np.empty(3)
        plane, value = np.empty(6), np.empty((3, 3))
        seen = np.zeros(count)
        for k in range(width):
            alone = True
            for a in range(max(i - _SEAM, 0), min(i + _SEAM + 1, height)):
                for b in range(max(k - _SEAM, 0), min(k + _SEAM + 1, width)):
                    if lit[a, b] and coarse[a, b] != coarse[i, k]:
                        alone = False
            if not alone and lit[i, k]:
                seen[:] = 0.0
                plane[:] = 0.0
                value[:] = 0.0
                for a in range(max(i - _REACH, 0), min(i + _REACH + 1, height)):
                    for b in range(max(k - _REACH, 0), min(k + _REACH + 1, width)):
                        if plain[a, b]:
                            m = coarse[a, b]
                            weight = 1.0 / (1.0 + (a - i) ** 2 + (b - k) ** 2)
                            seen[m] += weight
                            x, y = float(b - k), float(a - i)
                            plane[0] += weight
                            plane[1] += weight * x
                            plane[2] += weight * y
                            plane[3] += weight * x * x
                            plane[4] += weight * x * y
                            plane[5] += weight * y * y
                            for c in range(3):
                                share = weight * s[a, b, c] * q[m, c]
                                value[c, 0] += share
                                value[c, 1] += share * x
                                value[c, 2] += share * y
                alone = plane[0] == 0.0
                if not alone:
                    _at_origin(plane, value, around)
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
                    p = count
                    for one in range(count):
                        for other in range(one, count):
                            blends = 1 if one == other else _SHARES
                            there = (seen[one] > 0.0 or one == coarse[i, k]) and (
                                seen[other] > 0.0 or other == coarse[i, k]
                            )
                            for _ in range(blends):
                                n = one
                                if one != other:
                                    n = p
                                    p += 1
                                if not there:
                                    continue
                                e, variance = length_and_variance(light, q[n], haze, inverse, mixing, 0.0, j)
                                price = e * e / (variance + _TOLERANCE * _TOLERANCE)
                                if one != other:
                                    price += _BLEND_PRICE
                                for c in range(3):
                                    off = light[c] * q[n, c] - around[c]
                                    spread = noise[c] * q[n, c]
                                    bend = _BEND * around[c]
                                    price += off * off / (spread * spread + bend * bend)
                                if price < least:
                                    least = price
                                    out[v, u] = n

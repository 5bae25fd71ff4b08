"""Which material each region is of, where the reflectances are known.

A region's price for a material is how far its normals then are from unit length. A wrong material gives unit
length along some curve too, so that neighbours are asked as well: from one material to another log s steps by
the logarithm of the ratio of their reflectances, and within one it does not step. How exact lengths are is
learned from the frame: a knit scatters them, flat paint hardly does.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.materials.mixtures import INDEPENDENT_PX, Spread
from vntoolkit.materials.reflectance import CAP
from vntoolkit.materials.region_lengths import Lengths
from vntoolkit.materials.regions import SHADING_STEP, Regions
from vntoolkit.native import njit
from vntoolkit.spread import robust_deviation

_STRANGERS = 0.1  # share of regions that are of no material: folds that light each other, eyes, buttons
DOUBTFUL = 1.5  # price of a region from which its label is in doubt
_LEAST_SPREAD = 0.005  # of lengths: reflectances are known no better
_SWEEPS = 12
_MOST_STEP = (CAP * SHADING_STEP) ** 2  # square of a step of log s; longer ones hardly cost more


def prices_of_regions(lengths: Lengths, spread: Spread) -> FloatArray:
    """Return (n, m), nats of each material for each region, at most of a region that is of no material.

    That has a length of any kind: the more exact lengths are, the dearer is one that does not fit.
    """
    variance = spread.of_regions**2 + lengths.noise / lengths.counts
    t = lengths.error**2 / variance + lengths.scatter / (spread.of_pixels**2 + lengths.noise)
    most = np.maximum(-np.log(_STRANGERS * np.sqrt(2.0 * np.pi * variance)), 1.0)
    return np.asarray(0.5 * t / (1.0 + 0.5 * t / most))


def spread_of(lengths: Lengths, labels: IntArray) -> Spread:
    """Return the robust spread of the lengths under labels (n,) of the regions."""
    if not len(labels):
        return Spread(_LEAST_SPREAD, _LEAST_SPREAD)
    error, scatter, noise = (np.take_along_axis(a, labels[:, None], 1)[:, 0] for a in lengths[:3])
    between = robust_deviation(error) ** 2 - np.median(noise / lengths.counts[:, 0])
    within = np.median(scatter - noise)
    least = _LEAST_SPREAD**2
    return Spread(float(np.sqrt(max(between, least))), float(np.sqrt(max(within, least))))


def agreed(
    costs: FloatArray, logs: Points, regions: Regions, seam: float, start: IntArray | None = None
) -> IntArray:
    """Return labels (n,) of little cost of prices (n, m) and steps between neighbours.

    seam: price of a neighbour of another material, however well the step fits. start: (n,) labels.
    By iterated conditional modes (besag1986), from the labels of least price where there is no start.
    """
    labels = costs.argmin(axis=1) if start is None else start.astype(np.int64)
    weights = regions.sizes / INDEPENDENT_PX
    edges = regions.starts, regions.neighbours, regions.steps, regions.contacts
    _agree(costs * weights[:, None], labels, np.ascontiguousarray(logs), *edges, seam, _SWEEPS)
    return labels


def total_cost(costs: FloatArray, labels: IntArray, logs: Points, regions: Regions, seam: float) -> float:
    """Nats of prices (n, m) and of steps between neighbours, under labels (n,)."""
    weights, i, j = regions.sizes / INDEPENDENT_PX, regions.sources, regions.neighbours
    t = ((regions.steps - logs[labels[j]] + logs[labels[i]]) ** 2).sum(axis=1)
    steps = 0.5 * CAP**2 * t / (_MOST_STEP + t) + seam * (labels[i] != labels[j])
    own = weights @ np.take_along_axis(costs, labels[:, None], 1)[:, 0]
    return float(own + 0.5 * (regions.contacts @ steps))  # each step is counted from both sides


@njit
def _agree(
    prices: Any, labels: Any, logs: Any, starts: Any, neighbours: Any, steps: Any, contacts: Any, seam: float,
    sweeps: int,
) -> None:  # fmt: skip
    """Give each region its label of least cost, again as long as one beside it changed."""
    n, count = prices.shape
    waits = np.ones(n, np.bool_)
    for _ in range(sweeps):
        changed = False
        for i in range(n):
            if not waits[i]:
                continue
            waits[i] = False
            total = prices[i].copy()
            for e in range(starts[i], starts[i + 1]):
                other = labels[neighbours[e]]
                for m in range(count):
                    t = 0.0
                    for k in range(3):
                        rest = steps[e, k] - logs[other, k] + logs[m, k]
                        t += rest * rest
                    total[m] += contacts[e] * 0.5 * CAP * CAP * t / (_MOST_STEP + t)
                    if m != other:
                        total[m] += contacts[e] * seam
            best = total.argmin()
            if total[best] < total[labels[i]] - 1e-9:
                labels[i] = best
                changed = True
                for e in range(starts[i], starts[i + 1]):
                    waits[neighbours[e]] = True
        if not changed:
            break

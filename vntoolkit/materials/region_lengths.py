"""How far the normals of regions are from unit length as a material, and what log ρ they ask for."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.materials.reflectance import CAP, Lamps, lengths_of_normals
from vntoolkit.materials.regions import Regions

WEAK_PRIOR = 0.5  # of log ρ, in a joint fit


class Lengths(NamedTuple):
    """How far the normals of each region are from unit length as each material, arrays (n, m).

    error: mean of |n| − 1 over the samples. scatter: variance about it. noise: of one sample's.

    counts: (n, 1).
    """

    error: FloatArray
    scatter: FloatArray
    noise: FloatArray
    counts: FloatArray


def lengths_of(regions: Regions, logs: Points, lamps: Lamps) -> Lengths:
    """Return how far normals are from unit length as each material. logs: (m, 3), log ρ."""
    error, scatter, noise = np.empty((3, regions.count, len(logs)))
    share = regions.known / np.maximum(regions.counts, 1)[:, None]
    for m, log in enumerate(logs):
        each, variance, _ = lengths_of_normals(regions.samples, np.exp(-log), lamps)
        error[:, m] = (share * each).sum(axis=1)
        scatter[:, m] = np.maximum((share * each**2).sum(axis=1) - error[:, m] ** 2, 0.0)
        noise[:, m] = (share * variance).sum(axis=1)
    return Lengths(error, scatter, noise, np.maximum(regions.counts, 1)[:, None].astype(np.float64))


def normal_equations(
    regions: Regions, logs: Points, lamps: Lamps, weights: FloatArray, spread: float, reach: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Return the normal matrix (n, 3, 3) and the gradient (n, 3) of each region's lengths by its log ρ.

    logs: (n, 3), where they are taken. weights: (n,). spread: standard deviation of lengths beyond noise.
    reach: from CAP times this, or times the whole standard deviation where that is more, lengths count less.
    """
    error, variance, slopes = lengths_of_normals(regions.samples, np.exp(-logs)[:, None], lamps)
    variance = variance + spread**2
    falling = 1.0 / (1.0 + error**2 / np.maximum(variance, reach**2) / CAP**2)
    share = (weights / np.maximum(regions.counts, 1))[:, None] * regions.known
    weighed = slopes * (share * falling**2 / variance)[..., None]
    return weighed.transpose(0, 2, 1) @ slopes, -(weighed * error[..., None]).sum(axis=1)

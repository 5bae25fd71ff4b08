"""Patches of one material: connected regions of one label.

Lengths and seams tell the reflectance of each patch. Those of one material have one, as far as they tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points
from vntoolkit.materials.pixels import INDEPENDENT_PX
from vntoolkit.materials.reflectance import CAP, Lamps
from vntoolkit.materials.region_lengths import normal_equations
from vntoolkit.materials.regions import SHADING_STEP, Regions

_WEAK_PRIOR = 0.5  # of log ρ of a patch
_ROUNDS = 3


def patches_of(regions: Regions, joined: Mask) -> IntArray:
    """Return (n,), the patch of each region. joined: (e,), steps within a patch."""
    a, b = regions.sources[joined], regions.neighbours[joined]
    graph = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(regions.count, regions.count))
    return np.asarray(connected_components(graph, directed=False)[1])


def one_as_two(
    logs: Points, labels: IntArray, regions: Regions, lamps: Lamps, tolerance: float
) -> tuple[float, Points, IntArray]:
    """Return what is gained at most, in nats, where patches of one material are of two.

    And those log ρ (m + 1, 3) and labels (n,). logs: (m, 3). labels: (n,). tolerance: spread of lengths.
    """
    patches = patches_of(regions, labels[regions.sources] == labels[regions.neighbours])
    matrices, rights = _told(logs, labels, patches, regions, lamps, tolerance)
    found = 0.0, logs, labels
    of_patch = labels[np.unique(patches, return_index=True)[1]]
    for m in range(len(logs)):
        inside = np.flatnonzero(of_patch == m)
        gain, ends, is_second = _in_two(matrices[inside], rights[inside])
        if gain > found[0]:
            others = np.where(np.isin(patches, inside[is_second]), len(logs), labels)
            found = gain, np.vstack([logs, logs[m] + ends[1]]), others
            found[1][m] += ends[0]
    return found


def _told(
    logs: Points, labels: IntArray, patches: IntArray, regions: Regions, lamps: Lamps, tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations (p, 3, 3), (p, 3) of the log ρ of patches, from that of their material."""
    a, b = regions.sources, regions.neighbours
    own = logs[labels]
    matrices, rights = normal_equations(regions, own, lamps, regions.sizes / INDEPENDENT_PX, tolerance)
    rest = (own[b] - own[a] - regions.steps) / SHADING_STEP
    weights = regions.contacts * (labels[a] != labels[b]) / (1.0 + (rest**2).sum(axis=1) / CAP**2) ** 2
    np.add.at(rights, a, weights[:, None] * rest / SHADING_STEP)
    np.add.at(matrices, a, weights[:, None, None] / SHADING_STEP**2 * np.eye(3))
    count = patches.max() + 1
    of_patches: Any = np.zeros((count, 3, 3)), np.zeros((count, 3))
    np.add.at(of_patches[0], patches, matrices)
    np.add.at(of_patches[1], patches, rights)
    return of_patches


def _in_two(matrices: FloatArray, rights: FloatArray) -> tuple[float, FloatArray, Mask]:
    """Return what two log ρ gain over one, the two (2, 3), and which patches (p,) are of the second.

    The first guess halves patches along the line on which they differ most; then each goes to the nearer.
    """
    bounded = matrices + _WEAK_PRIOR * np.eye(3)
    own = np.linalg.solve(bounded, rights[..., None])[..., 0]
    weights = np.trace(matrices, axis1=1, axis2=2)[:, None]
    apart = own - (weights * own).sum(axis=0) / max(weights.sum(), 1e-9)
    is_second = apart @ np.linalg.eigh((weights * apart).T @ apart)[1][:, -1] > 0.0
    both, paid = np.zeros((2, 3)), np.zeros((2, len(own)))
    for _ in range(_ROUNDS):
        if is_second.all() or not is_second.any():
            return 0.0, both, is_second
        for end, part in enumerate((~is_second, is_second)):
            both[end], paid[end] = _mean(bounded, own, part)
        is_second = paid[1] < paid[0]
    return (
        float(_mean(bounded, own, np.ones_like(is_second))[1].sum() - paid.min(axis=0).sum()),
        both,
        is_second,
    )


def _mean(matrices: FloatArray, own: FloatArray, part: Mask) -> tuple[FloatArray, FloatArray]:
    """Return the mean log ρ (3,) of a part of the patches, and what each patch pays for it (p,), in nats."""
    right = np.einsum("nij,nj->i", matrices[part], own[part])
    mean = np.linalg.solve(matrices[part].sum(axis=0), right)
    return mean, 0.5 * np.einsum("ni,nij,nj->n", own - mean, matrices, own - mean)

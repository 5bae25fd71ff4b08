"""Regions without an edge of paint: where the logarithm of the lamps' contributions changes slowly.

log s_k = log ρ_k + log(l_k · n): a change of material is a step in it, the same along the whole seam between
two materials, since the normal goes on. Over regions on either side of a seam the step therefore tells the
ratio of two reflectances.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.materials.reflectance import CAP
from vntoolkit.materials.split_frame import SplitFrame
from vntoolkit.native import njit

_REACH_PX = 2  # half the distance over which a step is measured: two blocks of 3×3 pixels that touch nowhere
_SHADING = 0.05  # change of log s over that distance that a curved surface makes
_BESIDE_PX = 3  # from a seam of a label map, which is that exact, to where its step is measured …
_SHADING_BESIDE = 0.08  # … and what a curved surface changes log s over twice that
_GROWTH = 100.0  # pixels for which a region may hold a step larger by one standard deviation
_SMALLEST_PX = 40  # of a region from which a reflectance is estimated


@dataclass(frozen=True, kw_only=True, eq=False)
class Regions:
    """Regions of one frame, and the steps between neighbours.

    logs, variance: (h, w, 3), log s of 3×3 means, and its variance by noise, infinite where not lit. labels:
    (h, w) int32, −1 outside. count: how many. edge: as of `edges_of`. pairs: (m, 2), neighbours.
    steps: (m, 3), median of log s in the second less that in the first.
    """

    logs: FloatArray
    variance: FloatArray
    labels: npt.NDArray[np.int32]
    count: int
    edge: FloatArray
    pairs: npt.NDArray[np.int64]
    steps: FloatArray


def edges_of(split: SplitFrame) -> FloatArray:
    """(h, w), step of log s at each pixel in standard deviations, infinite where it is not known."""
    return np.asarray(_log_and_edge(split.contributions, split.lamps.noise, split.lit)[2])


def regions_of(split: SplitFrame) -> Regions:
    """Cut the lit pixels along steps of log s (felzenszwalb2004), and measure the steps."""
    lit = split.lit
    logs, variance, edge = _log_and_edge(split.contributions, split.lamps.noise, lit)
    east = np.maximum(edge[:, :-1], edge[:, 1:]).ravel()
    south = np.maximum(edge[:-1], edge[1:]).ravel()
    index = np.arange(lit.size).reshape(lit.shape)
    first = np.concatenate([index[:, :-1].ravel(), index[:-1].ravel()])
    second = np.concatenate([index[:, 1:].ravel(), index[1:].ravel()])
    weight = np.concatenate([east, south])
    usable = np.isfinite(weight)
    first, second, weight = first[usable], second[usable], weight[usable]
    order = np.argsort(weight, kind="stable")
    roots = _merge(first[order], second[order], weight[order], lit.size)
    found, inverse, counts = np.unique(roots, return_inverse=True, return_counts=True)
    inside = np.isfinite(edge).ravel()
    kept = counts >= _SMALLEST_PX
    kept &= np.bincount(inverse, weights=inside, minlength=len(found)) > 0
    number = np.where(kept, np.cumsum(kept) - 1, -1).astype(np.int32)
    labels = np.where(inside, number[inverse], -1).reshape(lit.shape).astype(np.int32)
    count = int(kept.sum())
    return Regions(
        logs=logs, variance=variance, labels=labels, count=count, edge=edge, **_steps(logs, labels)
    )


@njit(cache=True, error_model="numpy")
def _log_and_edge(s: Any, noise: Any, lit: Any) -> Any:
    """Return logs and variance as of `Regions`, and the step in standard deviations (h, w), ∞ if unknown."""
    h, w, _ = s.shape
    logs = np.full((h, w, 3), np.nan)
    variance = np.full((h, w, 3), np.inf)
    for v in range(h):
        for u in range(w):
            if not lit[v, u]:
                continue
            total = np.zeros(3)
            count = 0
            for i in range(max(v - 1, 0), min(v + 2, h)):
                for j in range(max(u - 1, 0), min(u + 2, w)):
                    if lit[i, j]:
                        count += 1
                        for k in range(3):
                            total[k] += s[i, j, k]
            for k in range(3):
                mean = total[k] / count
                logs[v, u, k] = np.log(mean)
                variance[v, u, k] = noise[k] * noise[k] / (count * mean * mean)
    edge = np.full((h, w), np.inf)
    r = _REACH_PX
    for v in range(h):
        for u in range(w):
            if not lit[v, u]:
                continue
            largest = 0.0
            known = False
            for way in range(2):
                a, b, c, d = v - r * way, u - r * (1 - way), v + r * way, u + r * (1 - way)
                if a < 0 or b < 0 or c >= h or d >= w or not lit[a, b] or not lit[c, d]:
                    continue
                known = True
                total_step = 0.0
                for k in range(3):
                    step = logs[c, d, k] - logs[a, b, k]
                    total_step += step * step / (variance[a, b, k] + variance[c, d, k] + _SHADING * _SHADING)
                largest = max(largest, total_step)
            if known:
                edge[v, u] = np.sqrt(largest)
    return logs, variance, edge


@njit(cache=True, inline="always")
def _root(parent: Any, i: int) -> int:
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def _merge(first: Any, second: Any, weight: Any, count: int) -> Any:
    parent = np.arange(count)
    size = np.ones(count, np.int64)
    largest = np.zeros(count)
    for e in range(first.size):
        a, b = _root(parent, first[e]), _root(parent, second[e])
        if a == b:
            continue
        if weight[e] <= min(largest[a] + _GROWTH / size[a], largest[b] + _GROWTH / size[b]):
            if size[a] < size[b]:
                a, b = b, a
            parent[b] = a
            size[a] += size[b]
            largest[a] = weight[e]
    for i in range(count):
        parent[i] = _root(parent, i)
    return parent


@njit(cache=True, error_model="numpy")
def seam_information(labels: Any, lit: Any, z: Any, logs: Any, variance: Any) -> float:
    """Nats that the seams of a label map cost: one a pixel, less what a step of paint explains there.

    Where material a meets b, log s steps by log ρ_b − log ρ_a if the surface goes on, and not at all if there
    is no paint. labels, lit: (h, w). z: (m, 3), log ρ. logs, variance: see `Regions`.
    """
    h, w = labels.shape
    total = 0.0
    cap = CAP * CAP
    for v in range(h):
        for u in range(w):
            for way in range(2):
                i, j = v + way, u + 1 - way
                if i >= h or j >= w or not lit[v, u] or not lit[i, j] or labels[v, u] == labels[i, j]:
                    continue
                total += 1.0
                r, s = _BESIDE_PX * way, _BESIDE_PX * (1 - way)
                a, b, c, d = v - r, u - s, i + r, j + s
                if a < 0 or b < 0 or c >= h or d >= w or not lit[a, b] or not lit[c, d]:
                    continue
                painted, plain = 0.0, 0.0
                for k in range(3):
                    step = logs[c, d, k] - logs[a, b, k]
                    rest = step - z[labels[i, j], k] + z[labels[v, u], k]
                    spread = variance[a, b, k] + variance[c, d, k] + _SHADING_BESIDE * _SHADING_BESIDE
                    painted += rest * rest / spread
                    plain += step * step / spread
                total += 0.5 * (min(painted, cap) - min(plain, cap))
    return total


def _steps(logs: FloatArray, labels: npt.NDArray[np.int32]) -> dict[str, Any]:
    """Steps between regions that face each other across the blurred seam."""
    reach = 2 * _REACH_PX + 1
    first, second, steps = [], [], []
    for axis in (0, 1):
        length = labels.shape[axis]
        here = np.take(labels, range(length - reach), axis)
        there = np.take(labels, range(reach, length), axis)
        seam = (here >= 0) & (there >= 0) & (here != there)
        difference = (
            np.take(logs, range(reach, length), axis)[seam] - np.take(logs, range(length - reach), axis)[seam]
        )
        a, b = here[seam], there[seam]
        swapped = a > b
        first.append(np.where(swapped, b, a))
        second.append(np.where(swapped, a, b))
        steps.append(np.where(swapped[:, None], -difference, difference))
    a, b, step = np.concatenate(first), np.concatenate(second), np.concatenate(steps)
    key = a.astype(np.int64) * (labels.max(initial=0) + 1) + b
    order = np.argsort(key, kind="stable")
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    groups = np.split(order, starts[1:]) if len(starts) else []
    groups = [g for g in groups if len(g) >= reach]
    return {
        "pairs": np.array([(a[g[0]], b[g[0]]) for g in groups], dtype=np.int64).reshape(-1, 2),
        "steps": np.array([np.median(step[g], axis=0) for g in groups]).reshape(-1, 3),
    }

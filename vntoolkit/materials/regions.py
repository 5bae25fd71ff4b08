"""Small regions within one paint, and the steps of colour between neighbours.

log s_k = log ρ_k + log(l_k · n). From a small region to its neighbour on the same surface the normal changes
little. So a large step of the mean of log s is one of paint, and tells the ratio of two reflectances. Pixels
on the steps themselves are blurred mixtures. They are kept out, and go to the nearest region afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import prange
from scipy.ndimage import distance_transform_edt

from vntoolkit.arrays import FloatArray, IntArray, Mask
from vntoolkit.materials.split_frame import SplitFrame
from vntoolkit.native import njit

REGION_PX = 8  # side of a region; stripes of half that width are still found
SHADING_STEP = 0.08  # standard deviation of the step of log s between neighbours by shape and texture
_EDGE = 0.25  # step of log s over four pixels that is one of paint …
_REACH_PX = 2  # … which a lens and a Bayer pattern blur over that distance to either side
_COMPACT = 2.0  # weight of the distance in pixels against that in colour
_COLOUR = 0.07  # log s that counts as much as half a region's side
_SWEEPS = 4
SAMPLES = 16  # pixels that stand for a region
_FEWEST_PX = 8  # where two stripes of 8 pixels cross, their edges leave little more
_FILLED_PX = 8.0  # from a region within which pixels of an edge belong to it
_FEWEST_CONTACTS = 3
_FULL_CONTACT_PX = 8.0
_MOST_CONTACT = 1.5
_NEIGHBOURS = 3.0  # steps to about six neighbours are counted twice and hold one difference of means each


@dataclass(frozen=True, kw_only=True, eq=False)
class Regions:
    """The regions of one frame as a graph.

    labels: (h, w) int64, the nearest region to every pixel. plain: (h, w), not on an edge.
    samples: (n, SAMPLES, 3), contributions at pixels of each region. counts: (n,), how many. sizes: (n,).
    planes: (n, 4, SAMPLES) float32, the same, then 1 where there is a sample and 0 where there is none.
    logs: (n, 3), mean log s. starts: (n + 1,), where the neighbours of each begin in `neighbours` (e,).
    steps: (e, 3), log s of the neighbour less its own. contacts: (e,), weights of the steps.
    """

    labels: IntArray
    plain: Mask
    samples: FloatArray
    planes: FloatArray
    counts: IntArray
    sizes: FloatArray
    logs: FloatArray
    starts: IntArray
    neighbours: IntArray
    steps: FloatArray
    contacts: FloatArray

    @property
    def count(self) -> int:
        """How many regions there are."""
        return len(self.sizes)

    @property
    def sources(self) -> IntArray:
        """(e,), the region that each step starts from."""
        return np.repeat(np.arange(self.count), np.diff(self.starts))


def regions_of(split: SplitFrame) -> Regions:
    """Cut the lit pixels into regions of about 8 × 8 pixels that keep to edges (achanta2012)."""
    lit = split.lit
    logs = np.asarray(_mean_logs(split.contributions, lit))
    plain = lit & ~np.asarray(_is_edge(logs, lit))
    cells, sizes = _cells(logs, plain)
    kept = np.flatnonzero(sizes >= _FEWEST_PX)
    number = np.full(len(sizes) + 1, -1, np.int64)
    number[kept] = np.arange(len(kept))
    inner = number[cells]
    samples, counts, means = _sampled(split.contributions, logs, inner, len(kept))
    labels, near = inner, inner >= 0
    if len(kept):
        distance, nearest = distance_transform_edt(inner < 0, return_indices=True)
        labels = inner[nearest[0], nearest[1]]
        near = lit & (distance <= _FILLED_PX)
    return Regions(
        labels=labels,
        plain=plain,
        samples=samples,
        planes=_planes(samples, counts),
        counts=counts,
        sizes=sizes[kept].astype(np.float64),
        logs=means,
        **_neighbours(np.where(near, labels, -1), means),
    )


@njit(cache=True, parallel=True, error_model="numpy")
def _mean_logs(s: Any, lit: Any) -> Any:
    """(h, w, 3), log of the mean over 3 × 3 pixels, 0 where not lit."""
    h, w, _ = s.shape
    logs = np.zeros((h, w, 3))
    for v in prange(h):
        total = np.empty(3)
        for u in range(w):
            if not lit[v, u]:
                continue
            total[:] = 0.0
            count = 0
            for i in range(max(v - 1, 0), min(v + 2, h)):
                for j in range(max(u - 1, 0), min(u + 2, w)):
                    if lit[i, j]:
                        count += 1
                        for k in range(3):
                            total[k] += s[i, j, k]
            for k in range(3):
                logs[v, u, k] = np.log(total[k] / count)
    return logs


@njit(cache=True, parallel=True)
def _is_edge(logs: Any, lit: Any) -> Any:
    h, w, _ = logs.shape
    edge = np.zeros((h, w), np.bool_)
    r = _REACH_PX
    for v in prange(h):
        for u in range(w):
            for way in range(2):
                a, b, c, d = v - r * way, u - r * (1 - way), v + r * way, u + r * (1 - way)
                if a < 0 or b < 0 or c >= h or d >= w or not lit[a, b] or not lit[c, d]:
                    continue
                for k in range(3):
                    if abs(logs[c, d, k] - logs[a, b, k]) > _EDGE:
                        edge[v, u] = True
    return edge


def _cells(logs: FloatArray, plain: Mask) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the cell of every plain pixel, −1 elsewhere, and the sizes of the cells."""
    v, u = np.indices(plain.shape) // REGION_PX
    across = (plain.shape[1] + REGION_PX - 1) // REGION_PX
    cells = np.where(plain, v * across + u, -1)
    count = across * ((plain.shape[0] + REGION_PX - 1) // REGION_PX)
    for _ in range(_SWEEPS):
        centres, sizes = _centres(logs, cells, count)
        cells = _nearest_cells(logs, plain, centres, sizes, across)
    return cells, np.bincount(cells[plain], minlength=count)


@njit(cache=True, error_model="numpy")
def _centres(logs: Any, cells: Any, count: int) -> Any:
    h, w = cells.shape
    centres, sizes = np.zeros((count, 5)), np.zeros(count)
    for v in range(h):
        for u in range(w):
            i = cells[v, u]
            if i >= 0:
                sizes[i] += 1.0
                centres[i, 0] += v
                centres[i, 1] += u
                for k in range(3):
                    centres[i, 2 + k] += logs[v, u, k]
    for i in range(count):
        if sizes[i] > 0.0:
            for k in range(5):
                centres[i, k] /= sizes[i]
    return centres, sizes


@njit(cache=True, parallel=True)
def _nearest_cells(logs: Any, plain: Any, centres: Any, sizes: Any, across: int) -> Any:
    h, w = plain.shape
    cells = np.full((h, w), -1, np.int64)
    down = sizes.size // across
    for v in prange(h):
        for u in range(w):
            if not plain[v, u]:
                continue
            least = np.inf
            row, column = v // REGION_PX, u // REGION_PX
            for i in range(max(row - 1, 0), min(row + 2, down)):
                for j in range(max(column - 1, 0), min(column + 2, across)):
                    m = i * across + j
                    if sizes[m] == 0.0:
                        continue
                    away = (v - centres[m, 0]) ** 2 + (u - centres[m, 1]) ** 2
                    distance = _COMPACT * away / REGION_PX**2
                    for k in range(3):
                        distance += ((logs[v, u, k] - centres[m, 2 + k]) / _COLOUR) ** 2
                    if distance < least:
                        least = distance
                        cells[v, u] = m
    return cells


@njit(cache=True, error_model="numpy")
def _sampled(s: Any, logs: Any, labels: Any, count: int) -> Any:
    """Return samples (n, SAMPLES, 3) spread evenly over each region, how many, and mean logs (n, 3)."""
    h, w = labels.shape
    sizes = np.zeros(count, np.int64)
    means = np.zeros((count, 3))
    for v in range(h):
        for u in range(w):
            i = labels[v, u]
            if i >= 0:
                sizes[i] += 1
                for k in range(3):
                    means[i, k] += logs[v, u, k]
    samples = np.zeros((count, SAMPLES, 3))
    taken, passed = np.zeros(count, np.int64), np.zeros(count, np.int64)
    for v in range(h):
        for u in range(w):
            i = labels[v, u]
            if i >= 0:
                if taken[i] < SAMPLES and passed[i] * SAMPLES >= taken[i] * sizes[i]:
                    for k in range(3):
                        samples[i, taken[i], k] = s[v, u, k]
                    taken[i] += 1
                passed[i] += 1
    for i in range(count):
        for k in range(3):
            means[i, k] /= sizes[i]
    return samples, taken, means


def _planes(samples: FloatArray, counts: IntArray) -> FloatArray:
    there = np.arange(SAMPLES) < counts[:, None]
    return np.concatenate([samples.transpose(0, 2, 1), there[:, None]], axis=1).astype(np.float32)


def _neighbours(labels: IntArray, logs: FloatArray) -> dict[str, Any]:
    count = len(logs)
    pairs = []
    for one, other in ((labels[:, :-1], labels[:, 1:]), (labels[:-1], labels[1:])):
        touch = (one >= 0) & (other >= 0) & (one != other)
        pairs.append(np.stack([one[touch], other[touch]]))
    found = np.sort(np.concatenate(pairs, axis=1), axis=0)
    keys, length = np.unique(found[0] * max(count, 1) + found[1], return_counts=True)
    keys, length = keys[length >= _FEWEST_CONTACTS], length[length >= _FEWEST_CONTACTS]
    one, other = keys // max(count, 1), keys % max(count, 1)
    sources, neighbours = np.concatenate([one, other]), np.concatenate([other, one])
    contacts = np.minimum(np.tile(length, 2) / _FULL_CONTACT_PX, _MOST_CONTACT) / _NEIGHBOURS
    order = np.argsort(sources, kind="stable")
    sources, neighbours = sources[order], neighbours[order]
    return {
        "starts": np.searchsorted(sources, np.arange(count + 1)),
        "neighbours": neighbours,
        "steps": logs[neighbours] - logs[sources],
        "contacts": contacts[order],
    }

"""Small regions within one paint, and the steps of colour between neighbours.

log s_k = log ρ_k + log(l_k · n). From a small region to its neighbour on the same surface the normal changes
little. So a large step of the mean of log s is one of paint, and tells the ratio of two reflectances. Pixels
on the steps themselves are blurred mixtures. They are kept out, and go to the nearest region afterwards.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import distance_transform_edt, uniform_filter

from vntoolkit.arrays import FloatArray, IntArray, Mask
from vntoolkit.materials.split_frame import SplitFrame

# Side of a region; stripes of half that width are still found. Pixels of an edge so near to a region belong
# to it, and a contact as long counts in full.
REGION_PX = 8
SHADING_STEP = 0.08  # standard deviation of the step of log s between neighbours by shape and texture
_EDGE = 0.25  # step of log s over four pixels that is one of paint …
_REACH_PX = 2  # … which a lens and a Bayer pattern blur over that distance to either side
_COMPACT = 2.0  # weight of the distance in pixels against that in colour
_COLOUR = 0.07  # log s that counts as much as half a region's side
_SWEEPS = 4
SAMPLES = 16  # pixels that stand for a region
_FEWEST_PX = 8  # where two stripes of 8 pixels cross, their edges leave little more
_FEWEST_CONTACTS = 3
_MOST_CONTACT = 1.5
_NEIGHBOURS = 3.0  # steps to about six neighbours are counted twice and hold one difference of means each


@dataclass(frozen=True, kw_only=True, eq=False)
class Regions:
    """The regions of one frame as a graph.

    labels: (h, w) int64, the nearest region to every pixel. plain: (h, w), not on an edge.
    samples: (n, SAMPLES, 3), contributions at pixels of each region. counts: (n,), how many. sizes: (n,).
    logs: (n, 3), mean log s. starts: (n + 1,), where the neighbours of each begin in `neighbours` (e,).
    steps: (e, 3), log s of the neighbour less its own. contacts: (e,), weights of the steps.
    """

    labels: IntArray
    plain: Mask
    samples: FloatArray
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
    def known(self) -> Mask:
        """(n, SAMPLES), where there is a sample."""
        return np.asarray(np.arange(SAMPLES) < self.counts[:, None])

    @property
    def sources(self) -> IntArray:
        """(e,), the region that each step starts from."""
        return np.repeat(np.arange(self.count), np.diff(self.starts))


def regions_of(split: SplitFrame) -> Regions:
    """Cut the lit pixels into regions of about 8 × 8 pixels that keep to edges (achanta2012)."""
    lit = split.lit
    logs = _mean_logs(split.contributions, lit)
    plain = lit & ~_is_edge(logs, lit)
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
        near = lit & (distance <= REGION_PX)
    return Regions(
        labels=labels,
        plain=plain,
        samples=samples,
        counts=counts,
        sizes=sizes[kept].astype(np.float64),
        logs=means,
        **_neighbours(np.where(near, labels, -1), means),
    )


def _mean_logs(s: FloatArray, lit: Mask) -> FloatArray:
    """(h, w, 3), log of the mean over the lit of 3 × 3 pixels, 0 where not lit."""
    total, share = (
        uniform_filter(image, 3, mode="constant", axes=(0, 1))
        for image in (np.where(lit[..., None], s, 0.0), lit.astype(np.float64))
    )
    logs = np.zeros(s.shape)
    logs[lit] = np.log(total[lit] / share[lit, None])
    return logs


def _is_edge(logs: FloatArray, lit: Mask) -> Mask:
    edge, far = np.zeros(lit.shape, np.bool_), 2 * _REACH_PX
    for way in range(2):
        before, after, middle = ([slice(None), slice(None)] for _ in range(3))
        before[way], after[way] = slice(None, -far), slice(far, None)
        middle[way] = slice(_REACH_PX, -_REACH_PX)
        one, other = tuple(before), tuple(after)
        step = np.abs(logs[other] - logs[one]).max(axis=2)
        edge[tuple(middle)] |= lit[one] & lit[other] & (step > _EDGE)
    return edge


def _cells(logs: FloatArray, plain: Mask) -> tuple[IntArray, IntArray]:
    """Return the cell of every plain pixel, −1 elsewhere, and the sizes of the cells."""
    v, u = np.nonzero(plain)
    down, across = (-(-n // REGION_PX) for n in plain.shape)
    seen = np.column_stack([v, u, logs[v, u]])
    scale = np.array([np.sqrt(_COMPACT) / REGION_PX] * 2 + [1.0 / _COLOUR] * 3)
    row, column = v // REGION_PX, u // REGION_PX
    cells = row * across + column
    for _ in range(_SWEEPS):
        sizes = np.bincount(cells, minlength=down * across)
        sums = np.stack([np.bincount(cells, each, down * across) for each in seen.T], axis=1)
        centres = sums / np.maximum(sizes, 1)[:, None]
        least = np.full(len(v), np.inf)
        for i, j in np.ndindex(3, 3):
            a, b = row + i - 1, column + j - 1
            other = a.clip(0, down - 1) * across + b.clip(0, across - 1)
            away = (((seen - centres[other]) * scale) ** 2).sum(axis=1)
            away[sizes[other] == 0] = np.inf
            nearer = away < least
            least[nearer], cells[nearer] = away[nearer], other[nearer]
    found = np.full(plain.shape, -1, np.int64)
    found[v, u] = cells
    return found, np.bincount(cells, minlength=down * across)


def _sampled(
    s: FloatArray, logs: FloatArray, labels: IntArray, count: int
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return samples (n, SAMPLES, 3) spread evenly over each region, how many, and mean logs (n, 3)."""
    places = np.flatnonzero(labels >= 0)
    of = labels.ravel()[places]
    places = places[np.argsort(of, kind="stable")]
    sizes = np.bincount(of, minlength=count)
    taken = np.minimum(sizes, SAMPLES)
    step = np.maximum(sizes, SAMPLES)[:, None]
    order = np.minimum(-(-np.arange(SAMPLES) * step // SAMPLES), np.maximum(sizes - 1, 0)[:, None])
    chosen = places[(np.cumsum(sizes) - sizes)[:, None] + order]
    samples = s.reshape(-1, 3)[chosen] * (np.arange(SAMPLES) < taken[:, None])[..., None]
    sums = [np.bincount(of, each, count) for each in logs[labels >= 0].T]
    return samples, taken, np.stack(sums, axis=1) / np.maximum(sizes, 1)[:, None]


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
    contacts = np.minimum(np.tile(length, 2) / REGION_PX, _MOST_CONTACT) / _NEIGHBOURS
    order = np.argsort(sources, kind="stable")
    sources, neighbours = sources[order], neighbours[order]
    return {
        "starts": np.searchsorted(sources, np.arange(count + 1)),
        "neighbours": neighbours,
        "steps": logs[neighbours] - logs[sources],
        "contacts": contacts[order],
    }

"""How many materials the footage shows, and their reflectances.

First every region has a reflectance of its own. Steps of paint between neighbours tell their ratios
(land1971), and unit length of all normals tells the rest: flat regions learn from others. Reflectances that
many regions share are proposed as materials, too many of them. Then materials are left out, one after the
other, and the shortest description of the frame is taken: lengths and steps in units of their spread, the
seams of the label map, and three numbers a material (rissanen1978), or one of a material that has the hue of
the rig's: black and white print is of one hue.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.linalg import block_diag
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points
from vntoolkit.errors import BadInput
from vntoolkit.materials.mixtures import FIRST_SPREAD, INDEPENDENT_PX, Spread
from vntoolkit.materials.paint_levels import FALL, PAINT_STEP, SeamSteps
from vntoolkit.materials.reflectance import (
    CAP,
    LARGEST_RATIO,
    Lamps,
    Reflectance,
    best_fit,
    reflectance_from_fit,
)
from vntoolkit.materials.region_labels import DOUBTFUL, agreed, prices_of_regions, spread_of, total_cost
from vntoolkit.materials.region_lengths import (
    WEAK_PRIOR,
    lengths_of,
    normal_equations,
)
from vntoolkit.materials.regions import (
    SHADING_STEP,
    Regions,
    regions_of,
)
from vntoolkit.materials.split_frame import SplitFrame, split_frame, stacked
from vntoolkit.options.reconstruction import MOST_MATERIALS
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.spread import robust_deviation

_SEARCHED_PIXELS = 40_000  # of the subject
_LEAST_INSIDE = 1 / 3  # of the blocks, that lie inside patches, as of squares that hold a region each
WORST_ERROR_DEG = 5.0  # of normals, by what their spread leaves open of a reflectance
_FEWEST_PIXELS = 300
_FEWEST_REGIONS = 3
_FIT_PIXELS = 2000
_TOLERANCES = (
    0.02,
    0.1,
)  # least and most of a normal's length beyond noise that is no sign of another material
_ROUGH = 0.2  # first tolerance of the regions' own reflectances, which falls by `FALL` a round
_ROUNDS = 9
_FIRST_ROUNDS, _FIT_ROUNDS = 4, 5
_ALIKE = 0.1  # spread of log ρ of the regions of one material
# Log ρ that two materials differ by at least, in spreads of lengths from region to region.
_TWINS = 2.0
_MOST_PROPOSALS = 16  # a third more than there may be in the end
_FEWEST_VOTES = 1.0  # regions of full size
_LARGEST_STEP = 0.3
_FEW = 5.0  # nats of a material beside those of its numbers: subjects are of few
_SPLITS, _LEAST_GAIN = 3, 1.0
_MOST_PATCHES, _PATCH_PIXELS = 8, 240
_SEAM_PRICE = 3.0  # of neighbours of two materials, that a print is of few colours and large patches
# Standard deviation of log ρ from seams, where shading steps, too: 0.01 to 0.02 on tartans, more on one logo.
_OF_SEAMS = 0.015


@dataclass(frozen=True, kw_only=True, eq=False)
class Material:
    """A material that was found. share: of the lit pixels. alternative_deg: root mean square turn of its
    normals by what else the footage may show.
    """

    reflectance: Reflectance
    share: float
    alternative_deg: float = 0.0


@dataclass(frozen=True, kw_only=True, eq=False)
class SearchedFrames:
    """Frames in blocks, below each other, and their regions."""

    split: SplitFrame
    regions: Regions


def searched_frames(
    frames: Sequence[LinearFrame], masks: Sequence[Mask], response: LightResponse
) -> SearchedFrames:
    """Return frames in blocks, as small as the number of searched pixels allows, and their regions.

    frames, masks: of one size (h, w), every lamp as strong as at the centre. More frames show other normals,
    but in larger blocks. Where most blocks lie on edges, patches of one paint are hardly larger than blocks:
    then the first frame alone is looked at, in smaller ones. Raises `BadInput` where the lamps' colours are
    not known, or no pixel is reached by all three lamps.
    """
    split = stacked(
        [
            split_frame(frame, response, mask, _SEARCHED_PIXELS // len(frames))
            for frame, mask in zip(frames, masks, strict=True)
        ]
    )
    regions = regions_of(split)
    if len(frames) > 1 and regions.sizes.sum() < _LEAST_INSIDE * split.lit.sum():
        return searched_frames(frames[:1], masks[:1], response)
    if split.lit.sum() < _FEWEST_PIXELS or regions.count < _FEWEST_REGIONS:
        raise BadInput(
            "materials: hardly any pixel is reached by all three lamps and not clipped; look at exposure, "
            "mask and rig"
        )
    return SearchedFrames(split=split, regions=regions)


def find_materials(searched: SearchedFrames, count: int | None = None) -> list[Material]:
    """Find the materials of a few frames, that of most pixels first; `count` or as many as there are."""
    regions, lamps = searched.regions, searched.split.lamps
    own, tolerance = _reflectances_of_regions(regions, lamps)
    found = _fewest(_proposals(own, regions, count), regions, lamps, tolerance, count)
    fixed = regions, lamps, tolerance, 1, found.spread
    found = _converged(found.logs, found.labels, *fixed)
    if count is None:
        one, of_rig = np.zeros(regions.count, np.int64), np.ones(1, np.bool_)
        rigs_own = _converged(np.zeros((1, 3)), one, *fixed, of_rig)
        if rigs_own.length <= found.length:
            return _fitted_each(rigs_own, of_rig, searched, tolerance)
    found, of_rig = _in_rigs_hue(found, regions, lamps, tolerance)
    materials = _fitted_each(found, of_rig, searched, tolerance)
    return sorted(materials, key=lambda material: -material.share)


def _fitted_each(found: _Found, of_rig: Mask, searched: SearchedFrames, tolerance: float) -> list[Material]:
    """Return the materials of a description, each fitted once more to its own pixels.

    of_rig: (m,), those of the hue of the rig's.
    """
    split, regions = searched.split, searched.regions
    shares = np.bincount(found.labels[regions.labels[split.lit]], minlength=len(found.logs)) / split.lit.sum()
    of_region = regions.labels[regions.plain]  # on edges of paint are mixtures
    labels, s = found.labels[of_region], split.contributions[regions.plain]
    materials = []
    # of a material of the rig's hue, too, the error is what the footage leaves open: its hue is the likeliest
    covariance = np.linalg.inv(found.normal_matrix + 1e-9 * np.eye(3 * len(found.logs)))
    for m, log in enumerate(found.logs):
        pixels = s[labels == m]
        pixels = pixels if len(pixels) else s  # a number was asked for that nothing supports
        pixels = np.ascontiguousarray(pixels[:: max(1, len(pixels) // _FIT_PIXELS)])
        block, own_log = covariance[3 * m : 3 * m + 3, 3 * m : 3 * m + 3], log
        if not of_rig[m]:
            own_log, _, _ = best_fit(
                pixels, split.lamps, tolerance, log[None], _OF_SEAMS, 1.0 / INDEPENDENT_PX
            )
        fitted = reflectance_from_fit(own_log, block, pixels, split.lamps)
        materials.append(Material(reflectance=fitted, share=float(shares[m])))
    return materials


# A reflectance for every region.


def _reflectances_of_regions(regions: Regions, lamps: Lamps) -> tuple[Points, float]:
    """Return (n, 3), log ρ of every region, and the spread of the normals' lengths within regions.

    The seams alone tell log ρ up to one constant. With it taken off, all samples are of one material, whose
    reflectance is that constant. Then lengths and steps are balanced by Gauss–Newton, from rough to fine.
    """
    seams = SeamSteps(regions)
    x = seams.levels()
    weights = regions.sizes / INDEPENDENT_PX
    known = regions.known
    samples = (regions.samples * np.exp(-x)[:, None])[known]
    samples = np.ascontiguousarray(samples[:: max(1, len(samples) // _FIT_PIXELS)])
    centre = best_fit(samples, lamps, FIRST_SPREAD)[0]
    x = x + centre
    for done in range(_ROUNDS):
        rough = max(FIRST_SPREAD, _ROUGH * FALL**done)
        matrices, gradients = normal_equations(regions, x, lamps, weights, rough)
        x = seams.balanced(x, centre, max(1.0, CAP * FALL**done), matrices, gradients)
    lengths = (regions.samples * np.exp(-x)[:, None] - lamps.ambient)[known] @ lamps.inverse.T
    residual = robust_deviation(np.linalg.norm(lengths, axis=1) - 1.0)
    return x, float(np.clip(residual, *_TOLERANCES))


def _proposals(own: Points, regions: Regions, count: int | None) -> Points:
    """Return (m, 3), log ρ that many regions share, from the most votes down."""
    weights = regions.sizes / INDEPENDENT_PX
    apart = sum((each[:, None] - each) ** 2 for each in own.T)
    found: list[Any] = []
    alike = _ALIKE
    while True:
        near = np.exp(-0.5 * apart / alike**2) * weights
        left = np.ones(len(own), np.bool_)
        found = []
        while left.any() and len(found) < _MOST_PROPOSALS:
            votes = near @ left * left
            top = int(votes.argmax())
            if votes[top] < _FEWEST_VOTES and found:
                break
            mode = (near[top] * left) @ own / (near[top] @ left)
            left &= np.sum((own - mode) ** 2, axis=1) > (2.0 * alike) ** 2
            left[top] = False
            if np.ptp(mode) < LARGEST_RATIO or not found:
                found.append(mode)
        if count is None or len(found) >= count or alike < 1e-4:
            return np.array(found)
        alike *= 0.5


# The fewest that describe the frame.


@dataclass(frozen=True, kw_only=True, eq=False)
class _Found:
    """Materials so far. logs: (m, 3). labels: (n,). costs: (n, m). length: nats. normal_matrix: of logs."""

    logs: Points
    labels: IntArray
    costs: FloatArray
    length: float
    normal_matrix: FloatArray
    spread: Spread


def _fewest(logs: Points, regions: Regions, lamps: Lamps, tolerance: float, count: int | None) -> _Found:
    """Return the shortest description, or that of `count` materials.

    Materials are left out one after the other; then what is still unexplained proposes others, as long as
    that makes the description shorter.
    """
    if count == 1:  # start from the proposal with most votes; all others would be left out again
        logs = logs[:1]
    found = _converged(logs, None, regions, lamps, tolerance, _FIRST_ROUNDS, None)
    found = _thinned(found, regions, lamps, tolerance, count)
    for _ in range(_SPLITS):
        more = _of_unexplained(found, regions, lamps, tolerance)
        if not len(more):
            break
        again = _converged(np.vstack([found.logs, more]), None, regions, lamps, tolerance, 2, found.spread)
        again = _thinned(again, regions, lamps, tolerance, count, found.length)
        if again.length >= found.length - _LEAST_GAIN:
            break
        found = again
    return found


def _thinned(
    found: _Found, regions: Regions, lamps: Lamps, tolerance: float, count: int | None,
    least: float = np.inf,
) -> _Found:  # fmt: skip
    """Leave out materials one after the other, and return the shortest description on the way.

    Fewer materials explain no more. So the end is reached where what is unexplained is as long as the
    shortest description, or as one of length `least`, even if but one material were left.
    """
    best: _Found | None = None
    while True:
        if count is None:
            found = _used(found, regions)
        allowed = len(found.logs) <= (count or MOST_MATERIALS) and (count or not _has_duplicates(found))
        if allowed and (best is None or found.length < best.length):
            best = found
        if len(found.logs) <= (count or 1):
            break
        unexplained = found.length - _numbers(regions) * (len(found.logs) - 1)
        if count is None and unexplained >= min(least, np.inf if best is None else best.length):
            break
        fewer = [
            _converged(logs, labels, regions, lamps, tolerance, 1, found.spread)
            for logs, labels in (_without_one(found, regions), _merged(found))
        ]
        found = min(fewer, key=lambda each: each.length)
    return best or found


def _used(found: _Found, regions: Regions) -> _Found:
    """Return the same without materials that no region is of."""
    kept, labels = np.unique(found.labels, return_inverse=True)
    numbers = (3 * kept[:, None] + np.arange(3)).ravel()
    return replace(
        found,
        logs=found.logs[kept],
        labels=labels.reshape(found.labels.shape),
        costs=np.ascontiguousarray(found.costs[:, kept]),
        length=found.length - _numbers(regions) * (len(found.logs) - len(kept)),
        normal_matrix=found.normal_matrix[np.ix_(numbers, numbers)],
    )


def _merged(found: _Found) -> tuple[Points, IntArray]:
    """Return log ρ (m − 1, 3) and labels where the two most nearly equal materials are one (wald1943)."""
    count = len(found.logs)
    blocks = [found.normal_matrix[3 * m : 3 * m + 3, 3 * m : 3 * m + 3] for m in range(count)]
    ridge = WEAK_PRIOR * np.eye(3)
    covariances = np.linalg.inv(np.array(blocks) + ridge)
    first, second = np.triu_indices(count, 1)
    apart = found.logs[first] - found.logs[second]
    solved = np.linalg.solve(covariances[first] + covariances[second], apart[..., None])[..., 0]
    pair = int(np.sum(apart * solved, axis=1).argmin())
    m, n = int(first[pair]), int(second[pair])
    logs = found.logs.copy()
    logs[m] = np.linalg.solve(
        blocks[m] + blocks[n] + 2.0 * ridge,
        (blocks[m] + ridge) @ found.logs[m] + (blocks[n] + ridge) @ found.logs[n],
    )
    labels = np.where(found.labels == n, m, found.labels)
    return np.delete(logs, n, axis=0), labels - (labels > n)


def _of_unexplained(found: _Found, regions: Regions, lamps: Lamps, tolerance: float) -> Points:
    """Return (m, 3), log ρ of patches that no material explains, by their own lengths and by their seams."""
    paid = np.take_along_axis(found.costs, found.labels[:, None], 1)[:, 0]
    doubtful = paid > DOUBTFUL
    a, b = regions.sources, regions.neighbours
    alike = doubtful[a] & doubtful[b] & (np.abs(regions.steps).max(axis=1) < PAINT_STEP)
    graph = sparse.coo_array((np.ones(alike.sum()), (a[alike], b[alike])), shape=(regions.count,) * 2)
    patches = connected_components(graph, directed=False)[1]
    sizes = np.bincount(patches, weights=regions.sizes * doubtful)
    proposals: list[Any] = []
    for patch in np.argsort(-sizes)[:_MOST_PATCHES]:
        if sizes[patch] < INDEPENDENT_PX:
            break
        inside = (patches == patch) & doubtful
        samples = [regions.samples[i, : regions.counts[i]] for i in np.flatnonzero(inside)]
        pixels = np.concatenate(samples)
        pixels = np.ascontiguousarray(pixels[:: max(1, len(pixels) // _PATCH_PIXELS)])
        across = inside[a] & ~doubtful[b]
        fits = [best_fit(pixels, lamps, tolerance)]
        if across.any():
            starts = found.logs[found.labels[b[across]]] - regions.steps[across]
            fits.append(best_fit(pixels, lamps, tolerance, np.median(starts, axis=0)[None]))
        proposals += [log for log, _, _ in fits if np.ptp(log) < LARGEST_RATIO]
    kept: list[Any] = []
    for log in proposals:
        others = np.array([*found.logs, *kept])
        if np.abs(others - log).max(axis=1).min() > _TWINS * found.spread.of_regions:
            kept.append(log)
    return np.array(kept).reshape(-1, 3)


def _in_rigs_hue(
    found: _Found, regions: Regions, lamps: Lamps, tolerance: float
) -> tuple[_Found, npt.NDArray[np.bool_]]:
    """Return the description in which materials have the hue of the rig's, where that makes it shorter.

    And which (m,) do. Their normals are then those of the rig's own M.
    """
    of_rig = np.zeros(len(found.logs), np.bool_)
    for m in np.ptp(found.logs, axis=1).argsort():
        more = of_rig | (np.arange(len(of_rig)) == m)
        other = _converged(found.logs, found.labels, regions, lamps, tolerance, 1, found.spread, more)
        if other.length < found.length:
            found, of_rig = other, more
    return found, of_rig


def _free_numbers(of_rig: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """(3m, k), the log ρ of all materials by the k numbers that are free: one of those of the rig's hue."""
    blocks = [np.ones((3, 1)) if is_one else np.eye(3) for is_one in of_rig]
    return np.asarray(block_diag(*blocks))


def _has_duplicates(found: _Found) -> bool:
    apart = np.abs(found.logs[:, None] - found.logs).max(axis=2) + np.eye(len(found.logs))
    return bool(apart.min() < _TWINS * found.spread.of_regions)


def _without_one(found: _Found, regions: Regions) -> tuple[Points, IntArray]:
    """Leave out the material without which the description is shortest, before anything is fitted again."""
    best: tuple[float, Points, IntArray] | None = None
    for m in range(len(found.logs)):
        logs, costs = np.delete(found.logs, m, axis=0), np.delete(found.costs, m, axis=1)
        labels = np.where(found.labels == m, costs.argmin(axis=1), found.labels - (found.labels > m))
        labels = agreed(costs, logs, regions, _SEAM_PRICE, labels)
        length = total_cost(costs, labels, logs, regions, _SEAM_PRICE)
        if best is None or length < best[0]:
            best = length, logs, labels
    assert best is not None
    return best[1:]


def _converged(
    logs: Points,
    labels: IntArray | None,
    regions: Regions,
    lamps: Lamps,
    tolerance: float,
    rounds: int,
    spread: Spread | None,
    of_rig: Mask | None = None,
) -> _Found:
    """Alternate between labels and reflectances, all of which are fitted together.

    of_rig: (m,), materials of the hue of the rig's, which are only brighter or darker; None for none.
    """
    of_rig = np.zeros(len(logs), np.bool_) if of_rig is None else of_rig
    free = _free_numbers(of_rig)
    logs = np.where(of_rig[:, None], logs.mean(axis=1, keepdims=True), logs)
    size, weights = 3 * len(logs), regions.sizes / INDEPENDENT_PX
    numbers = _numbers(regions) * (len(logs) - 2.0 / 3.0 * np.count_nonzero(of_rig))
    damping, matrix = WEAK_PRIOR * np.eye(size), np.zeros((size, size))
    is_given = spread is not None
    spread = spread or Spread(FIRST_SPREAD, FIRST_SPREAD)
    for _ in range(rounds):
        lengths = lengths_of(regions, logs, lamps)
        costs = prices_of_regions(lengths, spread)
        labels = _cheapest(costs, logs, regions, labels)
        if not is_given:
            spread = spread_of(lengths, labels)
        paid = np.take_along_axis(costs, labels[:, None], 1)[:, 0]
        for i in range(_FIT_ROUNDS):
            reach = _ROUGH * 0.5**i  # at first nothing is an outlier that two merged materials hold
            own_matrices, own_gradients = normal_equations(
                regions, logs[labels], lamps, weights, tolerance, reach
            )
            matrix[:], gradient = 0.0, np.zeros(size)
            _add_lengths(labels, own_matrices, own_gradients, matrix, gradient)
            _add_steps(labels, paid, logs, regions, matrix, gradient)
            bounded = free.T @ (matrix + damping) @ free
            step = (free @ np.linalg.solve(bounded, free.T @ gradient)).clip(-_LARGEST_STEP, _LARGEST_STEP)
            logs = logs + step.reshape(-1, 3)
    costs = prices_of_regions(lengths_of(regions, logs, lamps), spread)
    labels = _cheapest(costs, logs, regions, labels)
    length = total_cost(costs, labels, logs, regions, _SEAM_PRICE) + numbers
    return _Found(
        logs=logs, labels=labels, costs=costs, length=length, normal_matrix=matrix, spread=spread
    )  # fmt: skip


def _cheapest(costs: FloatArray, logs: Points, regions: Regions, labels: IntArray | None) -> IntArray:
    """Return labels found from the prices alone, or from those before if they end up cheaper."""
    anew = (
        agreed(costs, logs, regions, _SEAM_PRICE) if len(logs) <= MOST_MATERIALS or labels is None else labels
    )
    if labels is None:
        return anew
    kept = agreed(costs, logs, regions, _SEAM_PRICE, labels)
    cheaper = total_cost(costs, anew, logs, regions, _SEAM_PRICE) < total_cost(
        costs, kept, logs, regions, _SEAM_PRICE
    )
    return anew if cheaper else kept


def _numbers(regions: Regions) -> float:
    """Nats of a material: of its three numbers (schwarz1978), and that subjects are of few."""
    return _FEW + 1.5 * float(np.log(max(regions.sizes.sum() / INDEPENDENT_PX, 2.0)))


def _add_lengths(
    labels: IntArray, matrices: FloatArray, gradients: FloatArray, matrix: FloatArray, gradient: FloatArray
) -> None:
    """Add the normal equations of lengths, (n, 3, 3) and (n, 3) of the regions, to those of the materials."""
    places = 3 * labels[:, None] + np.arange(3)
    np.add.at(gradient, places, gradients)
    np.add.at(matrix, (places[:, :, None], places[:, None]), matrices)


def _add_steps(
    labels: IntArray, paid: FloatArray, z: Points, regions: Regions, matrix: FloatArray, gradient: FloatArray
) -> None:
    """Add the normal equations of the steps between materials, of log ρ z (m, 3)."""
    i, j = regions.sources, regions.neighbours
    observable = (i < j) & (labels[i] != labels[j]) & (np.maximum(paid[i], paid[j]) <= DOUBTFUL)
    m, n = labels[i[observable]], labels[j[observable]]
    rest = regions.steps[observable] - z[n] + z[m]
    falling = 1.0 / (1.0 + ((rest / SHADING_STEP) ** 2).sum(axis=1) / CAP**2)
    weight = np.repeat((regions.contacts[observable] * (falling / SHADING_STEP) ** 2)[:, None], 3, axis=1)
    first, second = (3 * each[:, None] + np.arange(3) for each in (m, n))
    for a, b, sign in (
        (first, first, 1.0),
        (second, second, 1.0),
        (first, second, -1.0),
        (second, first, -1.0),
    ):
        np.add.at(matrix, (a, b), sign * weight)
    np.add.at(gradient, second, weight * rest)
    np.add.at(gradient, first, -weight * rest)

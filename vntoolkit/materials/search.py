"""How many materials the footage shows, and their reflectances.

Regions propose reflectances: each by the unit length of its own normals, and from a neighbour's reflectance
times the step across their seam. The proposal that explains most of what is not yet explained is taken. All
reflectances are fitted again on the pixels that they explain best. So it goes on until the description of the
frame gets no shorter: residuals in units of noise, three numbers a material, and the seams of the label map
(rissanen1978).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points, Vector3
from vntoolkit.errors import BadInput
from vntoolkit.materials.labelling import TOLERANCE, MaterialLabels, prices, smoothed
from vntoolkit.materials.reflectance import CAP, Lamps, Reflectance, best_fit, fit_reflectance
from vntoolkit.materials.regions import Regions, regions_of, seam_information
from vntoolkit.materials.split_frame import WORKING_PIXELS, SplitFrame, split_frame
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

MOST_MATERIALS = 12
_INDEPENDENT_PX = 64.0  # pixels that share their errors: lamps, gloss and ambient light change slowly
_LARGEST_RATIO = np.log(12.0)  # of the reflectances of one material
WORST_ERROR_DEG = 5.0  # of normals, by what their spread leaves open of a reflectance
_SMALL_SHARE = 0.02
_FIT_PIXELS = 2000
_PROPOSAL_PIXELS = 240
_FEWEST_PIXELS = 30
_UNEXPLAINED = 0.5 * CAP**2
_SAME = 0.03  # proposals that differ less in log ρ are one


@dataclass(frozen=True, kw_only=True, eq=False)
class Material:
    """A material that was found. share: of the lit pixels. tells_hue: see `find_materials`."""

    reflectance: Reflectance
    share: float


def find_materials(
    frames: Sequence[LinearFrame], masks: Sequence[Mask], response: LightResponse, count: int | None = None
) -> list[Material]:
    """Find the materials of a few frames, that of most pixels first; `count` or as many as there are.

    frames, masks: of one size (h, w), every lamp as strong as at the centre. Raises `BadInput` where the
    lamps' colours are not known, or no pixel is reached by all three lamps.
    """
    split = _stacked(
        [
            split_frame(frame, response, mask, WORKING_PIXELS // len(frames))
            for frame, mask in zip(frames, masks, strict=True)
        ]
    )
    if split.lit.sum() < 10 * _FEWEST_PIXELS:
        raise BadInput(
            "materials: hardly any pixel is reached by all three lamps and not clipped; look at exposure, "
            "mask and rig"
        )
    logs, labels, costs = _search(split, count)
    found = []
    for m in range(len(logs)):
        pixels = _pixels_of(m, split, labels, costs)
        fitted = fit_reflectance(pixels, split.lamps, TOLERANCE, 1.0 / _INDEPENDENT_PX, logs[m])
        found.append(
            Material(reflectance=fitted, share=float((split.lit & (labels == m)).sum() / split.lit.sum()))
        )
    return sorted(found, key=lambda material: -material.share)


def _stacked(splits: Sequence[SplitFrame]) -> SplitFrame:
    """Put frames below each other, a dark row between: the same materials, other normals."""
    if len(splits) == 1:
        return splits[0]

    def joined(images: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
        width = max(image.shape[1] for image in images)
        pads = [((0, 1), (0, width - image.shape[1])) + ((0, 0),) * (image.ndim - 2) for image in images]
        return np.concatenate([np.pad(image, pad) for image, pad in zip(images, pads, strict=True)])

    lamps = splits[0].lamps
    mixing = np.sqrt(np.mean([split.lamps.mixing**2 for split in splits], axis=0)) * np.sign(lamps.mixing)
    return replace(
        splits[0],
        contributions=joined([split.contributions for split in splits]),
        inside=joined([split.inside for split in splits]),
        lit=joined([split.lit for split in splits]),
        lamps=lamps._replace(mixing=mixing, noise=np.linalg.norm(mixing, axis=1)),
    )


def _search(split: SplitFrame, count: int | None) -> tuple[Points, MaterialLabels, FloatArray]:
    regions = regions_of(split)
    lit, edge = split.lit, regions.edge
    pool = _distinct([_fit(split, regions.labels == i, None) for i in range(regions.count)])
    if not len(pool):
        pool = _fit(split, lit, None)[None]
    pool_prices = prices(split, edge, pool)
    own, own_prices = pool, pool_prices
    logs: Points = np.empty((0, 3))
    labels = np.zeros(lit.shape, np.uint8)
    costs: FloatArray = np.empty((0, *lit.shape))
    current: FloatArray = np.where(lit, _UNEXPLAINED, 0.0)
    best: tuple[float, Points, MaterialLabels, FloatArray] | None = None
    worth = _numbers(split) * _INDEPENDENT_PX
    while len(logs) < (count or MOST_MATERIALS):
        gains = np.where(lit, np.maximum(current - pool_prices, 0.0), 0.0).sum(axis=(1, 2))
        if count is None and len(logs) and gains.max() < worth:
            break
        logs, labels, costs = _settled(np.vstack([logs, pool[int(gains.argmax())]]), split, edge)
        paid = np.take_along_axis(costs, labels[None].astype(np.intp), 0)[0]
        current = np.where(lit, paid, 0.0)
        length = _description_length(current, labels, logs, split, regions)
        if best is None or (length < best[0] and not _is_doubtful(logs, split, labels, costs)):
            best = length, logs, labels, costs
        across = _distinct(_across_seams(split, regions, labels, logs, current))
        pool, pool_prices = own, own_prices
        if len(across):
            pool = np.vstack([own, across])
            pool_prices = np.concatenate([own_prices, prices(split, edge, across)])
    if count is not None or best is None:
        return logs, labels, costs
    return best[1:]


def _is_doubtful(logs: Points, split: SplitFrame, labels: MaterialLabels, costs: FloatArray) -> bool:
    """True where the last material is small and not determined by its own normals."""
    if (labels[split.lit] == len(logs) - 1).mean() > _SMALL_SHARE:
        return False
    pixels = _pixels_of(len(logs) - 1, split, labels, costs)
    if len(pixels) < _FEWEST_PIXELS:
        return True
    fitted = fit_reflectance(pixels, split.lamps, TOLERANCE, 1.0 / _INDEPENDENT_PX, logs[-1])
    return fitted.error_deg > WORST_ERROR_DEG


def _description_length(
    paid: FloatArray, labels: MaterialLabels, logs: Points, split: SplitFrame, regions: Regions
) -> float:
    """Nats for residuals, for the seams of the label map, and for three numbers a material."""
    explained = split.lit & (paid < 0.5 * _UNEXPLAINED)
    seams = seam_information(labels, explained, logs, regions.logs, regions.variance)
    return float(paid.sum() / _INDEPENDENT_PX + seams + _numbers(split) * len(logs))


def _numbers(split: SplitFrame) -> float:
    """Nats of three numbers (schwarz1978)."""
    return 1.5 * float(np.log(max(split.lit.sum() / _INDEPENDENT_PX, 2.0)))


def _settled(
    logs: Points, split: SplitFrame, edge: FloatArray, rounds: int = 2
) -> tuple[Points, MaterialLabels, FloatArray]:
    """Alternate between labels and reflectances."""
    for _ in range(rounds):
        costs = prices(split, edge, logs)
        labels = smoothed(costs)
        logs = np.array(
            [_refitted(_pixels_of(m, split, labels, costs), split.lamps, logs[m]) for m in range(len(logs))]
        )
    costs = prices(split, edge, logs)
    return logs, smoothed(costs), costs


def _pixels_of(m: int, split: SplitFrame, labels: MaterialLabels, costs: FloatArray) -> Points:
    pixels = split.contributions[split.lit & (labels == m) & (costs[m] < 0.5 * _UNEXPLAINED)]
    if len(pixels) < _FEWEST_PIXELS:
        pixels = split.contributions[split.lit & (labels == m)]
    return np.ascontiguousarray(pixels[:: max(1, len(pixels) // _FIT_PIXELS)])


def _refitted(pixels: Points, lamps: Lamps, log: Vector3) -> Vector3:
    if len(pixels) < _FEWEST_PIXELS:
        return log
    return best_fit(pixels, lamps, TOLERANCE, log[None])[0]


# What regions propose.


def _fit(split: SplitFrame, inside: Mask, start: Vector3 | None) -> Vector3:
    pixels = split.contributions[inside]
    pixels = np.ascontiguousarray(pixels[:: max(1, len(pixels) // _PROPOSAL_PIXELS)])
    return best_fit(pixels, split.lamps, TOLERANCE, None if start is None else start[None])[0]


def _across_seams(
    split: SplitFrame, regions: Regions, labels: MaterialLabels, logs: Points, current: FloatArray
) -> list[Vector3]:
    """Reflectances of regions that are not explained, from those of their neighbours that are."""
    inside = regions.labels >= 0
    number = regions.labels[inside]
    size = np.bincount(number, minlength=regions.count)
    price = np.bincount(number, weights=current[inside], minlength=regions.count) / np.maximum(size, 1)
    votes = np.zeros((regions.count, len(logs)))
    np.add.at(votes, (number, labels[inside]), 1.0)
    material = votes.argmax(axis=1)
    proposals = []
    for (a, b), step in zip(regions.pairs, regions.steps, strict=True):
        for known, unknown, jump in ((a, b, step), (b, a, -step)):
            if price[known] < 0.5 * _UNEXPLAINED and price[unknown] > 0.1 * _UNEXPLAINED:
                start = logs[material[known]] + jump
                proposals.append(_fit(split, regions.labels == unknown, start))
    return proposals


def _distinct(proposals: Sequence[Vector3]) -> Points:
    """Return the proposals that a paint may have, of those that are alike the first."""
    kept: list[Vector3] = []
    for proposal in proposals:
        if np.ptp(proposal) < _LARGEST_RATIO and all(
            np.abs(proposal - other).max() > _SAME for other in kept
        ):
            kept.append(proposal)
    return np.array(kept).reshape(-1, 3)

"""Which material each pixel is of, where the reflectances are known.

A region's price for a material is how far its normals then are from unit length. A wrong material gives unit
length along some curve too, so that neighbours are asked as well: from one material to another log s steps by
the logarithm of the ratio of their reflectances, and within one it does not step. How exact lengths are is
learned from the frame: a knit scatters them, flat paint hardly does.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points, Vector3
from vntoolkit.geometry.camera import Camera
from vntoolkit.materials.blurred_labels import MARGIN_PX, BlurredLabels
from vntoolkit.materials.paint import Surface, without_paint
from vntoolkit.materials.pigment import pigment_of
from vntoolkit.materials.pixels import (
    INDEPENDENT_PX,
    MaterialLabels,
    PixelLabeller,
    Seams,
    Spread,
    near_seams,
)
from vntoolkit.materials.reflectance import CAP
from vntoolkit.materials.region_lengths import Lengths, lengths_of
from vntoolkit.materials.regions import SHADING_STEP, Regions, regions_of
from vntoolkit.materials.relighting import box_of, relit
from vntoolkit.materials.split_frame import CELL, SplitFrame, block_size, blocks_moved, cells_of, split_frame
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.levelling import Leveller
from vntoolkit.photometry.response import LightResponse

_STRANGERS = 0.1  # share of regions that are of no material: folds that light each other, eyes, buttons
_LEAST_SPREAD = 0.005  # of lengths: reflectances are known no better
_FIRST_SPREAD = 0.04
_SEAM_PRICE = 1.0  # of a neighbour of another material, where the reflectances are known
_SWEEPS = 12
_DOUBTFUL = 1.5  # price of a region from which its pixels are decided one by one …
_BESIDE = 4  # … and those that near to a seam
# Share of the pixels of a frame that is decided as a whole: in later frames what costs more is doubtful.
_DOUBTFUL_SHARE = 0.1
_CARRIED_SWEEPS = 2  # and one where the picture moved by a block at most
_AS_A_WHOLE = 6  # blocks that the picture moves from one frame decided as a whole to the next
_BOX_BLOCKS = 32  # that a subject moves before another part of the frame is looked at
# Two pixels with a seam between them, farther apart than its blur and its labels' errors reach.
_APART_PX = 6
_BEFORE, _AFTER = slice(None, -_APART_PX), slice(_APART_PX, None)
_PAIRS = ((np.s_[_BEFORE, :], np.s_[_AFTER, :]), (np.s_[:, _BEFORE], np.s_[:, _AFTER]))
_JUDGED = 20_000  # of each kind tell how far normals step
_MOST_STEP = (CAP * SHADING_STEP) ** 2  # square of a step of log s; longer ones hardly cost more
_STEEP = 0.5  # difference of two such normals from which a larger one hardly counts more
_LEAST_STEP = 0.02  # excess of the mean step at seams that tells something


class _Decided(NamedTuple):
    """A frame that was decided as a whole. of_blocks: labels; of_pixels: (h, w). Prices are of blocks."""

    split: SplitFrame
    of_blocks: MaterialLabels
    of_pixels: MaterialLabels
    doubtful: float
    mean_price: float

    def is_of(self, split: SplitFrame, mask: Mask) -> bool:
        """True for the same picture."""
        is_alike = self.of_pixels.shape == mask.shape and self.split.factor == split.factor
        return is_alike and np.array_equal(self.split.colours, split.colours)


class MaterialLabeller:
    """Labels frame after frame. A pixel keeps its label while that explains it as well as before.

    The first frame is decided as a whole, region by region. It also tells noise, blur, and how exact lengths
    are. After it pixels are decided again beside seams, which may have moved, and where the label no longer
    fits. A frame that the labels so found explain worse than those of the last whole decision is decided as
    a whole, too. So is a frame once the picture has moved, since the last whole decision, by some blocks:
    until then, a patch that a limb uncovers may keep a label that only just fits.

    response: with light colours. reflectances: (m, 3), relative to the calibration material. pigments:
    (m, 3), the lines of log ρ along which they change, 0 for none. camera: None for orthographic. leveller:
    makes every lamp as strong as at the centre; None where frames are so.
    """

    def __init__(
        self,
        response: LightResponse,
        reflectances: Points,
        pigments: Points | None = None,
        camera: Camera | None = None,
        leveller: Leveller | None = None,
    ) -> None:
        self._response = response
        self._pigments = pigments
        self._camera, self._leveller = camera, leveller
        self._reflectances = np.asarray(reflectances, dtype=np.float64)
        self._logs = np.log(self._reflectances)
        self._before: MaterialLabels | None = None
        self._split: SplitFrame | None = None
        self._box: tuple[slice, slice] | None = None
        self._coarse: PixelLabeller | None = None
        self._beside_seams: BlurredLabels | None = None
        self._fine: BlurredLabels | None = None
        self._like: SplitFrame | None = None  # of its blocks and noise are all frames
        self._kept: tuple[Any, ...] = (None,) * 4
        self._reference: _Decided | None = None
        self._found: MaterialLabels = np.empty((0, 0), np.uint8)
        self.turned_deg: npt.NDArray[np.float32] | None = None  # by paint that was taken out last
        self._plain: npt.NDArray[np.float32] | None = None
        self._surface: Surface | None = None
        self._cells: npt.NDArray[np.float32] | None = None  # of the frame before …
        self._decided: npt.NDArray[np.float32] | None = None  # … and of the last decided as a whole
        self._doubtful = self._mean_price = np.inf

    def keep(self) -> None:
        """Let what the first frame told of noise, blur and lengths hold after `forget`, too.

        A subject of another size takes blocks of another size. Then the next first frame tells it again.
        The frame itself, where a sequence starts with it, has the labels that it has now.
        """
        if self._fine is not None:
            self._kept = self._like, self._coarse, self._beside_seams, self._fine
        if self._before is not None and self._split is not None:
            self._reference = _Decided(
                self._split, self._before.copy(), self._found.copy(), self._doubtful, self._mean_price
            )

    def with_reflectances(self, reflectances: Points) -> MaterialLabeller:
        """Return a labeller of the same materials, whose reflectances (m, 3) were fitted again.

        What the first frame told this one of noise, blur and lengths holds for it, too, as do its labels.
        """
        other = MaterialLabeller(self._response, reflectances)
        other._like, other._reference = self._like, self._reference
        other._coarse = self._coarse and self._coarse.with_logs(other._logs)
        other._beside_seams = self._beside_seams and self._beside_seams.with_logs(other._logs)
        other._fine = self._fine and self._fine.with_logs(other._logs)
        other.keep()
        return other

    def forget(self) -> None:
        """Drop the labels of the frame before, so that a sequence may start anywhere."""
        self._before = self._split = self._box = self._cells = self._decided = self._surface = None
        self._like, self._coarse, self._beside_seams, self._fine = self._kept

    def labels(self, frame: LinearFrame, mask: Mask) -> MaterialLabels:
        """Return (h, w), numbers of the materials; 0 outside the mask. mask: (h, w)."""
        if len(self._logs) == 1 or not mask.any():
            return np.zeros(mask.shape, np.uint8)
        if self._split is None and self._like is not None and self._like.factor != block_size(mask):
            self._like = self._coarse = self._beside_seams = self._fine = None
        labels = np.zeros(mask.shape, np.uint8)
        box = self._boxed(mask)
        inside = np.ascontiguousarray(mask[box])
        if self._leveller is None:
            part = LinearFrame(rgb=frame.rgb[box], clipped=frame.clipped[box])
        else:
            part = self._leveller.part_by_strength(frame, box)
        split = split_frame(part, self._response, inside, like=self._like)
        cells = cells_of(split.colours)
        moved, since = (
            0.0 if before is None else blocks_moved(before, cells) for before in (self._cells, self._decided)
        )
        if moved > _BESIDE or since > _AS_A_WHOLE:
            self.forget()
            return self.labels(frame, mask)
        self._cells = cells
        known = self._reference
        if self._before is None and known is not None and known.is_of(split, mask):
            self._before, self._split, self._decided = known.of_blocks.copy(), split, cells
            self._doubtful, self._mean_price = known.doubtful, known.mean_price
            return known.of_pixels.copy()
        labels[box] = self._labels(part, inside, split, moved)
        self._found = labels
        return labels

    def _labels(self, frame: LinearFrame, mask: Mask, split: SplitFrame, moved: float) -> MaterialLabels:
        """`labels` of the part of a frame that holds the subject."""
        coarse = self._carried(split, moved)
        if coarse is None:
            coarse, self._decided = self._decided_anew(split), self._cells
        if coarse is None:
            self.forget()  # the next frame has nothing to go on from
            return np.zeros(mask.shape, np.uint8)
        self._before, self._split, self._like = coarse, split, self._like or split
        if split.factor == 1:
            self._fine = self._beside_seams
            return coarse * mask
        assert self._coarse is not None
        labels, near = np.empty(mask.shape, np.uint8), np.empty(mask.shape, np.bool_)
        reach = (MARGIN_PX + split.factor - 1) // split.factor
        _enlarge(coarse, near_seams(coarse, reach), mask, split.factor, labels, near)
        if self._fine is None:
            lamps = split.lamps._replace(
                mixing=split.lamps.mixing * split.factor, noise=split.lamps.noise * split.factor
            )
            self._fine = BlurredLabels(lamps, self._logs, self._coarse.spread)
        found = self._fine.followed(frame.rgb, mask, labels, near)
        _take_blocks(found, mask, split.factor, coarse)
        return found * mask

    def relit(
        self,
        frame: LinearFrame,
        labels: MaterialLabels,
        mask: Mask | None = None,
        box: tuple[slice, slice] | None = None,
    ) -> LinearFrame:
        """Return the frame as it would be with the calibration material everywhere.

        mask: (h, w), where paint is told; None for everywhere. box: see `relit`.
        """
        self.turned_deg = None
        mask, seams = np.ones(labels.shape, np.bool_) if mask is None else mask, self.seams
        if self._pigments is not None and self._pigments.any() and mask.any():
            if self._plain is None or self._plain.shape != frame.rgb.shape:
                self._plain = np.empty(frame.rgb.shape, np.float32)  # new ones would cost a frame 2 ms
            seen = frame, labels, mask, self._response, self._reflectances
            around = (slice(0, len(mask)), slice(0, mask.shape[1])) if box is None else self._boxed(mask)
            paint = self._pigments, self._camera, self._plain, around, self._surface
            frame, self.turned_deg, self._surface = without_paint(*seen, *paint)
        return relit(frame, self._response, labels, self._reflectances, seams=seams, mask=mask, box=box)

    @property
    def seams(self) -> Seams | None:
        """How pixels beside seams are mixtures; None before a frame is labelled, and for one material."""
        return None if self._fine is None else self._fine.seams

    def left_at_seams(self, frame: LinearFrame, mask: Mask, labels: MaterialLabels) -> float:
        """Return the share of the steps of normals at seams that remains, against one material all over.

        What is printed on a surface is no relief: 0 where normals step at seams as they do elsewhere, 1 as
        much as if the first material were everywhere. Materials that explain nothing, such as gloss and
        ambient light taken for paint, leave all or more.
        """
        if not labels.any():
            return 0.0
        one = MaterialLabeller(self._response, self._reflectances[:1])
        found = self.relit(frame, labels, mask, box_of(mask))
        alone = one.relit(frame, np.zeros(mask.shape, np.uint8), mask, box_of(mask))
        inside, at_seams, at_seams_alone = [], [], []
        for before, after in _PAIRS:
            both, is_seam = mask[before] & mask[after], labels[before] != labels[after]
            for seam in (False, True):
                chosen = np.flatnonzero(both & (is_seam == seam))
                chosen = chosen[:: max(1, len(chosen) // _JUDGED)]
                places = np.unravel_index(chosen, both.shape)
                steps = _steps(found, before, after, places, self._response)
                if not seam:
                    inside.append(steps)
                else:
                    at_seams.append(steps)
                    at_seams_alone.append(_steps(alone, before, after, places, self._response))
        if not sum(map(len, at_seams)) or not sum(map(len, inside)):
            return 0.0
        usual, left, most = (
            float(np.concatenate(each).mean()) for each in (inside, at_seams, at_seams_alone)
        )
        return max(left - usual, 0.0) / max(most - usual, _LEAST_STEP)

    def pigments(
        self, frame: LinearFrame, mask: Mask, labels: MaterialLabels
    ) -> list[tuple[Vector3, Vector3] | None]:
        """Return for each material the line (3,) along which it changes and log ρ, or None for no change.

        A small one shares the line of the largest that has one: skin and hair hold the same pigment.
        """
        split = split_frame(frame, self._response, mask, like=self._like)
        middle = split.factor // 2
        places = (
            np.minimum(np.arange(n) * split.factor + middle, size - 1)
            for n, size in zip(split.lit.shape, mask.shape, strict=True)
        )
        blocks = labels[np.ix_(*places)]
        plain = split.lit & ~near_seams(blocks, _BESIDE)
        chosen = [plain & (blocks == m) for m in range(len(self._logs))]
        found: list[tuple[Vector3, Vector3] | None] = [None] * len(chosen)
        contributions = split.contributions
        line: Vector3 | None = None  # of the largest material that has one
        for m in sorted(range(len(chosen)), key=lambda m: -np.count_nonzero(chosen[m])):
            pigment = pigment_of(contributions, chosen[m], self._logs[m], split.lamps, line)
            if line is None and pigment is not None:
                line = pigment[0]
            found[m] = pigment
        return found

    def _boxed(self, mask: Mask) -> tuple[slice, slice]:
        """Return rows and columns that hold the subject; what is known of the frame before moves along."""
        first, stop = np.array([(used[0], used[-1] + 1) for used in (
            np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
        )]).T  # fmt: skip
        before = self._box
        if before is not None and all(
            part.start <= a and b <= part.stop for part, a, b in zip(before, first, stop, strict=True)
        ):
            return before
        step = _BOX_BLOCKS * (block_size(mask) if self._like is None else self._like.factor)
        ends = np.minimum(-(-stop // step) * step, mask.shape)
        first = first // step * step
        self._box = slice(int(first[0]), int(ends[0])), slice(int(first[1]), int(ends[1]))
        if before is None or self._split is None or self._before is None:
            return self._box
        factor = self._split.factor
        down, right = (first - [part.start for part in before]) // factor
        shape = tuple(-((a - b) // factor) for a, b in zip(first, ends, strict=True))
        self._before = _shifted(self._before, shape, down, right)
        self._split = replace(self._split, lit=_shifted(self._split.lit, shape, down, right))
        if self._cells is not None and self._decided is not None:  # a box begins where a cell does
            of_cells = tuple(-(-n // CELL) for n in shape), down // CELL, right // CELL
            self._cells, self._decided = (_shifted(each, *of_cells) for each in (self._cells, self._decided))
        return self._box

    def _carried(self, split: SplitFrame, moved: float) -> MaterialLabels | None:
        """Return labels of blocks from those of the frame before; None where these do not explain it.

        moved: blocks that the picture moved, on average. Parts may have moved twice as far.
        """
        if (
            self._before is None
            or self._coarse is None
            or self._split is None
            or self._before.shape != split.lit.shape
        ):
            return None
        self._coarse.look_at(split.colours, split.lit)
        doubtful = self._coarse.prices(self._before) > self._doubtful
        doubtful |= ~self._split.lit
        found = self._coarse.followed(
            self._before,
            doubtful | near_seams(self._before, min(int(np.ceil(2.0 * moved)), _BESIDE)),
            doubtful,
            sweeps=_CARRIED_SWEEPS if moved > 1.0 else 1,
        )
        paid = self._coarse.prices(found).sum(dtype=np.float64)
        if paid > self._mean_price * np.count_nonzero(split.lit):
            return None
        if split.factor > 1:  # pixels are decided after blocks
            return found
        assert self._beside_seams is not None
        return self._beside_seams.followed(split.colours, split.lit, found, near_seams(found, MARGIN_PX))

    def _decided_anew(self, split: SplitFrame) -> MaterialLabels | None:
        """Return labels of blocks, from those of regions; None where no region is lit."""
        regions = regions_of(split)
        if not regions.count:
            return None
        lengths = lengths_of(regions, self._logs, split.lamps)
        if self._coarse is None:
            spread = Spread(_FIRST_SPREAD, _FIRST_SPREAD)
            for _ in range(2):
                costs = prices_of_regions(lengths, spread)
                spread = spread_of(lengths, agreed(costs, self._logs, regions, _SEAM_PRICE))
            self._coarse = PixelLabeller(split.lamps, self._logs, spread)
        costs = prices_of_regions(lengths, self._coarse.spread)
        of_regions = agreed(costs, self._logs, regions, _SEAM_PRICE)
        coarse = of_regions[regions.labels].astype(np.uint8)
        doubtful = np.take_along_axis(costs, of_regions[:, None], 1)[:, 0] > _DOUBTFUL
        active = ~regions.plain | doubtful[regions.labels] | near_seams(coarse, _BESIDE)
        self._coarse.look_at(split.colours, split.lit)
        found = self._coarse.decided(coarse, active)
        if self._beside_seams is None:
            self._beside_seams = BlurredLabels(split.lamps, self._logs, self._coarse.spread)
        found = self._beside_seams.settled(split.colours, split.lit, found)
        paid = self._coarse.prices(found)[split.lit].astype(np.float64)
        self._doubtful = float(np.quantile(paid, 1.0 - _DOUBTFUL_SHARE)) if paid.size else np.inf
        self._mean_price = float(paid.mean()) if paid.size else np.inf
        return found


def _shifted(image: npt.NDArray[Any], shape: tuple[int, ...], down: int, right: int) -> npt.NDArray[Any]:
    """Return the part of an image that begins at a row and a column, 0 where it has none."""
    out = np.zeros((*shape, *image.shape[2:]), image.dtype)
    top, left = max(-down, 0), max(-right, 0)
    part = image[max(down, 0) :, max(right, 0) :][: shape[0] - top, : shape[1] - left]
    out[top : top + part.shape[0], left : left + part.shape[1]] = part
    return out


def _steps(
    frame: LinearFrame, before: tuple[slice, ...], after: tuple[slice, ...],
    places: tuple[IntArray, ...], response: LightResponse,
) -> FloatArray:  # fmt: skip
    """(n,), squared differences of normals, 0 to 1, from one part of a frame to another at places in both.

    Those that are steep count hardly more.
    """
    normals = []
    for part in (before, after):
        scaled = (frame.rgb[part][places] - response.ambient) @ response.inverse.T
        normals.append(scaled / np.maximum(np.linalg.norm(scaled, axis=1, keepdims=True), 1e-9))
    squared = ((normals[0] - normals[1]) ** 2).sum(axis=1)
    return np.asarray(squared / (squared + _STEEP**2))


@njit(cache=True, parallel=True)
def _enlarge(coarse: Any, near: Any, mask: Any, factor: int, labels: Any, active: Any) -> None:
    h, w = mask.shape
    for row in prange(len(coarse)):
        label, is_near = np.empty(w, np.uint8), np.empty(w, np.bool_)
        for u in range(w):
            label[u], is_near[u] = coarse[row, u // factor], near[row, u // factor]
        for v in range(row * factor, min((row + 1) * factor, h)):
            for u in range(w):
                labels[v, u] = label[u] * mask[v, u]
            for u in range(w):
                active[v, u] = mask[v, u] & is_near[u]


def _take_blocks(labels: MaterialLabels, mask: Mask, factor: int, coarse: MaterialLabels) -> None:
    """Give each block the label of the pixel in its middle, where there is one."""
    middle = np.s_[factor // 2 :: factor, factor // 2 :: factor]
    found, inside = labels[middle], mask[middle]
    np.copyto(coarse[: found.shape[0], : found.shape[1]], found, where=inside)


# Labels of regions.


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
    between = (1.4826 * np.median(np.abs(error))) ** 2 - np.median(noise / lengths.counts[:, 0])
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
    weights = regions.sizes / INDEPENDENT_PX
    edges = regions.starts, regions.neighbours, regions.steps, regions.contacts
    labels = costs.argmin(axis=1) if start is None else start.astype(np.int64)
    _agree(costs, weights, labels, logs, *edges, seam, _SWEEPS)
    return labels


def total_cost(costs: FloatArray, labels: IntArray, logs: Points, regions: Regions, seam: float) -> float:
    """Nats of prices (n, m) and of steps between neighbours, under labels (n,)."""
    return float(
        _total(
            costs, regions.sizes / INDEPENDENT_PX, labels, logs, regions.starts, regions.neighbours,
            regions.steps, regions.contacts, seam,
        )
    )  # fmt: skip


@njit(cache=True, inline="always")
def step_cost(step: Any, one: Any, other: Any, seam: float) -> float:
    """Price of a step of log s from a material to another: how badly their ratio explains it."""
    t = 0.0
    for k in range(3):
        rest = step[k] - other[k] + one[k]
        t += rest * rest
    return 0.5 * CAP * CAP * t / (_MOST_STEP + t) + seam


@njit(cache=True, inline="always", error_model="numpy")
def _add_steps(edge: int, steps: Any, contacts: Any, logs: Any, of: int, seam: float, out: Any) -> None:
    """Add to out (m,) the price of an edge to a neighbour of one label, for each label here. logs: (3, m)."""
    d0, d1, d2 = steps[edge, 0] - logs[0, of], steps[edge, 1] - logs[1, of], steps[edge, 2] - logs[2, of]
    for m in range(len(out)):
        r0, r1, r2 = d0 + logs[0, m], d1 + logs[1, m], d2 + logs[2, m]
        t = r0 * r0 + r1 * r1 + r2 * r2
        out[m] += contacts[edge] * (0.5 * CAP * CAP * t / (_MOST_STEP + t) + (0.0 if m == of else seam))


@njit(cache=True, error_model="numpy")
def _agree(
    costs: Any, weights: Any, labels: Any, logs: Any, starts: Any, neighbours: Any, steps: Any, contacts: Any,
    seam: float, sweeps: int,
) -> None:  # fmt: skip
    """Give each region its label of least cost, again as long as one beside it changed."""
    n, count = costs.shape
    across, total, waits = np.ascontiguousarray(logs.T), np.empty(count), np.ones(n, np.bool_)
    for _ in range(sweeps):
        changed = False
        for i in range(n):
            if not waits[i]:
                continue
            waits[i] = False
            for m in range(count):
                total[m] = weights[i] * costs[i, m]
            for e in range(starts[i], starts[i + 1]):
                _add_steps(e, steps, contacts, across, labels[neighbours[e]], seam, total)
            best = total.argmin()
            if total[best] < total[labels[i]] - 1e-9:
                labels[i] = best
                changed = True
                for e in range(starts[i], starts[i + 1]):
                    waits[neighbours[e]] = True
        if not changed:
            break


@njit(cache=True, error_model="numpy")
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
                total += contacts[e] * step_cost(steps[e], logs[a], logs[b], 0.0 if a == b else seam)
    return total

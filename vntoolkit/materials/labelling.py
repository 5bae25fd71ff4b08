"""The material of every pixel, frame after frame, where the reflectances are known.

The first frame is decided as a whole: region by region (`region_labels`), then by blocks and pixels under the
picture's blur (`label_moves`). It also tells noise, blur, and how exact lengths
are. After it blocks are decided again beside seams, which may have moved, and where the label no longer fits.
A frame that the labels so found explain worse than those of the last whole decision is decided as a whole,
too. So is a frame once the picture has moved by some blocks: until then, a patch that a limb uncovers may
keep a label that only just fits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import Float32Array, Mask, MaterialLabels, Points, Vector3
from vntoolkit.geometry.camera import Camera
from vntoolkit.materials.label_moves import MARGIN_PX, LabelEnergy, labels_and_energy
from vntoolkit.materials.mixtures import FIRST_SPREAD, SEAM_PRICE, Seams, Spread, near_seams
from vntoolkit.materials.paint import PaintSurface, without_paint
from vntoolkit.materials.pigment import pigment_of
from vntoolkit.materials.reflectance import Lamps
from vntoolkit.materials.region_labels import DOUBTFUL, agreed, prices_of_regions, spread_of
from vntoolkit.materials.region_lengths import Lengths, lengths_of
from vntoolkit.materials.regions import Regions, regions_of
from vntoolkit.materials.relighting import relit
from vntoolkit.materials.split_frame import (
    SplitFrame,
    block_size,
    blocks_moved,
    cells_of,
    split_frame,
    steady_box,
)
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.levelling import Leveller
from vntoolkit.photometry.response import LightResponse

_BESIDE = 4  # blocks to a seam: those that near are decided one by one
# Share of the blocks of a frame that is decided as a whole: in later frames what costs more is doubtful.
_DOUBTFUL_SHARE = 0.1
_AS_A_WHOLE = 6  # blocks that the picture moves from one frame decided as a whole to the next


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameStatistics:
    """What one frame tells of noise, blur, and how exact lengths are, for all whose blocks are as large.

    factor, lamps: as of `SplitFrame`. of_blocks, seams: what tells the mixtures of blocks, and of pixels.
    """

    factor: int
    lamps: Lamps
    spread: Spread
    of_blocks: Seams
    seams: Seams


@dataclass(frozen=True, kw_only=True, eq=False)
class _Before:
    """The frame before. labels, lit: (h, w), of blocks. box: the part of the frame that they cover.

    cells: what movement is measured on, of this frame, and whole: of the last one decided as a whole.
    doubtful: price of a block from which it is decided anew. mean_price: of the blocks.
    """

    labels: MaterialLabels
    lit: Mask
    box: tuple[slice, slice]
    cells: Float32Array
    whole: Float32Array
    doubtful: float
    mean_price: float


@dataclass(frozen=True, kw_only=True, eq=False)
class LabelState:
    """What a frame hands to the next. statistics: of the first frame. surface: where paint is told."""

    statistics: FrameStatistics | None = None
    before: _Before | None = None
    surface: PaintSurface | None = None

    @property
    def seams(self) -> Seams | None:
        """How pixels beside seams are mixtures; None before a frame is labelled, and for one material."""
        return None if self.statistics is None else self.statistics.seams


@dataclass(frozen=True, kw_only=True, eq=False)
class MaterialLabeller:
    """Labels frames by materials that are known.

    response: with light colours. reflectances: (m, 3), relative to the calibration material. pigments:
    (m, 3), the lines of log ρ along which they change, 0 for none. camera: None for orthographic. leveller:
    makes every lamp as strong as at the centre; None where frames are so.
    """

    response: LightResponse
    reflectances: Points
    pigments: Points | None = None
    camera: Camera | None = None
    leveller: Leveller | None = None

    def labels(self, frame: LinearFrame, mask: Mask, state: LabelState) -> tuple[MaterialLabels, LabelState]:
        """Return (h, w), numbers of the materials, 0 outside the mask; and the state for the next frame."""
        labels = np.zeros(mask.shape, np.uint8)
        if len(self.reflectances) == 1 or not mask.any():
            return labels, state
        first, before = state.statistics, state.before
        if before is None and first is not None and first.factor != block_size(mask):
            first = None
        factor = block_size(mask) if first is None else first.factor
        box = steady_box(mask, factor, None if before is None else before.box)
        inside = np.ascontiguousarray(mask[box])
        if self.leveller is None:
            part = LinearFrame(rgb=frame.rgb[box], clipped=frame.clipped[box])
        else:
            part = self.leveller.part_by_strength(frame, box)
        split = split_frame(
            part, self.response, inside, like=None if first is None else (first.factor, first.lamps)
        )
        cells, coarse = cells_of(split.colours), None
        if first is not None and before is not None and before.box == box:
            coarse = self._carried(split, cells, first, before)
        if coarse is None:
            coarse, first, before = self._decided(split, first, box, cells)
        if coarse is None or first is None or before is None:
            return labels, replace(state, before=None)
        found, first = self._of_pixels(part, inside, split, coarse, first)
        labels[box] = found * inside
        _take_blocks(labels[box], inside, split.factor, coarse)
        before = replace(before, labels=coarse, lit=split.lit, cells=cells)
        return labels, replace(state, statistics=first, before=before)

    def _of_pixels(
        self,
        part: LinearFrame,
        inside: Mask,
        split: SplitFrame,
        coarse: MaterialLabels,
        first: FrameStatistics,
    ) -> tuple[MaterialLabels, FrameStatistics]:
        """Return labels of pixels from those of blocks, and the statistics with the seams of pixels."""
        if split.factor == 1:
            return coarse, replace(first, seams=first.of_blocks)
        side, (h, w) = split.factor, inside.shape
        labels = np.ascontiguousarray(coarse.repeat(side, 0).repeat(side, 1)[:h, :w])
        near = near_seams(labels, MARGIN_PX + side - 1)
        lamps = first.lamps._replace(mixing=first.lamps.mixing * side, noise=first.lamps.noise * side)
        known = lamps, self.reflectances, first.spread
        if first.seams is not first.of_blocks:
            return LabelEnergy.of(part.rgb, inside, *known, first.seams).followed(labels, near), first
        found, energy = labels_and_energy(part.rgb, inside, labels, *known, near, near)
        return found, replace(first, seams=energy.seams)

    def _carried(
        self, split: SplitFrame, cells: Float32Array, first: FrameStatistics, before: _Before
    ) -> MaterialLabels | None:
        """Return labels of blocks from those of the frame before; None where these do not explain it."""
        blocks = blocks_moved(before.cells, cells)
        if blocks > _BESIDE or blocks_moved(before.whole, cells) > _AS_A_WHOLE:
            return None
        energy = LabelEnergy.of(
            split.colours, split.lit, first.lamps, self.reflectances, first.spread, first.of_blocks
        )  # fmt: skip
        doubtful = (energy.prices(before.labels) > before.doubtful) | (split.lit & ~before.lit)
        reach = min(int(np.ceil(2.0 * blocks)), _BESIDE)  # parts may have moved twice as far
        found = energy.decided(before.labels, doubtful | near_seams(before.labels, reach))
        if energy.prices(found).sum() > before.mean_price * np.count_nonzero(split.lit):
            return None
        return found

    def _decided(
        self,
        split: SplitFrame,
        first: FrameStatistics | None,
        box: tuple[slice, slice],
        cells: Float32Array,
    ) -> tuple[MaterialLabels | None, FrameStatistics | None, _Before | None]:
        """Return labels of blocks, from those of regions; None where no region is lit."""
        regions, logs = regions_of(split), np.log(self.reflectances)
        if not regions.count:
            return None, first, None
        lengths = lengths_of(regions, logs, split.lamps)
        spread = _spread(lengths, logs, regions) if first is None else first.spread
        costs = prices_of_regions(lengths, spread)
        of_regions = agreed(costs, logs, regions, SEAM_PRICE)
        found = of_regions[regions.labels].astype(np.uint8)
        doubtful = np.take_along_axis(costs, of_regions[:, None], 1)[:, 0] > DOUBTFUL
        active = ~regions.plain | doubtful[regions.labels] | near_seams(found, _BESIDE)
        known = split.lamps, self.reflectances, spread
        if first is None:
            found, energy = labels_and_energy(split.colours, split.lit, found, *known, active)
            first = FrameStatistics(
                factor=split.factor,
                lamps=split.lamps,
                spread=spread,
                of_blocks=energy.seams,
                seams=energy.seams,
            )
        else:
            energy = LabelEnergy.of(split.colours, split.lit, *known, first.of_blocks)
            found = energy.decided(found, active)
        paid = energy.prices(found)[split.lit]
        before = _Before(
            labels=found, lit=split.lit, box=box, cells=cells, whole=cells,
            doubtful=float(np.quantile(paid, 1.0 - _DOUBTFUL_SHARE)), mean_price=float(paid.mean()),
        )  # fmt: skip
        return found, first, before

    def relit(
        self,
        frame: LinearFrame,
        labels: MaterialLabels,
        state: LabelState,
        mask: Mask | None = None,
        box: tuple[slice, slice] | None = None,
    ) -> tuple[LinearFrame, Float32Array | None, LabelState]:
        """Return the frame as it would be with the calibration material everywhere.

        And (h, w), by how many degrees paint that was taken out turned normals, None for none; and the state
        for the next frame. mask: (h, w), where paint is told; None for everywhere. box: see `relit`.
        """
        mask, turned_deg = np.ones(labels.shape, np.bool_) if mask is None else mask, None
        if self.pigments is not None and self.pigments.any() and mask.any():
            frame, turned_deg, surface = without_paint(
                frame, labels, mask, self.response, self.reflectances, self.pigments, self.camera,
                state.surface,
            )  # fmt: skip
            state = replace(state, surface=surface)
        known = frame, self.response, labels, self.reflectances
        return relit(*known, seams=state.seams, mask=mask, box=box), turned_deg, state

    def pigments_of(
        self, frame: LinearFrame, mask: Mask, labels: MaterialLabels, state: LabelState
    ) -> list[tuple[Vector3, Vector3] | None]:
        """Return for each material the line (3,) along which it changes and log ρ, or None for no change.

        A small one shares the line of the largest that has one: skin and hair hold the same pigment.
        """
        first = state.statistics
        like = None if first is None else (first.factor, first.lamps)
        split, logs = split_frame(frame, self.response, mask, like=like), np.log(self.reflectances)
        middle = split.factor // 2
        places = (
            np.minimum(np.arange(n) * split.factor + middle, size - 1)
            for n, size in zip(split.lit.shape, mask.shape, strict=True)
        )
        blocks = labels[np.ix_(*places)]
        plain = split.lit & ~near_seams(blocks, _BESIDE)
        chosen = [plain & (blocks == m) for m in range(len(logs))]
        found: list[tuple[Vector3, Vector3] | None] = [None] * len(chosen)
        line: Vector3 | None = None  # of the largest material that has one
        for m in sorted(range(len(chosen)), key=lambda m: -np.count_nonzero(chosen[m])):
            pigment = pigment_of(split.contributions, chosen[m], logs[m], split.lamps, line)
            if line is None and pigment is not None:
                line = pigment[0]
            found[m] = pigment
        return found


def _spread(lengths: Lengths, logs: Points, regions: Regions) -> Spread:
    """Return the spread of the lengths of regions under the labels that they then agree on."""
    spread = Spread(FIRST_SPREAD, FIRST_SPREAD)
    for _ in range(2):
        costs = prices_of_regions(lengths, spread)
        spread = spread_of(lengths, agreed(costs, logs, regions, SEAM_PRICE))
    return spread


def _take_blocks(labels: MaterialLabels, mask: Mask, factor: int, coarse: MaterialLabels) -> None:
    """Give each block the label of the pixel in its middle, where there is one."""
    middle = np.s_[factor // 2 :: factor, factor // 2 :: factor]
    found, inside = labels[middle], mask[middle]
    np.copyto(coarse[: found.shape[0], : found.shape[1]], found, where=inside)

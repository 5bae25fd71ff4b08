"""What a frame tells about where the template is, with the information that it really has.

The frame's slopes, pulled back into the template (`bands`), are compared with the template's, band by band:
what is left of them after a Gaussian is taken off three times, at full resolution and at halvings. A fine
band is relief that sits on the surface. A coarse one is its shape, which may bend: its residual then is
large, and it tells little. Beside an occluding contour slopes grow without bound, on a smooth surface too.
What a band finds there stays with the contour while the surface turns beneath it. The finest band is not
compared there. The others are, and how far the surface may have slid enters the expected error. Paint
(`paint`) is compared in the same way, as a measurement of its own: in all bands it stays in place. The finest
bands are also compared with what earlier frames have shown (`remembered`).

Template f and frame g differ by noise and by the displacement d: g − f = F d + noise. Over a window, with
F = ½(∇f + ∇g), the moments b = −Σ Fᵀ(g − f), H = Σ FᵀF and A = Σ ∇fᵀ∇g give d = A⁻¹ b. A is made of what both
have in common: noise is not, and raises H alone. Where A is no larger than chance makes it, nothing is told.
Nor does A count as far as it goes with curl that both have in common: a surface's slopes have none. What a
mosaic makes of strands finer than its pixels has, is alike in both, and wanders along the strands. Nor does
what a turn of the surface in place changes as much as a shift does: it is taken off F in A, H and b
(`turns`).
Else, along an eigenvector of A, d has the variance S / A², with S = Σ s² over the nodes of the window, s what
the pixels of one still pull by at d (the sandwich of `white1980`, clustered): it counts noise, and whatever
moves otherwise than the rest. White noise alone, of the residual's σ², makes S = σ² H, the least it can be.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.tracking.bands import LEAST_NOISE, RIM_PX, Band, TemplateRaster, curl_of
from vntoolkit.tracking.guess_errors import GuessErrors
from vntoolkit.tracking.lattice import NODES_BY_PASS, TemplateLattice
from vntoolkit.tracking.paint import PaintImage
from vntoolkit.tracking.remembered import Finest, Remembered, remembered_template, what_exceeds
from vntoolkit.tracking.slopes import Relief
from vntoolkit.tracking.template import TrackingTemplate
from vntoolkit.tracking.turns import explained_by_turns

_CHANCE = 2.5  # standard deviations of A without a common signal, below which nothing is told
_CORRELATED_PX = 12.0  # pixels that agree by chance count as one, by H: so measured on white noise
_APART_PX = 12  # of the band: noise so far apart has nothing in common, nor that of a codec's blocks
_WHITE_SQUARE = 1.9  # pixels × squared correlation of curl so far apart, of white noise; measured
_MOSTLY = 0.5  # share of noise from which its curl is asked: fine relief that is sampled has some, too
_FEWEST_WINDOWS = 8  # that do not overlap, to tell it
_MEDIAN_SQUARE = 0.455  # median of a squared normal variate
_LONGEST_STEP_PX = 2.0  # in pixels of the band: about what one linearisation reaches
_REACH_PX, _SEARCH_STEP_PX = 16, 2  # of the search for what is lost
_PATCH_CELLS = 4  # side of the squares that it shifts
_SURE = 5.0  # standard deviations of a correlation by chance: there are some 300 shifts
_KNOWN_PX = 4.0  # error by the finest relief around, at which half of the slide remains possible
_PATTERN_PX = 2.0  # of the band, and of motion: a fixed pattern has nothing in common with itself farther off
_PATTERN_VARIES = 2.0  # power of it in a window over that in the windows around, at most
_FEW_NODES = 4.0  # variance of a step over that of its nodes' pulls: two by two nodes err alike


class Windows(NamedTuple):
    """How displacements are looked for in one band.

    halvings: of the resolution. passes: of lattice smoothing that make the window; under narrower ones errors
    of a cell's size feed themselves. accuracy_px: of a window at best; relief stays in place, folds travel.
    """

    halvings: int
    passes: int
    accuracy_px: float

    @property
    def nodes(self) -> float:
        """How many nodes' worth of pixels the window around each holds."""
        return NODES_BY_PASS * self.passes


_RELIEF = Windows(0, 2, 0.1)
_WIDE_RELIEF = Windows(0, 6, 0.3)  # against what is remembered, where the narrow ones tell less
_FAINT_RELIEF = Windows(1, 24, 0.3)  # under noise, so that chance is small; where the first tells nothing
_WINDOWS = (_RELIEF, _FAINT_RELIEF, Windows(1, 5, 0.9), Windows(2, 8, 5.4))
_PAINT = (Windows(0, 2, 0.1), Windows(1, 5, 0.3), Windows(2, 8, 0.9))


@dataclass(frozen=True, kw_only=True, eq=False)
class WindowSteps:
    """What windows of one kind measured around the nodes.

    information: (nodes, 3) I of the share of its window that is a node's own, in 1/px² of the template. pull:
    (nodes, 2) I d. slide_px: (nodes,) how far the surface may have slid under what was measured beside
    contours.
    """

    information: npt.NDArray[np.float64]
    pull: npt.NDArray[np.float64]
    slide_px: npt.NDArray[np.float64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurement:
    """information: (nodes, 3) I_uu, I_uv, I_vv in 1/px² of the template. pull: (nodes, 2) I d.

    match: (nodes,) the share of the finest gradients that template and frame have in common and no turn
    explains, 0 to 1, of relief or of paint, the larger: where one matches, the other looks otherwise for some
    other reason.
    expected: (nodes,) the share of relief if only noise told them apart. found: (nodes,) the greatest share
    of any windows. windows: what those of each kind measured, and last what is remembered
    adds. finest: what the finest bands tell. correlated_px: for each kind of windows on relief, (nodes,) how
    many pixels agree by chance.
    """

    information: npt.NDArray[np.float64]
    pull: npt.NDArray[np.float64]
    match: npt.NDArray[np.float64]
    expected: npt.NDArray[np.float64]
    found: npt.NDArray[np.float64]
    windows: tuple[WindowSteps, ...]
    finest: Finest
    correlated_px: tuple[npt.NDArray[np.float64], ...]

    def where(self, chosen: Mask, other: Measurement) -> Measurement:
        """Return this with what the other measured at the chosen nodes (nodes,)."""

        def mixed(first: FloatArray, second: FloatArray) -> npt.NDArray[np.float64]:
            return np.where(chosen if first.ndim == 1 else chosen[:, None], second, first)

        names = ("information", "pull", "match", "expected", "found")
        parts = {name: mixed(getattr(self, name), getattr(other, name)) for name in names}
        windows = tuple(
            WindowSteps(
                information=mixed(own.information, new.information),
                pull=mixed(own.pull, new.pull),
                slide_px=mixed(own.slide_px, new.slide_px),
            )
            for own, new in zip(self.windows, other.windows, strict=True)
        )
        finest = Finest(
            other.finest.bands,
            *(mixed(*pair) for pair in zip(self.finest[1:], other.finest[1:], strict=True)),
        )
        return Measurement(**parts, windows=windows, finest=finest, correlated_px=other.correlated_px)


class TemplateRegistration:
    """Measures the displacement of one template in any frame."""

    def __init__(
        self,
        template: TrackingTemplate,
        lattice: TemplateLattice,
        camera: Camera,
        relief: Relief,
        pattern: Sequence[FloatArray] = (),
        paint: PaintImage | None = None,
        paint_pattern: Sequence[FloatArray] = (),
    ) -> None:
        """Prepare the template's bands; relief, paint: of its frame. Patterns: by `fixed_pattern`."""
        self._lattice = lattice
        self._raster = TemplateRaster(template, lattice)
        patches = lattice.cells // _PATCH_CELLS
        self._size = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        self._patch = np.unique(patches, axis=0, return_inverse=True)[1].ravel()
        identity = np.tile([1.0, 0.0, 0.0, 1.0], (lattice.count, 1))
        self._bands = self._raster.relief(template.positions_px, identity, relief)
        passes = [
            min(windows.passes for windows in self._relief_windows if windows.halvings == halvings)
            for halvings in range(len(self._bands))
        ]
        self._turns = explained_by_turns(
            self._raster, lattice, self._bands, passes, template.points_px(camera), relief
        )
        self._noise = [self._noise_share(windows) for windows in self._relief_windows]
        self._paint_bands = [] if paint is None else self._raster.paint(template.positions_px, paint, relief)
        self._pixels = template.positions_px
        self._pattern = [self._at_nodes(power, k) for k, power in enumerate(pattern)]
        self._paint_pattern = [self._at_nodes(power, k) for k, power in enumerate(paint_pattern)]

    def measure(
        self,
        positions_px: Points2,
        jacobians: FloatArray,
        relief: Relief,
        paint: PaintImage | None = None,
        near: Measurement | None = None,
        remembered: Remembered | None = None,
    ) -> Measurement:
        """Measure in the frame with this relief and paint, by the template and by what is remembered of it.

        jacobians: (nodes, 4) ∂u/∂x, ∂u/∂y, ∂v/∂x, ∂v/∂y of positions (n, 2) by the template's pixels. near: a
        measurement a step away in the same frame, whose noise is the same.
        """
        count = self._lattice.count
        frame = self._raster.relief(positions_px, jacobians, relief)
        moments = [_moments_of(*each, count) for each in zip(self._bands, frame, self._turns, strict=True)]
        moved_px = self._lattice.sums(np.hypot(*(positions_px - self._pixels).T)[:, None])[:, 0] / self._size
        correlated_px = (
            tuple(
                self._correlated(*each, frame) for each in zip(self._relief_windows, self._noise, strict=True)
            )
            if near is None
            else near.correlated_px
        )
        steps: list[WindowSteps] = []
        ratios = []
        for windows, alike_px in zip(self._relief_windows, correlated_px, strict=True):
            own = self._with_pattern(moments[windows.halvings], windows.halvings, moved_px, self._pattern)
            of_band, ratio = self._window_steps(own, windows, alike_px)
            if windows is _FAINT_RELIEF:
                elsewhere = ~steps[0].information.any(axis=1, keepdims=True)
                of_band = replace(
                    of_band, information=elsewhere * of_band.information, pull=elsewhere * of_band.pull
                )
            steps.append(of_band)
            ratios.append(ratio)
        painted = []
        if self._paint_bands:
            theirs = self._raster.paint(positions_px, paint, relief)
            moments = [
                _moments_of(*each, None, count) for each in zip(self._paint_bands, theirs, strict=True)
            ]
            alike = {w.halvings: float(px.max()) for w, px in zip(_WINDOWS, correlated_px, strict=False)}
            for windows in self._paint_windows:
                own = moments[windows.halvings]
                own = self._with_pattern(own, windows.halvings, moved_px, self._paint_pattern)
                of_band, ratio = self._window_steps(own, windows, np.full(count, alike[windows.halvings]))
                painted.append(of_band)
                ratios.append(ratio)
        seen = (frame, theirs) if self._paint_bands else (frame,)
        alone = self._finest([steps[0], *painted[:1]], tuple(bands[0] for bands in seen))
        finest = alone
        if remembered is not None:
            finest = self._with_remembered(alone, remembered, positions_px, correlated_px[0])
        unknown = self._unknown_around(finest.information)
        for k, windows in enumerate(self._relief_windows[1:], 1):
            beside = self._beside_contours(windows.halvings, frame)
            slide_px = RIM_PX * 2.0**windows.halvings * unknown * beside
            steps[k] = replace(steps[k], slide_px=slide_px)
        coarser = steps[1:] + painted[1:]
        pull = finest.pull - alone.pull
        steps += [*painted, WindowSteps(information=finest.more, pull=pull, slide_px=np.zeros(count))]
        return Measurement(
            information=finest.information + sum(each.information for each in coarser),
            pull=finest.pull + sum(each.pull for each in coarser),
            match=np.max(ratios[:: len(self._relief_windows)], axis=0),  # the finest of relief, and of paint
            expected=self._expected_match(correlated_px[0]),
            found=np.max(ratios, axis=0),
            windows=tuple(steps),
            finest=finest,
            correlated_px=correlated_px,
        )

    def remembered(self, errors: GuessErrors) -> Remembered:
        """Return what is remembered before any frame was seen; errors: of guesses of the lattice's links."""
        paint = self._paint_bands[:1]
        return remembered_template((self._bands[0], *paint), self._nodes(self._pixels), errors)

    def mixed_in(self, remembered: Remembered, measurement: Measurement, positions_px: Points2) -> Remembered:
        """Return what is remembered after a frame that was measured at positions (n, 2)."""
        return remembered.with_frame(measurement.finest, self._nodes(positions_px))

    def _finest(self, steps: list[WindowSteps], bands: tuple[Band, ...]) -> Finest:
        information = np.sum([each.information for each in steps], axis=0)
        nothing = np.zeros_like(information)
        pull = np.sum([each.pull for each in steps], axis=0)
        return Finest(bands=bands, information=information, pull=pull, against=nothing, more=nothing)

    def _with_remembered(
        self, finest: Finest, remembered: Remembered, positions_px: Points2, correlated_px: FloatArray
    ) -> Finest:
        """Compare the finest bands with what is remembered, too; a fixed pattern is in both."""
        moved_px = np.hypot(*(self._nodes(positions_px) - remembered.nodes_px).T)
        alike = (correlated_px, np.full(len(correlated_px), float(correlated_px.max())))
        patterns, turns = (self._pattern, self._paint_pattern), (self._turns[0], None)
        own = [
            self._with_pattern(_moments_of(*pair, turns[k], self._lattice.count), 0, moved_px, patterns[k])
            for k, pair in enumerate(zip(remembered.bands(self._raster.node), finest.bands, strict=True))
        ]
        narrow, wide = (
            self._finest(
                [self._window_steps(each, windows, alike[k])[0] for k, each in enumerate(own)], finest.bands
            )
            for windows in (_RELIEF, _WIDE_RELIEF)
        )
        against, against_pull = what_exceeds(narrow.information, wide.information, wide.pull)
        against, against_pull = against + narrow.information, against_pull + narrow.pull
        more, pull = remembered.beyond(finest.information, against, against_pull)
        return Finest(
            bands=finest.bands,
            information=finest.information + more,
            pull=finest.pull + pull,
            against=against,
            more=more,
        )

    def _nodes(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """(nodes, 2) means of positions (n, 2)."""
        return self._lattice.sums(positions_px) / self._size[:, None]

    def _window_steps(
        self, own: FloatArray, windows: Windows, correlated_px: FloatArray
    ) -> tuple[WindowSteps, npt.NDArray[np.float64]]:
        """What windows measure of nodes' own moments; (nodes,) the share that gradients have in common."""
        whole = 3.0**windows.passes  # of the weights of a window
        terms = self._lattice.smoothed(own, windows.passes) / whole
        step, ratio, sure, axis = _steps(terms, 2.0**windows.halvings, windows.nodes, correlated_px)
        spread = self._lattice.smoothed(_scores(own, step), windows.passes) / whole
        information = _informed(own, terms, spread, sure, axis, windows.nodes, windows.accuracy_px)
        pull = np.einsum("nij,nj->ni", _symmetric(information), step)
        return WindowSteps(information=information, pull=pull, slide_px=np.zeros(len(information))), ratio

    def _at_nodes(self, power: FloatArray, halvings: int) -> npt.NDArray[np.float64]:
        """(nodes,) mean of an image of a band over each node's pixels of the template."""
        node = self._bands[halvings].node if halvings < len(self._bands) else self._raster.node[:0]
        rows, columns = np.nonzero(node >= 0)
        low = self._raster.origin_px
        at = np.minimum(rows + (low[1] >> halvings), power.shape[0] - 1)
        beside = np.minimum(columns + (low[0] >> halvings), power.shape[1] - 1)
        count, own = self._lattice.count, node[rows, columns]
        total = np.bincount(own, power[at, beside], count)
        return np.asarray(total / np.maximum(np.bincount(own, minlength=count), 1))

    def _with_pattern(
        self,
        moments: npt.NDArray[np.float64],
        halvings: int,
        moved_px: FloatArray,
        pattern: Sequence[FloatArray],
    ) -> npt.NDArray[np.float64]:
        """Moments and, last, what a fixed pattern adds to A along either axis where the mesh stands still."""
        if halvings >= len(pattern):
            return np.column_stack([moments, np.zeros(len(moments))])
        still = np.exp(-0.5 * (moved_px / (_PATTERN_PX * 2.0**halvings)) ** 2)
        return np.column_stack([moments, _PATTERN_VARIES * still * pattern[halvings] * moments[:, 9]])

    def _beside_contours(self, halvings: int, frame: list[Band]) -> npt.NDArray[np.float64]:
        """(nodes,) share of a node's pixels within reach of a contour, in the template or in the frame."""
        mine, count = self._bands[halvings], self._lattice.count
        inside = (mine.node >= 0) & (mine.weight > 0)
        beside = (mine.beside | frame[halvings].beside)[inside]
        node = mine.node[inside]
        return np.bincount(node, beside, count) / np.maximum(np.bincount(node, minlength=count), 1)

    def _unknown_around(self, relief: FloatArray) -> npt.NDArray[np.float64]:
        """(nodes,) how little finest relief around tells, by its information (nodes, 3): 1 for nothing."""
        share = _FAINT_RELIEF.nodes / 3.0**_FAINT_RELIEF.passes
        a, b, c = share * self._lattice.smoothed(relief, _FAINT_RELIEF.passes).T
        least = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
        return np.asarray(1.0 / (1.0 + _KNOWN_PX**2 * least))

    def searched(self, measurement: Measurement, lost: Mask) -> tuple[npt.NDArray[np.float64], Mask]:
        """Return the shift (nodes, 2) at which relief that is lost correlates best, and where it surely does.

        lost: (nodes,). Pixels of the template, up to the reach of the search either way.
        """
        mine, frame, patch = self._bands[0], measurement.finest.bands[0], self._patch
        along = np.arange(-_REACH_PX, _REACH_PX + 1, _SEARCH_STEP_PX)
        shifts = np.stack(np.meshgrid(along, along), axis=-1).reshape(-1, 2)
        sums = np.zeros((int(patch.max()) + 1, len(shifts), 4))
        _correlations(
            mine.node, lost, patch, mine.features, mine.weight, frame.features, frame.weight, shifts, sums
        )
        product, first, second, pixels = np.moveaxis(sums, 2, 0)
        share = product / np.sqrt(np.maximum(first * second, 1e-30))
        alike_px = (np.bincount(patch, measurement.correlated_px[0]) / np.bincount(patch))[:, None]
        share -= _SURE * np.sqrt(alike_px / (2.0 * np.maximum(pixels, 1.0)))
        best = np.argmax(share, axis=1)
        sure = lost & (share[np.arange(len(best)), best] > 0)[patch]
        return shifts[best][patch].astype(np.float64), sure

    @property
    def windows(self) -> list[Windows]:
        """The kinds of windows, of relief and of paint, that the template is large enough for."""
        return self._relief_windows + self._paint_windows

    @property
    def _relief_windows(self) -> list[Windows]:
        return [windows for windows in _WINDOWS if windows.halvings < len(self._bands)]

    @property
    def _paint_windows(self) -> list[Windows]:
        return [windows for windows in _PAINT if windows.halvings < len(self._paint_bands)]

    def _expected_match(self, correlated_px: FloatArray) -> npt.NDArray[np.float64]:
        """Return (nodes,) the share of gradients in common if only noise told template and frame apart.

        Noise is known the less well the more of its pixels agree by chance, beyond those of white noise.
        """
        pixels = self._lattice.smoothed(self._size[:, None].astype(np.float64), _RELIEF.passes)[:, 0]
        pixels *= _RELIEF.nodes / 3.0**_RELIEF.passes
        unsure = _CHANCE * np.sqrt((correlated_px - _CORRELATED_PX) / (2.0 * np.maximum(pixels, 1.0)))
        return np.asarray(np.maximum(0.0, 1.0 - (1.0 + unsure) * self._noise[0]))

    def _noise_share(self, windows: Windows) -> npt.NDArray[np.float64]:
        """Return (nodes,) the share of the template's gradients in a band, over windows, that is noise.

        Slopes of a surface have no curl. Noise of both slopes has half of its gradients' power in it.
        """
        band, count = self._bands[windows.halvings], self._lattice.count
        inside = band.node >= 0
        node, weight = band.node[inside], band.weight[inside]
        squares = (2.0 * np.square(curl_of(band)), np.square(band.gradients).sum(axis=-1))
        own = [np.bincount(node, weight * square[inside], count) for square in squares]
        noise, power = self._lattice.smoothed(np.stack(own, axis=1), windows.passes).T
        return np.asarray(np.minimum(noise / np.maximum(power, 1e-30), 1.0))

    def _correlated(self, windows: Windows, noise: FloatArray, frame: list[Band]) -> npt.NDArray[np.float64]:
        """Return (nodes,) how many pixels of a band agree by chance: those of white noise, or more.

        A codec, and chroma of fewer pixels than luma, leave noise that is alike over several pixels. Noise
        has curl and relief has none: how far sums over windows of curl(x) curl(x + d) scatter tells it. Paint
        has curl, too, but the same in template and frame: the difference of the two is asked.
        noise: (nodes,) its share in the template.
        """
        asked = noise > _MOSTLY
        if np.count_nonzero(asked) < _FEWEST_WINDOWS * windows.nodes:
            return np.full(self._lattice.count, _CORRELATED_PX)
        mine, theirs = self._bands[windows.halvings], frame[windows.halvings]
        curl, whole = curl_of(theirs) - curl_of(mine), windows.nodes / 3.0**windows.passes
        weight = np.minimum(mine.weight, theirs.weight)
        squares = []
        for down, across in ((_APART_PX, 0), (0, _APART_PX)):
            terms = _shifted_products(mine.node, self._lattice.count, curl, weight, down, across)
            product, power, pixels = whole * self._lattice.smoothed(terms, windows.passes).T
            enough = (pixels > _CORRELATED_PX) & (power > 0) & asked
            squares.append(pixels[enough] * (product[enough] / power[enough]) ** 2)
        square = np.concatenate(squares)
        if square.size < 2.0 * _FEWEST_WINDOWS * windows.nodes:
            return np.full(self._lattice.count, _CORRELATED_PX)
        found = max(float(np.median(square)) / (_MEDIAN_SQUARE * _WHITE_SQUARE), 1.0)
        # products of two frames scatter by noise times noise, and by noise times relief twice
        share = noise * (2.0 - noise)
        return np.asarray(_CORRELATED_PX * (1.0 + (found - 1.0) * share))


def _moments_of(
    mine: Band, theirs: Band, turns: npt.NDArray[np.float32] | None, count: int
) -> npt.NDArray[np.float64]:
    """Moments (nodes, 14) of a band of the template and one of the frame; turns: (h, w, 2 k) T K, or none."""
    first, second = ((band.features, band.gradients, band.weight) for band in (mine, theirs))
    explained = np.zeros_like(mine.gradients) if turns is None else turns
    return np.asarray(_moments(mine.node, count, *first, *second, explained))


def _symmetric(information: FloatArray) -> npt.NDArray[np.float64]:
    """(m, 2, 2) of (m, 3)."""
    return np.asarray(information[:, [0, 1, 1, 2]].reshape(-1, 2, 2))


@njit(cache=True, fastmath=True)
def _moments(node, count, f, df, wf, g, dg, wg, turns):  # type: ignore[no-untyped-def]
    """(nodes, 14): A (3), H (3), b (2), Σ w |g − f|², Σ w, Σ w |∇f|², pixels, A's trace where positive, and
    the common product of curls: half of what noise of both slopes adds to A's trace, so all along one axis.
    """
    h, w = node.shape
    channels = f.shape[2]
    out = np.zeros((count, 14))
    for v in range(h):
        for u in range(w):
            j = node[v, u]
            weight = min(wf[v, u], wg[v, u])
            if j < 0 or weight <= 0:
                continue
            for c in range(channels):
                r = g[v, u, c] - f[v, u, c]
                fx, fy = df[v, u, c], df[v, u, channels + c]
                gx, gy = dg[v, u, c], dg[v, u, channels + c]
                mx, my = 0.5 * (fx + gx), 0.5 * (fy + gy)
                tx, ty = turns[v, u, c], turns[v, u, channels + c]
                out[j, 0] += weight * (fx * gx - tx * mx)
                out[j, 1] += weight * 0.5 * (fx * gy + fy * gx - tx * my - ty * mx)
                out[j, 2] += weight * (fy * gy - ty * my)
                out[j, 3] += weight * (mx - tx) * mx
                out[j, 4] += weight * 0.5 * (2.0 * mx * my - tx * my - ty * mx)
                out[j, 5] += weight * (my - ty) * my
                out[j, 6] -= weight * (mx - tx) * r
                out[j, 7] -= weight * (my - ty) * r
                out[j, 8] += weight * r * r
                out[j, 9] += weight
                out[j, 10] += weight * (fx * fx + fy * fy + gx * gx + gy * gy) * 0.5
            if channels == 2:
                out[j, 13] += weight * (df[v, u, 2] - df[v, u, 1]) * (dg[v, u, 2] - dg[v, u, 1])
            out[j, 11] += 1.0
    for j in range(count):
        out[j, 12] = max(out[j, 0] + out[j, 2], 0.0)
    return out


@njit(cache=True)
def _shifted_products(node, count, values, weight, down, across):  # type: ignore[no-untyped-def]
    """(count, 3): Σ w a(x) a(x + d), Σ w (a²(x) + a²(x + d)) / 2 and pixels, of an image a (h, w)."""
    h, w = node.shape
    out = np.zeros((count, 3))
    for v in range(h - down):
        for u in range(w - across):
            j = node[v, u]
            own = min(weight[v, u], weight[v + down, u + across])
            if j < 0 or own <= 0:
                continue
            a, b = values[v, u], values[v + down, u + across]
            out[j, 0] += own * a * b
            out[j, 1] += own * 0.5 * (a * a + b * b)
            out[j, 2] += 1.0
    return out


@njit(cache=True)
def _correlations(node, lost, patch, f, wf, g, wg, shifts, out):  # type: ignore[no-untyped-def]
    """Add up f·g, |f|², |g|² and pixels into (patches, shifts, 4), of a ninth of the lost pixels."""
    h, w = node.shape
    for v in range(0, h, 3):
        for u in range(0, w, 3):
            j = node[v, u]
            if j < 0 or not lost[j] or wf[v, u] <= 0:
                continue
            sums = out[patch[j]]
            a, b = f[v, u, 0], f[v, u, 1]
            own = a * a + b * b
            for s in range(len(shifts)):
                x, y = u + shifts[s, 0], v + shifts[s, 1]
                if 0 <= x < w and 0 <= y < h and wg[y, x] > 0:
                    c, d = g[y, x, 0], g[y, x, 1]
                    sums[s, 0] += a * c + b * d
                    sums[s, 1] += own
                    sums[s, 2] += c * c + d * d
                    sums[s, 3] += 9.0


@njit(cache=True)
def _steps(terms, pixel, nodes, correlated_px):  # type: ignore[no-untyped-def]
    """Step measured (nodes, 2), gradients' common share (nodes,), what is sure of A's eigenvalues, its axis.

    Those two (nodes, 2): 0 where chance makes as much; and the cosine and sine of the first eigenvector.
    """
    m = terms.shape[0]
    steps, ratio, kept, axis = np.zeros((m, 2)), np.zeros(m), np.zeros((m, 2)), np.zeros((m, 2))
    for j in range(m):
        if terms[j, 9] <= 0:
            continue
        a, b, c = terms[j, 0], terms[j, 1], terms[j, 2]
        mean, half = 0.5 * (a + c), np.sqrt(0.25 * (a - c) ** 2 + b * b)
        angle = 0.5 * np.arctan2(2 * b, a - c)
        chance = _CHANCE * np.sqrt(correlated_px[j] / (2.0 * max(nodes * terms[j, 11], 1.0)))
        ratio[j] = max(0.0, 2 * mean / max(terms[j, 10], 1e-30))
        axis[j, 0], axis[j, 1] = np.cos(angle), np.sin(angle)
        for k in range(2):
            value = mean + half if k == 0 else mean - half
            x, y = axis[j, 0], axis[j, 1]
            if k == 1:
                x, y = -y, x
            power = terms[j, 3] * x * x + 2 * terms[j, 4] * x * y + terms[j, 5] * y * y
            sure = value - chance * power - max(terms[j, 13], terms[j, 14])
            if sure <= 0 or power <= 0:
                continue
            kept[j, k] = sure
            step = (terms[j, 6] * x + terms[j, 7] * y) / value
            step = min(max(step, -_LONGEST_STEP_PX * pixel), _LONGEST_STEP_PX * pixel)
            steps[j, 0] += step * x
            steps[j, 1] += step * y
    return steps, ratio, kept, axis


@njit(cache=True)
def _scores(terms, steps):  # type: ignore[no-untyped-def]
    """(nodes, 4) products of what a node's own pixels still pull by at the step of its window; A's square."""
    m = terms.shape[0]
    out = np.empty((m, 4))
    for j in range(m):
        x, y = steps[j, 0], steps[j, 1]
        p = terms[j, 6] - terms[j, 0] * x - terms[j, 1] * y
        q = terms[j, 7] - terms[j, 1] * x - terms[j, 2] * y
        out[j, 0], out[j, 1], out[j, 2] = p * p, p * q, q * q
        out[j, 3] = (terms[j, 0] + terms[j, 2]) ** 2
    return out


@njit(cache=True)
def _informed(own, terms, spread, kept, axis, nodes, accuracy):  # type: ignore[no-untyped-def]
    """Information (nodes, 3) of one node's share of its window: it tells of where its relief lies."""
    m = terms.shape[0]
    information = np.zeros((m, 3))
    for j in range(m):
        part = own[j, 12] / max(terms[j, 12], 1e-30)
        telling = nodes * (terms[j, 0] + terms[j, 2]) ** 2 / max(spread[j, 3], 1e-30)  # nodes of the window
        few = _FEW_NODES * telling / max(telling - 1.0, 0.1)  # one fits the step exactly
        for k in range(2):
            sure = kept[j, k]
            if sure <= 0:
                continue
            x, y = axis[j, 0], axis[j, 1]
            if k == 1:
                x, y = -y, x
            power = terms[j, 3] * x * x + 2 * terms[j, 4] * x * y + terms[j, 5] * y * y
            pull = spread[j, 0] * x * x + 2 * spread[j, 1] * x * y + spread[j, 2] * y * y
            noise = terms[j, 8] / terms[j, 9] + LEAST_NOISE**2
            info = part / (max(few * pull, power * noise) / (sure * sure) + accuracy**2)
            information[j, 0] += info * x * x
            information[j, 1] += info * x * y
            information[j, 2] += info * y * y
    return information

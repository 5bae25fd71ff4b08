"""What a frame tells about where the template is, with the information that it really has.

The frame's slopes, pulled back into the template (`bands`), are compared with the template's, band by band:
what is left of them after a Gaussian is taken off three times, at full resolution and at halvings. A fine
band is relief that sits on the surface. A coarse one is its shape, which may bend: its residual then is
large, and it tells little. Beside an occluding contour slopes grow without bound, on a smooth surface too.
What a band finds there stays with the contour while the surface turns beneath it. The finest band is not
compared there. The others are, and how far the surface may have slid enters the expected error. Paint
(`paint`) is compared in the same way, as a measurement of its own: in all bands it stays in place. The finest
bands are also compared with the mean of the frames before (`running_template`).

Template f and frame g differ by noise and by the displacement d: g − f = F d + noise. Over a window, with
F = ½(∇f + ∇g), the moments b = −Σ Fᵀ(g − f), H = Σ FᵀF and A = Σ ∇fᵀ∇g give d = A⁻¹ b. A is made of what both
have in common: noise is not, and raises H alone. Where A is no larger than chance makes it, nothing is told.
Nor does A count as far as it goes with curl that both have in common: a surface's slopes have none. What a
mosaic makes of strands finer than its pixels has, is alike in both, and wanders along the strands.
Else, along an eigenvector of A, d has the variance S / A², with S = Σ s² over the nodes of the window, s what
the pixels of one still add to b at d (the sandwich of `white1980`, clustered): it counts noise, and whatever
moves otherwise than the rest. White noise alone, of the residual's σ², makes S = σ² H, the least it can be.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.native import njit
from vntoolkit.tracking.bands import LEAST_NOISE, RIM_PX, Band, TemplateRaster, curl_of
from vntoolkit.tracking.factors import Factor, factor, full_of, total, upper_of
from vntoolkit.tracking.lattice import NODES_BY_PASS, TemplateLattice
from vntoolkit.tracking.paint import PaintImage
from vntoolkit.tracking.running_template import Comparison, RunningTemplate, running_template
from vntoolkit.tracking.slopes import Relief
from vntoolkit.tracking.template import TrackingTemplate

_CHANCE = 2.5  # standard deviations of A without a common signal, below which nothing is told
_CORRELATED_PX = 12.0  # pixels that agree by chance count as one, by H: so measured on white noise
_APART_PX = 12  # of the band: noise so far apart has nothing in common, nor that of a codec's blocks
_WHITE_SQUARE = 1.9  # pixels × squared correlation of curl so far apart, of white noise; measured
_MEDIAN_SQUARE = 0.455  # median of a squared normal variate
_MOSTLY = 0.5  # share of noise from which its curl is asked: fine relief that is sampled has some, too
_BLOCK_PX, _FEWEST_BLOCKS = 24, 16  # of the band: of so many products, and so many of them, it is told
_LONGEST_STEP_PX = 2.0  # in pixels of the band: about what one linearisation reaches
_KNOWN_PX = 4.0  # error by the finest relief around, at which half of the slide remains possible
_KNOWN_PASSES = 24  # of lattice smoothing: how far around relief tells of a slide
_FEW_NODES = 4.0  # variance of a step over that of its nodes' right-hand sides: two by two nodes err alike


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


_RELIEF = (Windows(0, 2, 0.1), Windows(1, 5, 0.9), Windows(2, 8, 5.4))
_PAINT = (Windows(0, 2, 0.1), Windows(1, 5, 0.3), Windows(2, 8, 0.9))
_FINEST = _RELIEF[0]


class Registration(NamedTuple):
    """What relief and paint of one frame tell.

    factors: of each window's, in pixels of the template: relief, paint, and last the running template.
    match: (nodes,) the share of the finest gradients that template and frame have in common, 0 to 1, of
    relief or of paint, the larger: where one matches, the other looks otherwise for some other reason.
    expected: (nodes,) the share of relief if only noise told them apart. comparison: with what the running
    template goes on. correlated: (nodes,) for each band of relief, how many pixels
    agree by chance, over those of white noise.
    """

    factors: tuple[Factor, ...]
    match: npt.NDArray[np.float64]
    expected: npt.NDArray[np.float64]
    comparison: Comparison
    correlated: tuple[FloatArray, ...]


class TemplateRegistration:
    """Measures the displacement of one template in any frame."""

    def __init__(
        self,
        template: TrackingTemplate,
        lattice: TemplateLattice,
        relief: Relief,
        paint: PaintImage | None = None,
    ) -> None:
        """Prepare the template's bands; relief, paint: of its frame."""
        self._lattice = lattice
        self._raster = TemplateRaster(template, lattice)
        identity = np.tile([1.0, 0.0, 0.0, 1.0], (lattice.count, 1))
        self._relief = self._raster.relief(template.positions_px, identity, relief)
        self._paint = [] if paint is None else self._raster.paint(template.positions_px, paint, relief)
        self._relief_windows, self._paint_windows = _RELIEF[: len(self._relief)], _PAINT[: len(self._paint)]
        self._noise = [
            self._noise_share(*each) for each in zip(self._relief_windows, self._relief, strict=True)
        ]

    @property
    def passes(self) -> list[int]:
        """Of lattice smoothing, over which the errors of each factor but the last are alike."""
        return [windows.passes for windows in (*self._relief_windows, *self._paint_windows)]

    def running_template(self, edges: int) -> RunningTemplate:
        """Return the running template before any frame was seen; edges: how many the lattice has."""
        return running_template((*self._relief[:1], *self._paint[:1]), self._lattice.count, edges)

    def measure(
        self,
        positions_px: Points2,
        jacobians: FloatArray,
        relief: Relief,
        paint: PaintImage | None = None,
        running: RunningTemplate | None = None,
        correlated: tuple[FloatArray, ...] = (),
    ) -> Registration:
        """Measure in the frame with this relief and paint, by the template and by the running one.

        jacobians: (nodes, 4) ∂u/∂x, ∂u/∂y, ∂v/∂x, ∂v/∂y of positions (n, 2) by the template's pixels.
        correlated: as measured a step away in the same frame, whose noise is the same.
        """
        seen = self._raster.relief(positions_px, jacobians, relief)
        correlated = correlated or tuple(map(self._correlated, self._relief, seen, self._noise))
        by_relief = [self._compared(w, self._relief, seen, correlated) for w in self._relief_windows]
        finest, matches = [by_relief[0][0]], [by_relief[0][1]]
        bands, by_paint = seen[:1], []
        if self._paint:
            painted = self._raster.paint(positions_px, paint, relief)
            alike = tuple(np.full_like(each, each.max()) for each in correlated)
            by_paint = [self._compared(w, self._paint, painted, alike) for w in self._paint_windows]
            finest, matches = [*finest, by_paint[0][0]], [*matches, by_paint[0][1]]
            bands = [*bands, painted[0]]
        comparison = self._with_running(total(finest), tuple(bands), running, correlated[0])
        unknown = self._unknown_around(comparison.fine.information)
        slid = [
            each._replace(
                shared_px=RIM_PX * 2.0**w.halvings * unknown * self._beside_contours(w.halvings, seen)
            )
            for w, (each, _) in zip(self._relief_windows[1:], by_relief[1:], strict=True)
        ]
        factors = (by_relief[0][0], *slid, *(each for each, _ in by_paint), comparison.more)
        return Registration(
            factors, np.max(matches, axis=0), self._expected_match(correlated[0]), comparison, correlated
        )

    def _with_running(
        self, fine: Factor, bands: tuple[Band, ...], running: RunningTemplate | None, correlated: FloatArray
    ) -> Comparison:
        """Compare the finest bands with the running template, too; fine: what they tell by the template."""
        nothing = factor(np.zeros_like(fine.information), np.zeros_like(fine.right_hand_side))
        if running is None:
            return Comparison(bands, fine, nothing, nothing)
        own = running.bands(self._raster.node)
        against = total(
            self._window(_FINEST, _moments_of(*pair, self._lattice.count), correlated)[0]
            for pair in zip(own, bands, strict=True)
        )
        more = running.beyond(fine, against)
        return Comparison(bands, total([fine, more]), against, more)

    def _compared(
        self, windows: Windows, mine: list[Band], theirs: list[Band], correlated: tuple[FloatArray, ...]
    ) -> tuple[Factor, npt.NDArray[np.float64]]:
        k = windows.halvings
        own = _moments_of(mine[k], theirs[k], self._lattice.count)
        return self._window(windows, own, correlated[k])

    def _window(
        self, windows: Windows, own: FloatArray, correlated: FloatArray
    ) -> tuple[Factor, npt.NDArray[np.float64]]:
        """What windows measure of nodes' own moments; (nodes,) the share that gradients have in common."""
        whole = 3.0**windows.passes  # of the weights of a window
        terms = self._lattice.smoothed(own, windows.passes) / whole
        pixel, correlated_px = 2.0**windows.halvings, _CORRELATED_PX * correlated
        step, ratio, sure, axes = _steps(terms, pixel, windows.nodes, correlated_px)
        spread = self._lattice.smoothed(_scores(own, step), windows.passes) / whole
        return factor(_informed(own, terms, spread, sure, axes, windows), step), np.asarray(ratio)

    def _beside_contours(self, halvings: int, seen: list[Band]) -> npt.NDArray[np.float64]:
        """(nodes,) share of a node's pixels within reach of a contour, in the template or in the frame."""
        mine, count = self._relief[halvings], self._lattice.count
        inside = (mine.node >= 0) & (mine.weight > 0)
        beside = (mine.beside | seen[halvings].beside)[inside]
        node = mine.node[inside]
        return np.bincount(node, beside, count) / np.maximum(np.bincount(node, minlength=count), 1)

    def _unknown_around(self, information: FloatArray) -> npt.NDArray[np.float64]:
        """(nodes,) how little finest relief around tells, by its information (nodes, 3): 1 for nothing."""
        share = NODES_BY_PASS * _KNOWN_PASSES / 3.0**_KNOWN_PASSES
        a, b, c = share * self._lattice.smoothed(information, _KNOWN_PASSES).T
        least = 0.5 * (a + c) - np.sqrt(0.25 * (a - c) ** 2 + b * b)
        return np.asarray(1.0 / (1.0 + _KNOWN_PX**2 * least))

    def _expected_match(self, correlated: FloatArray) -> npt.NDArray[np.float64]:
        """(nodes,) the share of gradients in common if only noise told template and frame apart.

        Noise is known the less well the more of its pixels agree by chance, beyond those of white noise.
        """
        pixels = _FINEST.nodes * self._lattice.cell_px**2
        unsure = _CHANCE * np.sqrt(_CORRELATED_PX * (correlated - 1.0) / (2.0 * pixels))
        return np.maximum(0.0, 1.0 - (1.0 + unsure) * self._noise[0])

    def _noise_share(self, windows: Windows, band: Band) -> npt.NDArray[np.float64]:
        """Return (nodes,) the share of the template's gradients in a band, over windows, that is noise.

        Slopes of a surface have no curl. Noise of both slopes has half of its gradients' power in it.
        """
        inside, count = band.node >= 0, self._lattice.count
        node, weight = band.node[inside], band.weight[inside]
        squares = (2.0 * np.square(curl_of(band)), np.square(band.gradients).sum(axis=-1))
        own = [np.bincount(node, weight * square[inside], count) for square in squares]
        noise, power = self._lattice.smoothed(np.stack(own, axis=1), windows.passes).T
        return np.asarray(np.minimum(noise / np.maximum(power, 1e-30), 1.0))

    def _correlated(self, mine: Band, theirs: Band, noise: FloatArray) -> npt.NDArray[np.float64]:
        """Return (nodes,) how many pixels of a band agree by chance, over those of white noise, at least 1.

        A codec, and chroma of fewer pixels than luma, leave noise that is alike over several pixels. Noise
        has curl and relief has none: how far means over blocks of curl(x) curl(x + d) scatter tells it. Paint
        has curl, too, but the same in template and frame: the difference of the two is asked.
        noise: (nodes,) its share in the template.
        """
        curl = curl_of(theirs) - curl_of(mine)
        asked = (mine.node >= 0) & (noise[mine.node] > _MOSTLY) & (np.minimum(mine.weight, theirs.weight) > 0)
        squares = []
        for near, far in (
            (np.s_[:-_APART_PX], np.s_[_APART_PX:]),
            (np.s_[:, :-_APART_PX], np.s_[:, _APART_PX:]),
        ):
            both = (asked[near] & asked[far]).astype(np.float32)
            a, b = both * curl[near], both * curl[far]
            product, power, share = (_block_means(each) for each in (a * b, 0.5 * (a * a + b * b), both))
            whole = (share > 0.5) & (power > 0)
            squares.append(_BLOCK_PX**2 * share[whole] * np.square(product[whole] / power[whole]))
        square = np.concatenate(squares)
        if square.size < _FEWEST_BLOCKS:
            return np.ones_like(noise)
        found = max(float(np.median(square)) / (_MEDIAN_SQUARE * _WHITE_SQUARE), 1.0)
        # products of two frames scatter by noise times noise, and by noise times relief twice
        return np.asarray(1.0 + (found - 1.0) * noise * (2.0 - noise))


def _block_means(image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Means over whole blocks of an image (h, w)."""
    rows, columns = (n // _BLOCK_PX for n in image.shape)
    blocks = image[: rows * _BLOCK_PX, : columns * _BLOCK_PX].reshape(rows, _BLOCK_PX, columns, _BLOCK_PX)
    return np.asarray(blocks.mean(axis=(1, 3)))


def _moments_of(mine: Band, theirs: Band, count: int) -> npt.NDArray[np.float64]:
    """Moments (nodes, 14) of a band of the template and one of the frame."""
    first, second = ((band.features, band.gradients, band.weight) for band in (mine, theirs))
    return np.asarray(_moments(mine.node, count, *first, *second))


@njit
def _moments(node, count, f, df, wf, g, dg, wg):  # type: ignore[no-untyped-def]
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
                out[j, 0] += weight * fx * gx
                out[j, 1] += weight * 0.5 * (fx * gy + fy * gx)
                out[j, 2] += weight * fy * gy
                out[j, 3] += weight * mx * mx
                out[j, 4] += weight * mx * my
                out[j, 5] += weight * my * my
                out[j, 6] -= weight * mx * r
                out[j, 7] -= weight * my * r
                out[j, 8] += weight * r * r
                out[j, 9] += weight
                out[j, 10] += weight * (fx * fx + fy * fy + gx * gx + gy * gy) * 0.5
            if channels == 2:
                out[j, 13] += weight * (df[v, u, 2] - df[v, u, 1]) * (dg[v, u, 2] - dg[v, u, 1])
            out[j, 11] += 1.0
    for j in range(count):
        out[j, 12] = max(out[j, 0] + out[j, 2], 0.0)
    return out


def _steps(
    terms: FloatArray, pixel: float, nodes: float, correlated_px: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Step measured (nodes, 2), gradients' common share (nodes,), what is sure of A's eigenvalues, its axes.

    Sure (nodes, 2): 0 where chance makes as much. Axes (nodes, 2, 2): the eigenvectors, row by row.
    """
    a, b, c = terms[:, :3].T
    mean, half = 0.5 * (a + c), np.sqrt(0.25 * (a - c) ** 2 + b * b)
    angle = 0.5 * np.arctan2(2 * b, a - c)
    cosine, sine = np.cos(angle), np.sin(angle)
    axes = np.stack([cosine, sine, -sine, cosine], axis=1).reshape(-1, 2, 2)
    values = np.stack([mean + half, mean - half], axis=1)
    seen = terms[:, 9] > 0
    ratio = seen * np.maximum(2 * mean / np.maximum(terms[:, 10], 1e-30), 0.0)
    chance = _CHANCE * np.sqrt(correlated_px / (2.0 * np.maximum(nodes * terms[:, 11], 1.0)))
    power = _along(axes, terms[:, 3:6])
    sure = values - chance[:, None] * power - np.maximum(terms[:, 13:], 0.0)
    told = seen[:, None] & (sure > 0) & (power > 0)
    step = np.einsum("nkj,nj->nk", axes, terms[:, 6:8]) / np.where(told, values, 1.0)
    step = told * np.clip(step, -_LONGEST_STEP_PX * pixel, _LONGEST_STEP_PX * pixel)
    return np.einsum("nk,nkj->nj", step, axes), ratio, told * sure, axes


def _along(axes: FloatArray, matrix: FloatArray) -> npt.NDArray[np.float64]:
    """(nodes, 2) of symmetric matrices (nodes, 3) along two axes (nodes, 2, 2)."""
    return np.einsum("nki,nij,nkj->nk", axes, full_of(matrix), axes)


def _scores(terms: FloatArray, steps: FloatArray) -> npt.NDArray[np.float64]:
    """(nodes, 4) products of what a node's own pixels add to b at the step of its window; A squared."""
    p, q = (terms[:, 6:8] - (full_of(terms[:, :3]) @ steps[..., None])[..., 0]).T
    return np.stack([p * p, p * q, q * q, (terms[:, 0] + terms[:, 2]) ** 2], axis=1)


def _informed(
    own: FloatArray,
    terms: FloatArray,
    spread: FloatArray,
    sure: FloatArray,
    axes: FloatArray,
    windows: Windows,
) -> npt.NDArray[np.float64]:
    """Information (nodes, 3) of one node's share of its window: it tells of where its relief lies."""
    part = own[:, 12] / np.maximum(terms[:, 12], 1e-30)
    # nodes of the window, of which one fits the step exactly
    telling = windows.nodes * (terms[:, 0] + terms[:, 2]) ** 2 / np.maximum(spread[:, 3], 1e-30)
    few = _FEW_NODES * telling / np.maximum(telling - 1.0, 0.1)
    noise = terms[:, 8] / np.maximum(terms[:, 9], 1e-30) + LEAST_NOISE**2
    scatter = few[:, None] * _along(axes, spread[:, :3])
    error = np.maximum(scatter, noise[:, None] * _along(axes, terms[:, 3:6]))
    variance = error / np.where(sure > 0, sure, 1.0) ** 2 + windows.accuracy_px**2
    return upper_of(np.einsum("nk,nki,nkj->nij", (sure > 0) * part[:, None] / variance, axes, axes))

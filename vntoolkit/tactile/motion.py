"""Motion of a gel's membrane: of the dots printed on it, or else of the gel's own texture.

A touch changes the colours of a gel, and most of that change is shading. What lies on the material is left
after dividing by what is bright around a pixel: dots are darker than that in all channels, texture in the
mean. Points of the membrane are sought there (Lucas–Kanade, bouguet2001), each where its neighbours went in
the frame before, and always against the untouched gel, so that no drift adds up. A point is found where what
is seen and the untouched gel differ less from each other than either from a flat picture. Otherwise it is
lost: a fold or an edge hides it, or the texture is too weak.

Between the points the motion is a moving least squares fit of an affine motion, with Gaussian weights over
half the distance of points. Its residuals at the points themselves, each left out of its own fit, tell its
error.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import cv2
import numpy as np
from scipy.spatial import cKDTree

from vntoolkit.arrays import (
    Array,
    BoolArray,
    ByteArray,
    Float32Array,
    FloatArray,
    Flow,
    LinearImage,
    Mask,
    Points2,
)
from vntoolkit.spread import NINE_OF_TEN_IN_PLANE
from vntoolkit.tactile.dots import BLACK, closed, window_of

_ACROSS = 16  # points over the shorter side of a gel without dots, as many as sensors print dots
_DOT_WINDOW, _TEXTURE_WINDOW = 0.5, 1.5  # side of what is compared, of the points' distance
_TEXTURE_PX = 3.0  # standard deviation of the mean that texture is compared with
_BRIGHTEST, _STRONGEST = 99.0, 99.0  # percentiles of the untouched gel that become a byte's 255, and 127
_ITERATIONS, _SETTLED_PX = 20, 0.01
_LEAST_EIGENVALUE = 1e-5
_REACH = 0.5  # standard deviation of the weights, of the points' distance: at a point its own counts most
_CELLS = 3  # over the distance of points: the motion is fitted so densely, then enlarged
_STIFFNESS = 1e-3  # of an affine motion against a translation, where points lie on one line
_MEAN_OF_CHANNELS = np.full((1, 3), 1 / 3, np.float32)
_FEWEST = 3  # points of an affine motion


@dataclass(frozen=True, kw_only=True, eq=False)
class MembraneMotion:
    """Where the points of a membrane are in one frame.

    rest_px: (n, 2), in the untouched gel. displacement_px: (n, 2), from there; of a lost point what its
    neighbours tell. found: (n,). error_px: (n,), what nine of ten errors of the motion around a point stay
    within; of a lost point what that of its neighbours is.
    """

    rest_px: Points2
    displacement_px: Points2
    found: BoolArray
    error_px: FloatArray


class MotionField(NamedTuple):
    """At k places: displacement_px (k, 2), its gradient (k, 2, 2), rows u and v, and the nearest point's
    number, (k,)."""

    displacement_px: Points2
    gradient: FloatArray
    nearest: Array


class Cells(NamedTuple):
    """A grid over a picture: middles of its columns (u, ascending) and rows, pixels."""

    columns_px: FloatArray
    rows_px: FloatArray

    @property
    def middles_px(self) -> Points2:
        """(k, 2), row by row."""
        return np.stack(np.meshgrid(self.columns_px, self.rows_px), axis=-1).reshape(-1, 2)


class Membrane:
    """One gel's membrane. It never changes: what frames hand on is a `MembraneMotion`."""

    def __init__(self, untouched: LinearImage, dots: Mask) -> None:
        """untouched: linear (h, w, 3). dots: (h, w), True on the printed dots; none for its texture."""
        self.untouched = untouched
        self._has_dots = bool(dots.any())
        brightest = float(np.percentile(untouched, _BRIGHTEST))
        self._byte = np.float32(255.0 / max(brightest, BLACK))
        self._gain = np.float32(1.0)
        if not self._has_dots:
            strength = float(np.percentile(np.abs(self._texture(untouched)), _STRONGEST))
            self._gain = np.float32(127.0 / max(strength, BLACK))
        self._rest = self.picture(untouched)
        places = self._dots_of(dots) if self._has_dots else _lattice(untouched.shape[:2])
        apart = cKDTree(places).query(places, 2)[0][:, 1] if len(places) > 1 else np.array([np.inf])
        self.spacing_px = float(np.median(apart))
        window = (_DOT_WINDOW if self._has_dots else _TEXTURE_WINDOW) * self.spacing_px
        self._reach_px = _REACH * self.spacing_px
        self._window = 2 * int(min(window, *untouched.shape[:2]) / 2) + 1
        margin = np.minimum(places, np.array(untouched.shape[1::-1]) - 1 - places).min(axis=1)
        self.rest_px = places[margin >= self._window / 2]
        self._patterns = self._patterns_at(self._rest, self.rest_px)
        self._others = _weights(self.rest_px, self.rest_px, self._reach_px)  # of each, without its own
        np.fill_diagonal(self._others, 0.0)

    @property
    def is_followable(self) -> bool:
        """False where there are fewer points than an affine motion needs."""
        return len(self.rest_px) >= _FEWEST

    def picture(self, rgb: LinearImage) -> ByteArray:
        """What lies on the material, (h, w) bytes, of a frame in linear light, (h, w, 3)."""
        if not self._has_dots:
            return np.clip(128.5 + self._gain * self._texture(rgb), 0, 255).astype(np.uint8)
        frame = np.clip(rgb * self._byte, 0, 255).astype(np.uint8)
        share = cv2.divide(frame, closed(frame, window_of(frame.shape)), scale=255)
        red, green, blue = cv2.split(share)
        return np.asarray(cv2.max(cv2.max(red, green), blue), dtype=np.uint8)

    def _texture(self, rgb: LinearImage) -> Float32Array:
        grey = cv2.transform(np.asarray(rgb, np.float32), _MEAN_OF_CHANNELS)
        around = cv2.GaussianBlur(grey, (0, 0), _TEXTURE_PX)
        return np.asarray(grey / np.maximum(around, np.float32(1.0 / self._byte)) - 1.0, dtype=np.float32)

    def _dots_of(self, dots: Mask) -> Points2:
        """Centroids (n, 2) of the dots at rest, by how dark they are."""
        count, labels = cv2.connectedComponents(dots.astype(np.uint8))
        dark = 255.0 - self._rest.astype(np.float64)
        v, u = np.indices(dots.shape)
        weight, x, y = (
            np.bincount(labels.ravel(), (dark * values).ravel(), count)[1:]
            for values in (np.ones_like(u), u, v)
        )
        seen = weight > 0
        return np.column_stack([x[seen] / weight[seen], y[seen] / weight[seen]])

    def _patterns_at(self, picture: ByteArray, places: Points2) -> FloatArray:
        """Patterns (n, window²) around places (n, 2), their means taken off."""
        if not len(places):
            return np.zeros((0, self._window**2))
        reach = np.arange(self._window) - self._window // 2
        u, v = (
            (places[:, k, None, None] + offsets).reshape(-1, self._window).astype(np.float32)
            for k, offsets in enumerate((reach + 0 * reach[:, None], reach[:, None] + 0 * reach))
        )
        seen = cv2.remap(picture.astype(np.float32), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        flat = seen.reshape(len(places), -1)
        return np.asarray(flat - flat.mean(axis=1, keepdims=True))

    def follow(self, picture: ByteArray, before: MembraneMotion | None = None) -> MembraneMotion:
        """Find the points in a frame's `picture`. before: of the frame before; None for the untouched gel."""
        rest = self.rest_px
        start = np.zeros_like(rest) if before is None else before.displacement_px
        if not self.is_followable:
            nothing = np.zeros(len(rest), np.bool_)
            return MembraneMotion(
                rest_px=rest, displacement_px=start, found=nothing, error_px=np.zeros(len(rest))
            )
        ended, status, _ = cv2.calcOpticalFlowPyrLK(
            self._rest, picture, rest[:, None].astype(np.float32), (rest + start)[:, None].astype(np.float32),
            winSize=(self._window, self._window), maxLevel=0,
            criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, _ITERATIONS, _SETTLED_PX),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW, minEigThreshold=_LEAST_EIGENVALUE,
        )  # fmt: skip
        moved = ended[:, 0].astype(np.float64)
        seen = self._patterns_at(picture, moved)
        changed = ((seen - self._patterns) ** 2).sum(axis=1)
        contrast = np.minimum((seen**2).sum(axis=1), (self._patterns**2).sum(axis=1))
        found = (status[:, 0] > 0) & (changed < contrast)
        displacement = moved - rest
        weights, terms = self._others, _terms(rest, displacement, self._reach_px)
        fitted, _ = _affine_fit((weights * found) @ terms, rest, self._reach_px)
        # a point further off than half the way to the next is the next
        found &= np.linalg.norm(displacement - fitted, axis=1) < self.spacing_px / 2
        fitted, _ = _affine_fit((weights * found) @ terms, rest, self._reach_px)
        squared = np.where(found, ((displacement - fitted) ** 2).sum(axis=1), 0.0)
        share = weights + np.eye(len(rest))
        variance = share @ squared / np.maximum(share @ found.astype(np.float64), 1e-9) / 2.0
        return MembraneMotion(
            rest_px=rest,
            displacement_px=np.where(found[:, None], displacement, fitted),
            found=found,
            error_px=NINE_OF_TEN_IN_PLANE * np.sqrt(variance),
        )

    @cached_property
    def cells(self) -> Cells:
        """Cells that cover the picture."""
        height, width = self._rest.shape
        side = max(1.0, min(self.spacing_px, height, width) / _CELLS)
        columns, rows = (np.arange(round(length / side)) + 0.5 for length in (width, height))
        return Cells(columns * width / len(columns) - 0.5, rows * height / len(rows) - 0.5)

    def displacement_at_rest(self, motion: MembraneMotion) -> Flow:
        """Motion (h, w, 2), pixels, of the material of every pixel of the untouched gel."""
        moved = self._field_of_cells(motion, motion.rest_px).displacement_px
        return enlarged(moved, self.cells, self._rest.shape)

    def field_in_frame(self, motion: MembraneMotion) -> MotionField:
        """Motion since rest of the material that is at the middles of the frame's `cells`."""
        return self._field_of_cells(motion, motion.rest_px + motion.displacement_px)

    def _field_of_cells(self, motion: MembraneMotion, places: Points2) -> MotionField:
        """places: (n, 2), where the points are."""
        middles = self.cells.middles_px
        if not self.is_followable:
            return _no_motion(len(middles))
        terms = _terms(places, motion.displacement_px, self._reach_px)
        # a Gaussian is that of the column times that of the row: no weight of each cell and point is needed
        across = _weights(self.cells.columns_px[:, None], places[:, :1], self._reach_px)
        down = _weights(self.cells.rows_px[:, None], places[:, 1:], self._reach_px)
        by_column = across[..., None] * terms  # small products: BLAS takes no second thread to them
        sums = (down @ by_column).transpose(1, 0, 2).reshape(len(middles), -1)
        moved, gradient = _affine_fit(sums, middles, self._reach_px)
        return MotionField(moved, gradient, cKDTree(places).query(middles)[1])


def _no_motion(count: int) -> MotionField:
    return MotionField(np.zeros((count, 2)), np.zeros((count, 2, 2)), np.zeros(count, np.int64))


def enlarged(values: FloatArray, cells: Cells, shape: tuple[int, ...]) -> Float32Array:
    """Values (k, c) of cells, as maps (h, w, c)."""
    height, width = shape[:2]
    laid = np.asarray(values, np.float32).reshape(len(cells.rows_px), len(cells.columns_px), -1)
    return np.asarray(cv2.resize(laid, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)


def _lattice(shape: tuple[int, ...]) -> Points2:
    height, width = shape[:2]
    step = min(height, width) / _ACROSS
    u, v = (step / 2 + step * np.arange(int(length / step)) for length in (width, height))
    return np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)


def _weights(at: FloatArray, places: FloatArray, reach_px: float) -> FloatArray:
    """(k, n): Gaussian in the distance of at (k, d) from places (n, d); far from all, the nearest still
    count."""
    squared = sum((a[:, None] - b) ** 2 for a, b in zip(at.T / reach_px, places.T / reach_px, strict=True))
    return np.asarray(np.exp(-0.5 * (squared - squared.min(axis=1, keepdims=True, initial=np.inf))) + 1e-12)


def _terms(places: Points2, values: Points2, reach_px: float) -> FloatArray:
    """(n, 12): what sums of an affine fit to values (n, 2) at places (n, 2) are made of."""
    x, y = places.T / reach_px
    first, second = values.T
    products = (np.ones_like(x), x, y, x * x, x * y, y * y)
    return np.stack([*products, first, second, x * first, x * second, y * first, y * second], axis=1)


def _affine_fit(sums: FloatArray, at: Points2, reach_px: float) -> tuple[Points2, FloatArray]:
    """Affine functions of weighted sums (k, 12) of `_terms`, one at each of k places.

    Returns their values there, (k, 2), and their gradients, (k, 2, 2).
    """
    own = at / reach_px
    design = sums[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
    right = sums[:, 6:].reshape(-1, 3, 2)
    shift = np.tile(np.eye(3), (len(at), 1, 1))  # to coordinates from each place
    shift[:, 1, 0], shift[:, 2, 0] = -own[:, 0], -own[:, 1]
    design = shift @ design @ shift.transpose(0, 2, 1)
    total = np.maximum(design[:, 0, 0], 1e-30)
    design[:, [0, 1, 2], [0, 1, 2]] += total[:, None] * np.array([1e-12, _STIFFNESS, _STIFFNESS])
    found = np.linalg.solve(design, shift @ right)
    return found[:, 0], found[:, 1:].transpose(0, 2, 1) / reach_px

"""Paint that is told by its steps alone (land1971), whatever M is.

From one region to its neighbour on the same surface the normal changes little, so that a large step of log s
is one of paint. The steps of all seams tell the log ρ of every region up to one constant. Nothing is asked of
the lamps' directions: a wrong M cannot explain its faults away as paint.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.linalg import solveh_banded
from scipy.ndimage import gaussian_filter
from scipy.sparse.csgraph import reverse_cuthill_mckee

from vntoolkit.arrays import FloatArray, IntArray, Mask, Points, Vector3
from vntoolkit.materials.reflectance import CAP
from vntoolkit.materials.regions import SHADING_STEP, Regions, regions_of
from vntoolkit.materials.split_frame import split_frame
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

PAINT_STEP = 2.5 * SHADING_STEP  # of log s between neighbours: a larger one is of paint
FALL = 0.6  # of the reach of steps, a round
_WEAK = 0.05  # weight of the mean reflectance where nothing tells a region's own
_ROUNDS = 2
_FILLING_PX = 1.5  # beyond an edge, which is five pixels wide, the surface is taken for smooth …
_LEAST_FILLED = 0.02  # … where a pixel of plain paint is as near as three pixels


def in_one_paint(frame: LinearFrame, mask: Mask, response: LightResponse) -> LinearFrame:
    """Return the frame as if all of it were of one paint, the mean of its paints; edges of paint are filled.

    mask: (h, w), where the subject is; elsewhere, and where too little of it is plain, the frame is marked as
    clipped.
    """
    colours = np.eye(3) if response.light_colours is None else response.light_colours
    split = split_frame(frame, replace(response, light_colours=colours), mask, most_pixels=mask.size)
    regions = regions_of(split)
    plain = regions.plain & (regions.labels >= 0)
    if not regions.count or not plain.any():
        return replace(frame, clipped=np.ones(mask.shape, np.bool_))
    levels = SeamSteps(regions).levels()
    levels -= regions.sizes @ levels / regions.sizes.sum()
    alike = split.contributions * np.exp(-levels)[regions.labels] * plain[..., None]
    weight = _blurred(plain.astype(np.float32))
    alike = np.where(plain[..., None], alike, _blurred(alike) / np.maximum(weight, _LEAST_FILLED)[..., None])
    rgb = alike @ colours + response.ambient
    lost = ~split.lit | (weight < _LEAST_FILLED)
    return replace(frame, rgb=rgb.astype(np.float32), clipped=frame.clipped | lost)


def _blurred(image: FloatArray) -> FloatArray:
    return np.asarray(gaussian_filter(image, _FILLING_PX, axes=(0, 1)))


class SeamSteps:
    """The steps between regions, as equations in log ρ of each."""

    def __init__(self, regions: Regions) -> None:
        once = regions.sources < regions.neighbours
        self._a, self._b = a, b = regions.sources[once], regions.neighbours[once]
        self._contacts = regions.contacts[once]
        is_paint = np.abs(regions.steps[once]).max(axis=1) > PAINT_STEP
        self._target = np.where(is_paint[:, None], regions.steps[once], 0.0)
        self._spread = np.where(is_paint, 1.0, 0.5) * SHADING_STEP
        self._system = _BandedSystem(a, b, regions.count)
        self._count = regions.count

    def levels(self) -> Points:
        """Return (n, 3), log ρ of every region up to one constant, by the steps alone."""
        x: Points = np.zeros((self._count, 3))
        nothing = np.zeros((self._count, 3, 3))
        for _ in range(_ROUNDS):
            x = self.balanced(x, np.zeros(3), CAP, nothing, np.zeros_like(x))
        return x

    def balanced(
        self, x: Points, centre: Vector3, reach: float, matrices: FloatArray, gradients: FloatArray
    ) -> Points:
        """Return log ρ x (n, 3) after a round of Gauss–Newton on steps and what else tells log ρ.

        centre: (3,), mean log ρ. reach: in spreads of a step; from CAP times it steps count less. matrices,
        gradients: (n, 3, 3) and (n, 3), normal equations of what else tells.
        """
        a, b, spread = self._a, self._b, self._spread
        rest = self._target - (x[b] - x[a])
        falling = 1.0 / (1.0 + np.sum(rest**2, axis=1) / (CAP * (reach * spread)) ** 2)
        weight = self._contacts * (falling / spread) ** 2
        right = gradients + _WEAK * (centre - x)
        np.add.at(right, b, weight[:, None] * rest)
        np.add.at(right, a, -weight[:, None] * rest)
        return x + self._system.solve(matrices + _WEAK * np.eye(3), weight, right).clip(-3.0, 3.0)


class _BandedSystem:
    """Normal equations of n regions with three unknowns each, and of the steps between neighbours a, b (e,).

    Neighbours get numbers near to each other (cuthill1969): all entries lie in a band.
    """

    def __init__(self, a: IntArray, b: IntArray, n: int) -> None:
        graph = sparse.coo_array((np.ones(len(a)), (a, b)), shape=(n, n))
        order = reverse_cuthill_mckee((graph + graph.T).tocsr(), symmetric_mode=True)
        self._index = index = 3 * np.argsort(order)[:, None] + np.arange(3)
        first, second = index[a].ravel(), index[b].ravel()
        rows = np.concatenate([np.repeat(index, 3, axis=1).ravel(), first, second, np.maximum(first, second)])
        columns = np.concatenate([np.tile(index, (1, 3)).ravel(), first, second, np.minimum(first, second)])
        self._below = rows >= columns
        self._size, self._band = 3 * n, int((rows - columns).max()) + 1
        self._places = ((rows - columns) * self._size + columns)[self._below]

    def solve(self, blocks: FloatArray, weights: FloatArray, right: FloatArray) -> FloatArray:
        """Return (n, 3). blocks: (n, 3, 3), of each region. weights: (e,), of the steps. right: (n, 3)."""
        thrice = np.repeat(weights, 3)
        entries = np.concatenate([blocks.ravel(), thrice, thrice, -thrice])[self._below]
        band = np.bincount(self._places, entries, self._band * self._size).reshape(self._band, self._size)
        ordered = np.empty(self._size)
        ordered[self._index] = right
        return np.asarray(solveh_banded(band, ordered, lower=True, check_finite=False)[self._index])

"""Paint that is told by its steps alone (land1971), whatever M is.

From one region to its neighbour on the same surface the normal changes little, so that a large step of log s
is one of paint. The steps of all seams tell the log ρ of every region up to one constant. Nothing is asked of
the lamps' directions: a wrong M cannot explain its faults away as paint.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from scipy.ndimage import gaussian_filter

from vntoolkit.arrays import FloatArray, Mask, Points, Vector3
from vntoolkit.geometry.mesh import factored, graph_laplacian
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
        self._edges = np.stack([regions.sources[once], regions.neighbours[once]], axis=1)
        self._contacts = regions.contacts[once]
        is_paint = np.abs(regions.steps[once]).max(axis=1) > PAINT_STEP
        self._target = np.where(is_paint[:, None], regions.steps[once], 0.0)
        self._spread = np.where(is_paint, 1.0, 0.5) * SHADING_STEP
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
        (a, b), spread, own = self._edges.T, self._spread, np.arange(self._count + 1)
        rest = self._target - (x[b] - x[a])
        falling = 1.0 / (1.0 + np.sum(rest**2, axis=1) / (CAP * (reach * spread)) ** 2)
        weight = self._contacts * (falling / spread) ** 2
        right = gradients + _WEAK * (centre - x)
        np.add.at(right, b, weight[:, None] * rest)
        np.add.at(right, a, -weight[:, None] * rest)
        blocks = sparse.bsr_array((matrices + _WEAK * np.eye(3), own[:-1], own))
        system = sparse.kron(graph_laplacian(self._edges, self._count, weight), np.eye(3)) + blocks
        return x + factored(system).solve(right.ravel()).reshape(-1, 3).clip(-3.0, 3.0)

"""The metric that a frame's normals give the surface, over the nodes of the lattice and along its edges.

Lengths along an edge are those of what lies between its two nodes: half of either cell. Means over whole
cells reach as far again beyond both, and smooth a narrow fold away.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, IntArray, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.slopes import Slopes, metric_sums

_LEAST_WEIGHT = 1e-6  # sum of the slopes' weights from which a metric is known
# Quadrants of a cell, 0 to 3 in the order of reading, on its sides before and after the middle, by axis.
_SIDES = np.array([[[0, 2], [1, 3]], [[0, 1], [2, 3]]])


class MeanMetric(NamedTuple):
    """Weighted means over m pieces of the surface.

    metric: (m, 2, 2), in squared pixels by pixels of the image. slope: (m, 2), by which they recede. weight:
    (m,) of the slopes there, 0 to 1.
    """

    metric: npt.NDArray[np.float64]
    slope: npt.NDArray[np.float64]
    weight: npt.NDArray[np.float64]

    @property
    def steepness(self) -> npt.NDArray[np.float64]:
        """(m,) the squared slope."""
        return np.maximum(np.trace(self.metric, axis1=1, axis2=2) - 2.0, 0.0)

    @property
    def root(self) -> npt.NDArray[np.float64]:
        """(m, 2, 2) the symmetric root of the metric, by Cayley and Hamilton."""
        determinant = np.sqrt(np.linalg.det(self.metric))
        trace = np.sqrt(self.metric[:, 0, 0] + self.metric[:, 1, 1] + 2 * determinant)
        return np.asarray((self.metric + determinant[:, None, None] * np.eye(2)) / trace[:, None, None])


class SurfaceMetric:
    """Reads the metric of one template's lattice in any frame."""

    def __init__(
        self,
        lattice: TemplateLattice,
        camera: Camera,
        positions_px: Points2,
        centres: Points2,
        edges: IntArray,
        along: FloatArray,
    ) -> None:
        """Divide the cells. positions_px: (n, 2) of the template. centres: (m, 2) of its nodes.

        edges: (e, 2) nodes. along: (e, 2) from one to the other, pixels.
        """
        self._camera, self._count = camera, 4 * lattice.count
        right, below = (positions_px > centres[lattice.node_of_vertex]).T
        self._quadrant = (4 * lattice.node_of_vertex + right + 2 * below).astype(np.int32)
        axis = (np.abs(along[:, 1]) > np.abs(along[:, 0])).astype(np.int64)
        onward = (np.where(axis == 0, along[:, 0], along[:, 1]) > 0).astype(np.int64)
        first, second = 4 * edges.T[:, :, None]
        self._between = np.hstack([first + _SIDES[axis, onward], second + _SIDES[axis, 1 - onward]])
        self._vertices = np.bincount(self._quadrant, minlength=self._count)

    def read(self, slopes: Slopes, positions_px: Points2, scale: FloatArray) -> tuple[MeanMetric, MeanMetric]:
        """Return the metric over the nodes, and along the edges, at positions (n, 2).

        scale: (n,) how far the surface is, by how far it is in the template.
        """
        sums = metric_sums(slopes, self._camera, positions_px, scale, self._quadrant, self._count)
        cells = np.arange(self._count).reshape(-1, 4)
        nodes, edges = (_mean(sums, self._vertices, pieces) for pieces in (cells, self._between))
        return nodes, edges


def _mean(sums: FloatArray, vertices: IntArray, pieces: IntArray) -> MeanMetric:
    """Over pieces (m, 4) of so many quadrants; where nothing is known, of a surface that faces the camera."""
    total = sums[pieces].sum(axis=1)
    known = total[:, 5:] > _LEAST_WEIGHT
    means = total / np.maximum(total[:, 5:], _LEAST_WEIGHT)
    metric = np.where(known, means[:, [0, 1, 1, 2]], [1.0, 0.0, 0.0, 1.0]).reshape(-1, 2, 2)
    return MeanMetric(
        metric=metric, slope=means[:, 3:5], weight=total[:, 5] / np.maximum(vertices[pieces].sum(axis=1), 1)
    )

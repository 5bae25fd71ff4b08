"""Motion as one body: an image motion that is affine in the template's points in space.

A rigid body seen from afar moves in the image by an affine map of its points (u, v, depth): that is what a
turn of a head does to an ear behind the cheek's rim, where any continuation of the image motion of the cheek
overshoots. The fit is robust: what deforms, or moves as another body, does not count.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.camera import Camera
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.template import TrackingTemplate

_ROUNDS = 8
_RIDGE = np.array([0.1, 0.1, 0.1, 1e-3])  # in fully seen cells, by unit coordinates: of the whole
_PIECE_RIDGE = np.array([0.3, 0.3, 3.0, 0.03])  # of a piece's own motion beside the whole's
_PIECE_LEAST = 4.0  # fully seen cells that show a motion of their own
_SEEN = 0.3  # weight from which a cell's residual counts for the scale
_LEAST_SCALE_PX = 1.0  # of the residuals; closer fits are not worth more
_SIGMAS = 1.5  # of a normal distribution in the median of its size


class LiftedMotion:
    """Fits one template's motion: that of the whole, and on it that of every piece that hangs together."""

    def __init__(self, lattice: TemplateLattice, template: TrackingTemplate, camera: Camera) -> None:
        """Lay out the coordinates (u, v, depth in pixels, 1), scaled to unit size."""
        depth = template.vertices_in_camera[:, 2]
        relief_px = template.pixels_per_length(camera) * (depth - np.median(depth))
        points = np.column_stack([template.positions_px, relief_px])
        points -= points.mean(axis=0)
        points /= max(float(points[:, :2].std()), 1e-9)
        self._lattice = lattice
        self._vertices = np.column_stack([points, np.ones(len(points))])
        counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        self._nodes = lattice.sums(self._vertices) / counts[:, None]
        links = sp.csr_array(
            (np.ones(len(lattice.neighbours), dtype=np.int8), lattice.neighbours, lattice.starts),
            shape=(lattice.count, lattice.count),
        )
        self._pieces, self._piece = connected_components(links, directed=False)

    def fitted(
        self, displacements: FloatArray, weight: FloatArray
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the motion's displacements at nodes (nodes, k) and vertices (n, k).

        displacements: (nodes, k), measured, pixels. weight: (nodes,) from 0 to 1 how far a node was seen.
        """
        motion = _robust_fit(self._nodes, displacements, weight, _RIDGE)
        at_nodes, at_vertices = self._nodes @ motion, self._vertices @ motion
        seen = np.bincount(self._piece, weight, minlength=self._pieces)
        if self._pieces == 1:
            return at_nodes, at_vertices
        for piece in np.flatnonzero(seen >= _PIECE_LEAST):
            inside = self._piece == piece
            own = displacements[inside] - at_nodes[inside]
            motion = _robust_fit(self._nodes[inside], own, weight[inside], _PIECE_RIDGE)
            at_nodes[inside] += self._nodes[inside] @ motion
            vertices = inside[self._lattice.node_of_vertex]
            at_vertices[vertices] += self._vertices[vertices] @ motion
        return at_nodes, at_vertices


def _robust_fit(
    points: FloatArray, values: FloatArray, weight: FloatArray, ridge: FloatArray
) -> npt.NDArray[np.float64]:
    """Return the (4, k) map of points (m, 4) to values (m, k) by reweighted least squares (Cauchy)."""
    trust = np.asarray(weight, dtype=np.float64)
    counted = weight > _SEEN
    motion: npt.NDArray[np.floating] = np.zeros((points.shape[1], values.shape[1]))
    for _ in range(_ROUNDS):
        weighted = trust[:, None] * points
        motion = np.linalg.solve(points.T @ weighted + np.diag(ridge), weighted.T @ values)
        residual = np.linalg.norm(values - points @ motion, axis=1)
        usual = float(np.median(residual[counted])) if counted.any() else 0.0
        scale = max(_LEAST_SCALE_PX, _SIGMAS * usual)
        trust = weight / (1.0 + (residual / scale) ** 2)
    return np.asarray(motion)

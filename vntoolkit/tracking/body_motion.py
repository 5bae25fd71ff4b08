"""How the surface is taken to move where nothing measures it: as one body.

Seen from afar, a body moves in the image by an affine map of its points (u, v, depth), fitted robustly.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.camera import Camera
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.template import TrackingTemplate

_ROUNDS = 8  # of reweighting in the fit of one body
_RIDGE = np.array([0.1, 0.1, 0.1, 1e-3])  # in measured nodes, by unit coordinates
_LEAST_SCALE_PX = 1.0  # of the fit's residuals; closer fits are not worth more
_SIGMAS = 1.5  # of a normal distribution in the median of its size


class BodyMotion:
    """Moves all nodes of one template's lattice by those that are measured."""

    def __init__(self, lattice: TemplateLattice, template: TrackingTemplate, camera: Camera) -> None:
        """Lay out the nodes as points of a body."""
        points = template.points_px(camera)
        points -= points.mean(axis=0)
        scale = max(float(points[:, :2].std()), 1e-9)
        counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        nodes = lattice.sums(points / scale) / counts[:, None]
        self._nodes = np.column_stack([nodes, np.ones(len(nodes))])

    def fitted(self, displacements: FloatArray, weight: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m, 2) the motion of one body.

        displacements: (m, 2) of the nodes. weight: (m,) from 0 to 1, how far each is known.
        """
        return np.asarray(self._nodes @ _robust_fit(self._nodes, displacements, weight))


def _robust_fit(points: FloatArray, values: FloatArray, weight: FloatArray) -> npt.NDArray[np.float64]:
    """Return the (4, 2) map of points (m, 4) to values (m, 2) by reweighted least squares (Cauchy)."""
    trust = np.asarray(weight, dtype=np.float64)
    counted = weight > 0.3 * float(weight.max(initial=0.0))
    motion: npt.NDArray[np.floating] = np.zeros((points.shape[1], values.shape[1]))
    for _ in range(_ROUNDS):
        weighted = trust[:, None] * points
        motion = np.linalg.solve(points.T @ weighted + np.diag(_RIDGE), weighted.T @ values)
        u, v = (values - points @ motion).T
        residual = np.sqrt(u * u + v * v)  # twenty times as fast as a norm over an axis of two
        usual = float(np.median(residual[counted])) if counted.any() else 0.0
        trust = weight / (1.0 + (residual / max(_LEAST_SCALE_PX, _SIGMAS * usual)) ** 2)
    return np.asarray(motion)

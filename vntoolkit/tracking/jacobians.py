"""Local affine fits of the correspondence: its Jacobian, smooth over a cell and its neighbours."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Points2
from vntoolkit.native import njit
from vntoolkit.tracking.lattice import TemplateLattice

_PASSES = 1  # of lattice smoothing


class LocalJacobians:
    """Fits the Jacobian at every node; what hangs on the template alone is computed once."""

    def __init__(self, lattice: TemplateLattice, pixels: Points2) -> None:
        """Sum the moments of the template's pixels (n, 2)."""
        self._lattice = lattice
        self._centre = pixels.mean(axis=0)
        self._x = pixels - self._centre
        ones = np.ones((len(pixels), 1))
        x, y = self._x[:, :1], self._x[:, 1:]
        sums = lattice.smoothed(lattice.sums(np.hstack([ones, x, y, x * x, x * y, y * y])), _PASSES)
        self._count, self._mean = sums[:, 0], sums[:, 1:3] / sums[:, :1]
        xx = sums[:, 3] - self._count * self._mean[:, 0] ** 2
        xy = sums[:, 4] - self._count * self._mean[:, 0] * self._mean[:, 1]
        yy = sums[:, 5] - self._count * self._mean[:, 1] ** 2
        ridge = self._count  # of one pixel²: a piece too thin to measure keeps the identity
        xx, yy = xx + ridge, yy + ridge
        determinant = xx * yy - xy * xy
        self._inverse = np.stack([yy, -xy, -xy, xx], axis=1).reshape(-1, 2, 2) / determinant[:, None, None]

    def of(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (nodes, 4): ∂u/∂x, ∂u/∂y, ∂v/∂x, ∂v/∂y of positions (n, 2) by the template's pixels."""
        moved = positions_px - self._centre - self._x
        sums = _first_moments(self._lattice.node_of_vertex, self._x, moved, self._lattice.count)
        sums = self._lattice.smoothed(sums, _PASSES)
        mixed = sums[:, 2:].reshape(-1, 2, 2) - sums[:, :2, None] * self._mean[:, None, :]
        return np.asarray((mixed @ self._inverse + np.eye(2)).reshape(-1, 4))


@njit(cache=True)
def _first_moments(node, x, moved, count):  # type: ignore[no-untyped-def]
    out = np.zeros((count, 6))
    for i in range(len(node)):
        for c in range(2):
            out[node[i], c] += moved[i, c]
            out[node[i], 2 + 2 * c] += moved[i, c] * x[i, 0]
            out[node[i], 3 + 2 * c] += moved[i, c] * x[i, 1]
    return out

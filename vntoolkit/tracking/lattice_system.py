"""One least-squares problem on a lattice, laid out once and factored for every frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray, IntArray, Points2
from vntoolkit.tracking.sparse_factor import nested_dissection_order

_LEAST_INFORMATION = 1e-6  # 1/px²: holds pieces of which nothing is known


class LatticeSystem:
    """Σ_nodes (d_i − m_i)ᵀ I_i (d_i − m_i) + Σ_links w_e |d_b − d_a − r_e|², laid out once."""

    def __init__(self, links: IntArray, centres: Points2) -> None:
        """Order the unknowns; links (e, 2) between the nodes at centres (m, 2)."""
        m, (a, b) = len(centres), links.T
        self.links, self.count = links, m
        order = nested_dissection_order(links, centres)
        self.order = (2 * order[:, None] + [0, 1]).ravel()
        rank = np.empty(2 * m, dtype=np.int64)
        rank[self.order] = np.arange(2 * m)
        i = np.arange(m)
        rows = [2 * i, 2 * i, 2 * i + 1, 2 * i + 1, 2 * a, 2 * b, 2 * a + 1, 2 * b + 1]
        columns = [2 * i, 2 * i + 1, 2 * i, 2 * i + 1, 2 * b, 2 * a, 2 * b + 1, 2 * a + 1]
        where = rank[np.concatenate(rows)], rank[np.concatenate(columns)]
        pattern = sp.csc_array(sp.coo_array((np.arange(1.0, len(where[0]) + 1), where)))
        pattern.sort_indices()
        self._place, self._pattern = pattern.data.astype(np.int64) - 1, pattern

    def solve(
        self, information: FloatArray, pull: FloatArray, weight: FloatArray, steps: FloatArray
    ) -> LatticeSolution:
        """Return the minimum; information I (m, 3), pull (m, 2) = I m, weight (e,), steps (e, 2) = r."""
        degree = _LEAST_INFORMATION + self._at_nodes(weight, weight)
        diagonal = [
            information[:, 0] + degree,
            information[:, 1],
            information[:, 1],
            information[:, 2] + degree,
        ]
        data = np.concatenate([*diagonal, *[-weight] * 4])
        pattern = self._pattern
        matrix = sp.csc_array((data[self._place], pattern.indices, pattern.indptr), shape=pattern.shape)
        factor = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        right = np.array(pull, dtype=np.float64)
        for k in range(2):
            right[:, k] += self._at_nodes(-weight * steps[:, k], weight * steps[:, k])
        solution = LatticeSolution(self, factor)
        solution.displacement = solution.solved(right[:, :, None])[:, :, 0]
        return solution

    def filled(self, weight: FloatArray, weighted: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m,) a value known as weighted / weight, harmonic where the weight (m,) is small."""
        information = np.column_stack([weight, np.zeros_like(weight), weight])
        ones, none = np.ones(len(self.links)), np.zeros((len(self.links), 2))
        return self.solve(information, np.column_stack([weighted, weighted]), ones, none).displacement[:, 0]

    def _at_nodes(self, first: FloatArray, second: FloatArray) -> npt.NDArray[np.float64]:
        a, b = self.links.T
        count = self.count
        return np.asarray(np.bincount(a, first, count) + np.bincount(b, second, count), dtype=np.float64)


class LatticeSolution:
    """displacement: (m, 2)."""

    displacement: npt.NDArray[np.float64]

    def __init__(self, system: LatticeSystem, factor) -> None:  # type: ignore[no-untyped-def]
        self._system, self._factor = system, factor

    def solved(self, right: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m, 2, k) for right-hand sides (m, 2, k)."""
        order = self._system.order
        flat = np.empty((2 * self._system.count, right.shape[2]))
        flat[order] = self._factor.solve(np.ascontiguousarray(right.reshape(len(flat), -1)[order]))
        return flat.reshape(right.shape)

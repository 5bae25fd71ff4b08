"""One least-squares problem on a lattice, factored for every frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from vntoolkit.arrays import FloatArray, IntArray
from vntoolkit.geometry.mesh import factored
from vntoolkit.tracking.factors import Factor

_LEAST_INFORMATION = 1e-6  # 1/px²: holds pieces of which nothing is known


class LatticeSystem:
    """One problem of the nodes: measurements of them, and foreseen steps between neighbours.

    The minimum over displacements d and coefficients c of Σ_nodes (d_i − m_i)ᵀ I_i (d_i − m_i) +
    Σ_edges w_e |d_b − d_a − r_e − B_e c|² + Σ_k p_k c_k²: few modes B of the whole are solved for too.
    """

    def __init__(self, edges: IntArray, count: int) -> None:
        """Lay out the differences along edges (e, 2) between count nodes."""
        e, (a, b), ones = len(edges), edges.T, np.ones(len(edges))
        entries = np.r_[ones, -ones], (np.tile(np.arange(e), 2), np.r_[b, a])
        self._differences = sp.csr_array(entries, shape=(e, count))

    def solve(
        self,
        measured: Factor,
        weight: FloatArray,
        steps: FloatArray,
        modes: FloatArray,
        precision: FloatArray | float,
    ) -> LatticeSolution:
        """Return the minimum; measured: of all nodes, by I and I m. weight: w (e,). steps: r (e, 2).

        modes: B (e, 2, k). precision: p, inverse variances (k,) of the coefficients, or one.
        """
        uu, uv, vv = map(sp.diags_array, measured.information.T)
        held = self._laplacian(weight)
        factor = factored(sp.block_array([[held + uu, uv], [uv, held + vv]], format="csc"))
        solution = LatticeSolution(factor, self._differences, weight, modes, precision)
        displacement, left = solution.solved(measured.right_hand_side[:, :, None], steps[:, :, None])
        solution.displacement, solution.left = displacement[:, :, 0], left[:, :, 0]
        return solution

    def filled(self, weight: FloatArray, weighted: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m, k) values known as weighted (m, k) / weight (m,), harmonic where the weight is small."""
        held = self._laplacian(np.ones(self._differences.shape[0]))
        return np.asarray(factored(held + sp.diags_array(weight)).solve(weighted))

    def _laplacian(self, weight: FloatArray) -> sp.csr_array:
        nodes = self._differences.shape[1]
        laplacian = self._differences.T @ sp.diags_array(weight) @ self._differences
        return sp.csr_array(laplacian + _LEAST_INFORMATION * sp.eye_array(nodes))


class LatticeSolution:
    """displacement: (m, 2). left: (e, 2) by how much its differences along edges exceed the steps."""

    displacement: npt.NDArray[np.float64]
    left: npt.NDArray[np.float64]

    def __init__(
        self,
        factor: Any,
        differences: sp.csr_array,
        weight: FloatArray,
        modes: FloatArray,
        precision: FloatArray | float,
    ) -> None:
        self._factor, self._differences, self._weight = factor, differences, weight[:, None, None]
        (e, m), k = differences.shape, modes.shape[2]
        self._moved, self._modes_left = self._without_modes(np.zeros((m, 2, k)), modes)
        self._weighted = (self._weight * modes).reshape(2 * e, k)
        along = self._weighted.T @ self._modes_left.reshape(2 * e, k)
        self._inverse = np.linalg.inv(precision * np.eye(k) - along)

    def solved(
        self, right_hand_side: FloatArray, steps: FloatArray
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return minima (m, 2, n) for n right-hand sides and steps (e, 2, n), and what is left (e, 2, n)."""
        moved, left = self._without_modes(right_hand_side, steps)
        found = self._inverse @ (self._weighted.T @ left.reshape(2 * len(left), steps.shape[2]))
        return moved + self._moved @ found, left + self._modes_left @ found

    def _without_modes(
        self, right_hand_side: FloatArray, steps: FloatArray
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        (e, m), n = self._differences.shape, steps.shape[2]
        of_edges = self._differences.T @ (self._weight * steps).reshape(e, 2 * n)
        right = right_hand_side + of_edges.reshape(right_hand_side.shape)
        by_direction = np.moveaxis(right, 1, 0).reshape(2 * m, n)
        flat = np.moveaxis(self._factor.solve(by_direction).reshape(2, m, n), 0, 1)
        along = (self._differences @ flat.reshape(m, 2 * n)).reshape(steps.shape)
        return flat, along - steps

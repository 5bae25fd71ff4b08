"""One least-squares problem on a lattice, laid out once and factored for every frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray, IntArray
from vntoolkit.tracking.factors import Factor

_SYMMETRIC = {"SymmetricMode": True}
_PANEL = 1  # columns at a time: these grids' are too sparse to share work, a sixth faster than by default
_LEAST_INFORMATION = 1e-6  # 1/px²: holds pieces of which nothing is known


class LatticeSystem:
    """One problem of the nodes: measurements of them, and foreseen steps between neighbours; laid out once.

    The minimum over displacements d and coefficients c of Σ_nodes (d_i − m_i)ᵀ I_i (d_i − m_i) +
    Σ_edges w_e |d_b − d_a − r_e − B_e c|² + Σ_k p_k c_k²: few modes B of the whole are solved for too.
    """

    def __init__(self, edges: IntArray, count: int) -> None:
        """Order the unknowns; edges (e, 2) between count nodes."""
        m, (a, b) = count, edges.T
        self.edges, self.count = edges, m
        order = least_fill(edges, m)
        i = np.arange(m)
        self._by_node = LatticePattern(order, [i, a, b], [i, b, a])
        rows = [2 * i, 2 * i, 2 * i + 1, 2 * i + 1, 2 * a, 2 * b, 2 * a + 1, 2 * b + 1]
        columns = [2 * i, 2 * i + 1, 2 * i, 2 * i + 1, 2 * b, 2 * a, 2 * b + 1, 2 * a + 1]
        self._by_direction = LatticePattern(
            np.stack([2 * order, 2 * order + 1], axis=1).ravel(), rows, columns
        )

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
        information = measured.information
        degree = _LEAST_INFORMATION + self._at_nodes(weight, weight)
        diagonal = [
            information[:, 0] + degree,
            information[:, 1],
            information[:, 1],
            information[:, 2] + degree,
        ]
        factor = self._by_direction.factored([*diagonal, *[-weight] * 4])
        solution = LatticeSolution(self._by_direction, factor, self.edges, weight, modes, precision)
        displacement, left = solution.solved(measured.right_hand_side[:, :, None], steps[:, :, None])
        solution.displacement, solution.left = displacement[:, :, 0], left[:, :, 0]
        return solution

    def filled(self, weight: FloatArray, weighted: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m, k) values known as weighted (m, k) / weight (m,), harmonic where the weight is small."""
        ones = np.ones(len(self.edges))
        degree = _LEAST_INFORMATION + self._at_nodes(ones, ones)
        return self._by_node.solved(self._by_node.factored([weight + degree, -ones, -ones]), weighted)

    def _at_nodes(self, first: FloatArray, second: FloatArray) -> npt.NDArray[np.float64]:
        a, b = self.edges.T
        count = self.count
        return np.asarray(np.bincount(a, first, count) + np.bincount(b, second, count), dtype=np.float64)


def least_fill(edges: IntArray, count: int) -> npt.NDArray[np.int64]:
    """Return the nodes (count,) in an order of elimination by least degree, as SuperLU finds it (`liu1985`).

    It fills in a third less than nested dissection on these small grids, and is sought once.
    """
    a, b = edges.T
    ones = np.ones(len(edges))
    laplacian = sp.csc_array(sp.coo_array((np.tile(-ones, 2), (np.r_[a, b], np.r_[b, a])), (count, count)))
    laplacian = sp.csc_array(laplacian + sp.diags_array(1.0 - laplacian.sum(axis=0)))
    factor = splu(laplacian, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=_SYMMETRIC)
    return np.argsort(factor.perm_c).astype(np.int64)


class LatticePattern:
    """Where the entries of a symmetric matrix go, in the order of elimination (n,)."""

    def __init__(self, order: IntArray, rows: list[IntArray], columns: list[IntArray]) -> None:
        rank = np.empty(len(order), dtype=np.int64)
        rank[order] = np.arange(len(order))
        where = rank[np.concatenate(rows)], rank[np.concatenate(columns)]
        pattern = sp.csc_array(sp.coo_array((np.arange(1.0, len(where[0]) + 1), where)))
        pattern.sort_indices()
        self._place, self._pattern, self._order = pattern.data.astype(np.int64) - 1, pattern, order
        self.count = len(order)

    def factored(self, parts: list[FloatArray]):  # type: ignore[no-untyped-def]
        """Return the factor of the matrix with these entries, as rows and columns were given."""
        data, pattern = np.concatenate(parts)[self._place], self._pattern
        matrix = sp.csc_array((data, pattern.indices, pattern.indptr), shape=pattern.shape)
        return splu(
            matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, panel_size=_PANEL, options=_SYMMETRIC
        )

    def solved(self, factor, right: FloatArray) -> npt.NDArray[np.float64]:  # type: ignore[no-untyped-def]
        """Return (n, k) for right-hand sides (n, k)."""
        flat = np.empty(right.shape)
        flat[self._order] = factor.solve(np.ascontiguousarray(right[self._order]))
        return flat


class LatticeSolution:
    """displacement: (m, 2). left: (e, 2) by how much its differences along edges exceed the steps."""

    displacement: npt.NDArray[np.float64]
    left: npt.NDArray[np.float64]

    def __init__(  # type: ignore[no-untyped-def]
        self,
        pattern: LatticePattern,
        factor,
        edges: IntArray,
        weight: FloatArray,
        modes: FloatArray,
        precision: FloatArray | float,
    ) -> None:
        self._pattern, self._factor = pattern, factor
        m, e, k = pattern.count // 2, len(edges), modes.shape[2]
        (a, b), each = edges.T, np.arange(e)
        ones = np.ones(e)
        self._differences = sp.csr_array((np.r_[ones, -ones], (np.r_[each, each], np.r_[b, a])), (e, m))
        self._weight = weight[:, None, None]
        self._moved, moved_left = self._without_modes(np.zeros((m, 2, k)), modes)
        self._modes_left = moved_left
        self._weighted = (self._weight * modes).reshape(2 * e, k)
        self._inverse = np.linalg.inv(precision * np.eye(k) - self._weighted.T @ moved_left.reshape(2 * e, k))

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
        pulled = self._differences.T @ (self._weight * steps).reshape(e, 2 * n)
        right = right_hand_side + pulled.reshape(right_hand_side.shape)
        flat = self._pattern.solved(self._factor, right.reshape(2 * m, n)).reshape(right.shape)
        along = (self._differences @ flat.reshape(m, 2 * n)).reshape(steps.shape)
        return flat, along - steps

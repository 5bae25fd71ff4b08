"""A sparse symmetric factorisation L D Lᵀ, made once and solved for every frame, and the order it is made in.

SuperLU factors in complex single precision without pivoting; its solve is replaced by a sweep over the
columns of L alone, which reads half the memory and takes all right-hand sides together. The order is that of
A. George, Nested dissection of a regular finite element mesh (`george1973`): cut the vertices in two along
their longer side, eliminate both halves first and the separator last, and so on within the halves. On the
grids tracked here it leaves a factor of about 30 entries per row and costs a few sorts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vntoolkit.arrays import IntArray, Points2
from vntoolkit.errors import SolverFailed
from vntoolkit.native import njit

_NEGLIGIBLE = 1e-7  # what single precision does not see beside 1
_LEAF_SIZE = 24
_FIRST, _SECOND, _SEPARATOR = 0, 1, 2


@dataclass(frozen=True, kw_only=True, eq=False)
class SymmetricFactor:
    """A = P (L D Lᵀ) Pᵀ of a complex symmetric (not Hermitian) matrix.

    order: (n,) vertex at each elimination step. starts, rows, values: L below its unit diagonal, by
    columns. inverse_diagonal: (n,) 1 / D.
    """

    order: npt.NDArray[np.int64]
    starts: npt.NDArray[np.int64]
    rows: npt.NDArray[np.int32]
    values: npt.NDArray[np.complex64]
    inverse_diagonal: npt.NDArray[np.complex64]

    @property
    def bytes(self) -> int:
        """Memory of the factor."""
        return int(self.starts.nbytes + self.rows.nbytes + self.values.nbytes + self.inverse_diagonal.nbytes)

    def imaginary_solve(self, right: npt.NDArray[np.floating]) -> npt.NDArray[np.float32]:
        """Return Im(A⁻¹ right) for real right-hand sides (n, k), float32."""
        n, k = right.shape
        work = np.zeros((n, k + k % 2), dtype=np.float32)
        work[:, :k] = right[self.order]
        result = np.empty((n, k), dtype=np.float32)
        for first in range(0, k, 2):
            pair = work[:, first : first + 2].astype(np.complex64)
            _sweep(self.starts, self.rows, self.values, self.inverse_diagonal, pair)
            result[self.order, first : first + 2] = pair.imag[:, : k - first]
        return result


def factor_symmetric(matrix: sp.csr_array, order: IntArray) -> SymmetricFactor:
    """Factor a complex symmetric matrix (n, n) in the given elimination order, without pivoting.

    Safe for L − iβI with L symmetric positive semi-definite: all leading minors are regular. Raises
    SolverFailed if SuperLU had to leave the diagonal.
    """
    permuted = sp.csc_array(matrix[order][:, order], dtype=np.complex64)
    try:
        lu = splu(permuted, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:  # exactly singular
        lu = None
    if lu is None or not np.array_equal(lu.perm_c, lu.perm_r):
        raise SolverFailed(
            "factorisation: a pivot vanished; the mesh's Laplacian is not positive semi-definite"
        )
    steps = np.empty(len(order), dtype=np.int64)
    steps[lu.perm_c] = np.asarray(order, dtype=np.int64)
    diagonal = lu.U.diagonal()
    lower = sp.tril(lu.L, k=-1, format="csc")
    lower.data[np.abs(lower.data) < _NEGLIGIBLE] = 0  # beside the unit diagonal: a fifth of all entries
    lower.eliminate_zeros()
    lower.sort_indices()
    return SymmetricFactor(
        order=steps,
        starts=lower.indptr.astype(np.int64),
        rows=lower.indices.astype(np.int32),
        values=lower.data.astype(np.complex64),
        inverse_diagonal=(1.0 / diagonal).astype(np.complex64),
    )


@njit(cache=True, fastmath=True)
def _sweep(starts, rows, values, inverse_diagonal, x):  # type: ignore[no-untyped-def]
    """Solve L D Lᵀ x = x in place, (n, 2) complex64; both columns stay in registers."""
    n = x.shape[0]
    for column in range(n):
        a, b = x[column, 0], x[column, 1]
        for p in range(starts[column], starts[column + 1]):
            row, value = rows[p], values[p]
            x[row, 0] -= value * a
            x[row, 1] -= value * b
    for column in range(n - 1, -1, -1):
        a = x[column, 0] * inverse_diagonal[column]
        b = x[column, 1] * inverse_diagonal[column]
        for p in range(starts[column], starts[column + 1]):
            row, value = rows[p], values[p]
            a -= value * x[row, 0]
            b -= value * x[row, 1]
        x[column, 0], x[column, 1] = a, b


def nested_dissection_order(edges: IntArray, positions: Points2) -> npt.NDArray[np.int64]:
    """Return the (n,) vertices in elimination order.

    edges: (e, 2) vertex indices. positions: (n, 2), where the vertices lie (only the order along the two
    axes matters). All parts of one level are cut together, so the work is a few sorts per level.
    """
    count = len(positions)
    levels = max(int(np.ceil(np.log2(max(count, 2) / _LEAF_SIZE))), 0)
    path = np.zeros(count, dtype=np.int64)  # two bits a level: which half, or the separator
    active = np.ones(count, dtype=bool)
    first, second = np.asarray(edges, dtype=np.int64).reshape(-1, 2).T
    for level in range(levels):
        members = np.flatnonzero(active)
        if not members.size:
            break
        half = _halves(path, members, positions)
        crossing = half[first] != half[second]
        separator = np.where(half[first[crossing]] == _FIRST, first[crossing], second[crossing])
        half[separator] = _SEPARATOR
        path[members] |= half[members] << (2 * (levels - 1 - level))
        active[separator] = False
        keep = ~crossing & active[first] & active[second]
        first, second = first[keep], second[keep]
    return np.lexsort((positions[:, 0], positions[:, 1], path))


def _halves(path: IntArray, members: IntArray, positions: Points2) -> npt.NDArray[np.int64]:
    """Split every part at the median of its longer axis; return 0 or 1 per vertex, of `members` only."""
    order = members[np.argsort(path[members], kind="stable")]
    part = path[order]
    starts = np.flatnonzero(np.concatenate([[True], part[1:] != part[:-1]]))
    sizes = np.diff(np.append(starts, len(order)))
    at = positions[order]
    extent = np.maximum.reduceat(at, starts) - np.minimum.reduceat(at, starts)
    along_v = np.repeat(extent[:, 1] > extent[:, 0], sizes)
    coordinate = np.where(along_v, at[:, 1], at[:, 0])
    sorted_within = np.lexsort((coordinate, np.repeat(np.arange(len(starts)), sizes)))
    median = coordinate[sorted_within][starts + sizes // 2]
    half = np.zeros(len(path), dtype=np.int64)
    half[order] = np.where(coordinate >= np.repeat(median, sizes), _SECOND, _FIRST)
    return half

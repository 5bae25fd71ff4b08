"""The paper's translation regulariser, solved by Chebyshev's semi-iteration on Jacobi's."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.laplacian import graph_laplacian
from vntoolkit.native import njit

_RELATIVE_TOLERANCE = 1e-5


class TranslationRegulariser:
    """Minimises α Σ |t_i − d_i|² + (1 − α) Σ_ij |t_i − t_j|² over the vertices' translations t.

    Section V of `brostow2011`. The normal equations (α I + (1 − α) L) t = α d, L the uniform Laplacian, need
    no factor: their condition number is at most (α + 2 (1 − α) degree) / α, under 2 on a grid at α = 0.9.
    α carries the DATA term: α = 0.9 smooths over sqrt((1 − α) / α) = 1/3 of an edge, hardly at all. If it
    carried the other term it would be 3 edges.
    """

    def __init__(self, edges: npt.NDArray[np.int32], vertex_count: int, data_share: float) -> None:
        """Lay out the neighbours; edges (e, 2), each once."""
        adjacency = sp.csr_array(-graph_laplacian(edges, vertex_count))
        adjacency.setdiag(0)
        adjacency.eliminate_zeros()
        self._starts = adjacency.indptr.astype(np.int64)
        self._neighbours = adjacency.indices.astype(np.int32)
        self._share = data_share
        degree = int(np.diff(self._starts).max(initial=0))
        # Jacobi's iteration matrix has eigenvalues within ± this
        self._radius = (1 - data_share) * degree / (data_share + (1 - data_share) * degree)
        self.sweeps = _sweeps(self._radius)

    def solve(self, translations: FloatArray) -> npt.NDArray[np.float64]:
        """Return the regularised translations (n, k) of the measured ones (n, k)."""
        data = np.ascontiguousarray(translations, dtype=np.float64)
        if self.sweeps == 0:
            return data.copy()
        return _chebyshev(self._starts, self._neighbours, data, self._share, self._radius, self.sweeps)


def _sweeps(radius: float) -> int:
    """Sweeps until Chebyshev's bound 2 c^k on the relative error passes the tolerance."""
    if radius <= 0:
        return 0
    contraction = radius / (1 + np.sqrt(1 - radius**2))
    return int(np.ceil(np.log(_RELATIVE_TOLERANCE / 2) / np.log(contraction)))


@njit(cache=True)
def _chebyshev(starts, neighbours, data, share, radius, sweeps):  # type: ignore[no-untyped-def]
    n, k = data.shape
    before, now, after = data.copy(), data.copy(), np.empty_like(data)
    omega = 1.0
    for sweep in range(sweeps):
        if sweep == 1:
            omega = 1.0 / (1.0 - 0.5 * radius * radius)
        elif sweep > 1:
            omega = 1.0 / (1.0 - 0.25 * radius * radius * omega)
        for i in range(n):
            degree = starts[i + 1] - starts[i]
            scale = 1.0 / (share + (1.0 - share) * degree)
            for c in range(k):
                total = 0.0
                for p in range(starts[i], starts[i + 1]):
                    total += now[neighbours[p], c]
                jacobi = (share * data[i, c] + (1.0 - share) * total) * scale
                after[i, c] = omega * (jacobi - before[i, c]) + before[i, c]
        before, now, after = now, after, before
    return now

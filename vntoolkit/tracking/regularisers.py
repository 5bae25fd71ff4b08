"""The regularisers of the paper, and Open3D's deformation beside them, each solved for every frame.

Equation 7 is solved by a sparse symmetric factorisation L D Lᵀ, made once. SuperLU factors in complex single
precision without pivoting; its solve is replaced by a sweep over the columns of L alone, which reads half the
memory and takes all right-hand sides together. The order is that of A. George, Nested dissection of a regular
finite element mesh (`george1973`): cut the vertices in two along their longer side, eliminate both halves
first and the separator last, and so on within the halves. On the grids tracked here it leaves a factor of
about 30 entries per row and costs a few sorts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray, IntArray, Points, Points2
from vntoolkit.errors import SolverFailed
from vntoolkit.geometry.mesh import Mesh, graph_laplacian
from vntoolkit.native import import_open3d, njit
from vntoolkit.tracking.template import TrackingTemplate

_NEGLIGIBLE = 1e-7  # what single precision does not see beside 1
_LEAF_SIZE = 24  # vertices that are not cut further
_FIRST, _SECOND, _SEPARATOR = 0, 1, 2
_RELATIVE_TOLERANCE = 1e-5  # of the translation regulariser's solution
_ARAP_ITERATIONS = 5
_HANDLE_SPACING_PX = 8  # of the vertices that ARAP is told where to go


def beta_from_smoothing_length(length_in_edges: float) -> float:
    """Return β (1/edge²) that smooths over `length_in_edges`: β = 1.5 / length².

    L has no unit on unit weights (edges count 1 whatever their length), so β is free of the mesh's scale.
    The filter on a wave of k radians per edge is β² / (k⁴ + β²): half at a wavelength of 5.1 lengths. The
    paper's β = 1e-3 is a length of 39 edges, under which all but the longest waves are rigid.
    """
    return 1.5 / max(length_in_edges, 1e-3) ** 2


class LaplacianRegulariser:
    """Equation 7: least squares of [L; βI] X = [Q; βY] with Q = L X⁰.

    With L symmetric the solution is X = X⁰ + β Im[(L − iβI)⁻¹ (Y − X⁰)], one sparse solve that never forms
    LᵀL, whose conditioning single precision would not survive.
    """

    def __init__(self, laplacian: sp.csr_array, edges: IntArray, positions: Points2, beta: float) -> None:
        """Factor L − iβI; laplacian (n, n) symmetric; edges, positions (n, 2): the graph for the order."""
        self.beta = beta
        self._laplacian = laplacian
        identity = sp.eye_array(laplacian.shape[0], format="csr")
        shifted = sp.csr_array(laplacian - 1j * beta * identity)
        self._factor = factor_symmetric(shifted, nested_dissection_order(edges, positions))

    @property
    def bytes(self) -> int:
        """Memory of the factor."""
        return self._factor.bytes

    def solve(self, offsets: FloatArray) -> npt.NDArray[np.float32]:
        """Return X − X⁰ (n, k) for Y − X⁰ (n, k)."""
        return self.beta * self._factor.imaginary_solve(np.asarray(offsets, dtype=np.float32))


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


class ArapRegulariser:
    """`sorkine2007`, with every k-th pixel as a handle whose target is met exactly."""

    def __init__(self, template: TrackingTemplate, handle_spacing_px: int = _HANDLE_SPACING_PX) -> None:
        """Choose the handles: pixels on a lattice of that spacing, and all of a piece that it passes by."""
        self._faces = template.faces
        on_lattice = np.all(template.pixels % handle_spacing_px == 0, axis=1)
        pieces, piece = _pieces(template)
        is_held = np.bincount(piece, on_lattice, minlength=pieces) > 0
        self._handles = np.flatnonzero(on_lattice | ~is_held[piece])

    def solve(self, vertices: Points, targets: Points) -> npt.NDArray[np.float64]:
        """Return the vertices (n, 3) deformed so that the handles lie at their targets (n, 3)."""
        o3d = import_open3d()
        mesh = Mesh(vertices=vertices, faces=self._faces).to_open3d()
        deformed = mesh.deform_as_rigid_as_possible(
            o3d.utility.IntVector(self._handles.astype(np.int32)),
            o3d.utility.Vector3dVector(np.asarray(targets, dtype=np.float64)[self._handles]),
            max_iter=_ARAP_ITERATIONS,
        )
        return np.asarray(deformed.vertices)


def _pieces(template: TrackingTemplate) -> tuple[int, npt.NDArray[np.int32]]:
    """Return how many pieces the triangles make, and the piece of each vertex (n,)."""
    count = len(template.pixels)
    corners = template.faces[:, [0, 1, 2]].ravel(), template.faces[:, [1, 2, 0]].ravel()
    links = sp.coo_array((np.ones(len(corners[0]), dtype=np.int8), corners), shape=(count, count))
    pieces, piece = connected_components(links, directed=False)
    return int(pieces), piece


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

"""The regularisers of the paper, and Open3D's deformation beside them, each solved for every frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray, IntArray, Points, Points2
from vntoolkit.geometry.mesh import Mesh, graph_laplacian
from vntoolkit.native import import_open3d, njit
from vntoolkit.tracking.sparse_factor import factor_symmetric, nested_dissection_order
from vntoolkit.tracking.template import TrackingTemplate

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

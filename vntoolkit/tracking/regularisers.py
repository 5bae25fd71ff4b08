"""The regularisers of the paper, and Open3D's deformation beside them, each solved for every frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.geometry.mesh import Mesh, factored, graph_laplacian
from vntoolkit.libraries import import_open3d
from vntoolkit.tracking.template import TrackingTemplate

PAPERS_DATA_SHARE = 0.9  # α, of the translation method
# β, 1/edge². L has no unit on unit weights: edges count 1 whatever their length. The filter on a wave of k
# radians per edge is β² / (k⁴ + β²): all but waves of some 200 edges and more are rigid.
PAPERS_BETA = 1e-3
_ARAP_ITERATIONS = 5
_HANDLE_SPACING_PX = 8  # of the vertices that ARAP is told where to go


class LaplacianRegulariser:
    """Equation 7: least squares of [L; βI] X = [Q; βY] with Q = L X⁰.

    With L symmetric the solution is X = X⁰ + β Im[(L − iβI)⁻¹ (Y − X⁰)], one sparse solve that never forms
    LᵀL, whose condition number is the square of this matrix's.
    """

    def __init__(self, laplacian: sp.csr_array, beta: float) -> None:
        """Factor L − iβI; laplacian (n, n) symmetric."""
        self.beta = beta
        self._factor = factored(laplacian - 1j * beta * sp.eye_array(laplacian.shape[0]))

    def solve(self, offsets: FloatArray) -> npt.NDArray[np.float64]:
        """Return X − X⁰ (n, k) for Y − X⁰ (n, k)."""
        return np.asarray(self.beta * self._factor.solve(np.asarray(offsets, dtype=np.complex128)).imag)


class TranslationRegulariser:
    """Minimises α Σ |t_i − d_i|² + (1 − α) Σ_ij |t_i − t_j|² over the vertices' translations t.

    Section V of `brostow2011`. The normal equations are (α I + (1 − α) L) t = α d, L the uniform Laplacian.
    α carries the DATA term: α = 0.9 smooths over sqrt((1 − α) / α) = 1/3 of an edge, hardly at all. If it
    carried the other term it would be 3 edges.
    """

    def __init__(self, edges: npt.NDArray[np.int32], vertex_count: int, data_share: float) -> None:
        """Factor the normal equations; edges (e, 2), each once."""
        laplacian = graph_laplacian(edges, vertex_count)
        self._share = data_share
        self._factor = factored(data_share * sp.eye_array(vertex_count) + (1.0 - data_share) * laplacian)

    def solve(self, translations: FloatArray) -> npt.NDArray[np.float64]:
        """Return the regularised translations (n, k) of the measured ones (n, k)."""
        return np.asarray(self._share * self._factor.solve(np.asarray(translations, dtype=np.float64)))


class ArapRegulariser:
    """`sorkine2007`, with every k-th pixel as a handle whose target is met exactly."""

    def __init__(self, template: TrackingTemplate) -> None:
        """Choose the handles: pixels on a lattice, and all of a piece that it passes by."""
        self._faces = template.faces
        on_lattice = np.all(template.pixels % _HANDLE_SPACING_PX == 0, axis=1)
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
    edges = sp.coo_array((np.ones(len(corners[0]), dtype=np.int8), corners), shape=(count, count))
    pieces, piece = connected_components(edges, directed=False)
    return int(pieces), piece

"""Laplacian coordinates, equation 7 of `brostow2011`, factored once and solved for every frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from vntoolkit.arrays import FloatArray, IntArray, Points2
from vntoolkit.tracking.dissection import nested_dissection_order
from vntoolkit.tracking.factor import factor_symmetric

_CG_TOLERANCE = 2e-3  # of the right-hand side: a vertex that steps 2 px is then right to 0.004 px
_CG_STEPS = 8


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

    def solve_weighted(
        self, offsets: FloatArray, weights: FloatArray, start: FloatArray | None = None
    ) -> npt.NDArray[np.float64]:
        """Return X − X⁰ where vertex i has data weight (β w_i)², weights (n,) from 0 to 1.

        Conjugate gradients on L² + β²W² in double precision, preconditioned by the unweighted factor.
        """
        square = (self.beta * np.asarray(weights, dtype=np.float64)[:, None]) ** 2
        right = square * np.asarray(offsets, dtype=np.float64)
        x = np.array(self.solve(offsets) if start is None else start, dtype=np.float64)
        residual = right - self._normal(x, square)
        goal = (_CG_TOLERANCE**2) * np.maximum(np.sum(right * self._precondition(right), axis=0), 1e-30)
        direction = np.zeros_like(x)
        energy = np.ones(x.shape[1])
        for _ in range(_CG_STEPS):
            preconditioned = self._precondition(residual)
            new_energy = np.sum(residual * preconditioned, axis=0)
            if np.all(new_energy <= goal):
                break
            direction = preconditioned + direction * (new_energy / energy)
            image = self._normal(direction, square)
            step = new_energy / np.maximum(np.sum(direction * image, axis=0), 1e-300)
            x += step * direction
            residual -= step * image
            energy = np.maximum(new_energy, 1e-300)
        return x

    def _normal(self, x: FloatArray, square: FloatArray) -> npt.NDArray[np.float64]:
        return self._laplacian @ (self._laplacian @ x) + square * x

    def _precondition(self, x: FloatArray) -> npt.NDArray[np.float64]:
        scaled = x / self.beta**2  # of the size of an offset: single precision has room
        return self.solve(scaled).astype(np.float64)

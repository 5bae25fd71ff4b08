"""Displacements of lattice nodes: measured where there is texture, interpolated elsewhere."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.native import njit
from vntoolkit.tracking.lattice import TemplateLattice

_STEPS = 25
_FLOOR = 1e-4  # share of the mean information that holds every node at zero where nobody knows


def solve_on_lattice(
    lattice: TemplateLattice, terms: FloatArray, stiffness: float
) -> npt.NDArray[np.float64]:
    """Return (nodes, 2) minimising Σ dᵀA d − 2 bᵀd + μ Σ_ij |d_i − d_j|².

    terms: (nodes, 5) A_uu, A_uv, A_vv, b_u, b_v. μ is `stiffness` times the mean of A's diagonal. Conjugate
    gradients with the 2 × 2 diagonal blocks as preconditioner; nodes are few, so it takes a millisecond.
    """
    mean = 0.5 * float(np.mean(terms[:, 0] + terms[:, 2]))
    if not mean > 0:
        return np.zeros((lattice.count, 2))
    scaled = np.ascontiguousarray(terms / mean)
    return _conjugate_gradients(lattice.starts, lattice.neighbours, scaled, stiffness, _FLOOR, _STEPS)


@njit(cache=True)
def _apply(starts, neighbours, terms, stiffness, floor, x, out):  # type: ignore[no-untyped-def]
    for i in range(x.shape[0]):
        degree = starts[i + 1] - starts[i]
        own = floor + stiffness * degree
        a = terms[i, 0] * x[i, 0] + terms[i, 1] * x[i, 1] + own * x[i, 0]
        b = terms[i, 1] * x[i, 0] + terms[i, 2] * x[i, 1] + own * x[i, 1]
        for p in range(starts[i], starts[i + 1]):
            a -= stiffness * x[neighbours[p], 0]
            b -= stiffness * x[neighbours[p], 1]
        out[i, 0], out[i, 1] = a, b


@njit(cache=True)
def _precondition(starts, terms, stiffness, floor, r, out):  # type: ignore[no-untyped-def]
    for i in range(r.shape[0]):
        own = floor + stiffness * (starts[i + 1] - starts[i])
        a, b, c = terms[i, 0] + own, terms[i, 1], terms[i, 2] + own
        determinant = a * c - b * b
        out[i, 0] = (c * r[i, 0] - b * r[i, 1]) / determinant
        out[i, 1] = (a * r[i, 1] - b * r[i, 0]) / determinant


@njit(cache=True)
def _conjugate_gradients(starts, neighbours, terms, stiffness, floor, steps):  # type: ignore[no-untyped-def]
    x = np.zeros((terms.shape[0], 2))
    r = terms[:, 3:5].copy()
    z, image = np.empty_like(x), np.empty_like(x)
    _precondition(starts, terms, stiffness, floor, r, z)
    direction = z.copy()
    energy = np.sum(r * z)
    goal = 1e-8 * energy
    for _ in range(steps):
        if energy <= goal or energy <= 0:
            break
        _apply(starts, neighbours, terms, stiffness, floor, direction, image)
        step = energy / np.sum(direction * image)
        x += step * direction
        r -= step * image
        _precondition(starts, terms, stiffness, floor, r, z)
        new_energy = np.sum(r * z)
        direction = z + (new_energy / energy) * direction
        energy = new_energy
    return x

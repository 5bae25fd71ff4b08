"""Where unseen parts of the template are: carried along by what is seen around them.

The displacement from the template of what is seen goes on into what is not as a thin plate does, which bends
as little as it can: a turn, a stretch and a shift go on as they are. Since the displacement is from the
template, not from the frame before, no error adds up while a part is hidden, and when it comes back it is
looked for where it then must be about.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray
from vntoolkit.tracking.lattice import TemplateLattice

_BENDING = 0.5  # energy of a unit second difference, where a fully seen cell that is a unit off costs 1
_STRETCHING = 0.01  # of a unit first difference: far from all that is seen the slope fades out
_LEAST_WEIGHT = 1e-9  # holds pieces of the surface of which nothing is seen
_UNSEEN_BELOW, _SEEN_ABOVE = 0.25, 0.75  # confidence


class Extrapolation:
    """Extrapolates displacements over one template's lattice."""

    def __init__(self, lattice: TemplateLattice) -> None:
        """Lay out the bending energy; cells that hang together through the surface only."""
        self._lattice = lattice
        counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        self._whole = float(counts.max(initial=1))
        bending, stretching = _second_differences(lattice), _first_differences(lattice)
        self._energy = sp.csc_array(
            _BENDING * (bending.T @ bending) + _STRETCHING * (stretching.T @ stretching)
        )

    def carried(self, displacements: FloatArray, confidence: FloatArray) -> npt.NDArray[np.float64]:
        """Return displacements (n, k) from the template; those of low confidence (n,) from the plate."""
        seen = seen_share(confidence)[:, None]
        sums = self._lattice.sums(np.hstack([seen * displacements, seen]))
        if not np.any(sums[:, -1] > 0):
            return np.array(displacements, dtype=np.float64)
        weight = (sums[:, -1] / self._whole) ** 2 + _LEAST_WEIGHT
        means = sums[:, :-1] / np.maximum(sums[:, -1:], 1e-12)
        system = sp.csc_array(self._energy + sp.diags_array(weight))
        factor = splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        plate = self._lattice.at_vertices(factor.solve(weight[:, None] * means))
        return np.asarray(plate + seen * (displacements - plate))


def seen_share(confidence: FloatArray) -> npt.NDArray[np.float64]:
    """Return (n,) 0 where the flow is not to be believed, 1 where it is, smooth between."""
    share = np.clip(
        (np.asarray(confidence, dtype=np.float64) - _UNSEEN_BELOW) / (_SEEN_ABOVE - _UNSEEN_BELOW), 0.0, 1.0
    )
    return np.asarray(share * share * (3 - 2 * share))


def _sides(lattice: TemplateLattice) -> tuple[sp.csr_array, sp.csr_array]:
    """Adjacency (nodes, nodes) of a node and those to its right, and of a node and those below it."""
    rows = np.repeat(np.arange(lattice.count), np.diff(lattice.starts))
    columns = lattice.neighbours
    step = lattice.cells[columns] - lattice.cells[rows]
    ones = np.ones(len(rows))
    shape = (lattice.count, lattice.count)
    right, below = step[:, 0] == 1, step[:, 1] == 1
    return (
        sp.csr_array((ones[right], (rows[right], columns[right])), shape=shape),
        sp.csr_array((ones[below], (rows[below], columns[below])), shape=shape),
    )


def _first_differences(lattice: TemplateLattice) -> sp.csr_array:
    pairs = [np.stack(side.nonzero(), axis=1) for side in _sides(lattice)]
    return _rows(np.concatenate(pairs), (-1.0, 1.0), lattice.count)


def _second_differences(lattice: TemplateLattice) -> sp.csr_array:
    """Of every three nodes in a line, and of every four in a square (twice, as the plate's twist counts)."""
    right, below = _sides(lattice)
    lines = [_rows(_chains(side, side), (1.0, -2.0, 1.0), lattice.count) for side in (right, below)]
    over, under = _chains(right, below), _chains(below, right)  # (a, b, d) and (a, c, d)
    by_ends: dict[tuple[int, int], list[int]] = {}
    for a, c, d in under.tolist():
        by_ends.setdefault((a, d), []).append(c)
    squares = np.array(
        [(a, b, c, d) for a, b, d in over.tolist() for c in by_ends.get((a, d), [])], dtype=np.int64
    ).reshape(-1, 4)
    twist = _rows(squares, (1.0, -1.0, -1.0, 1.0), lattice.count)
    return sp.csr_array(sp.vstack([*lines, np.sqrt(2.0) * twist]))


def _chains(first: sp.csr_array, second: sp.csr_array) -> npt.NDArray[np.int64]:
    """Return (k, 3) nodes a, b, c with b beside a by `first` and c beside b by `second`."""
    a, b = first.nonzero()
    counts = np.diff(second.indptr)[b]
    starts = np.repeat(second.indptr[b], counts)
    within = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    c = second.indices[starts + within]
    return np.stack([np.repeat(a, counts), np.repeat(b, counts), c], axis=1).astype(np.int64)


def _rows(nodes: npt.NDArray[np.integer], signs: tuple[float, ...], count: int) -> sp.csr_array:
    """Return the matrix (k, count) whose rows hold `signs` at the nodes (k, len(signs))."""
    k = len(nodes)
    rows = np.repeat(np.arange(k), len(signs))
    return sp.csr_array((np.tile(signs, k), (rows, nodes.ravel())), shape=(k, count))

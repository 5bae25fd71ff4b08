"""Extrapolation of the hidden parts of the template from the visible parts around them.

Three guesses say how the displacement from the template goes on into what is not seen: it stays, right across
a seam; it is the motion of one body (`LiftedMotion`), right for a head that turns; lengths stay (`Isometry`),
right for cloth that folds. On every link between two cells that are both seen, all are put to the test; each
counts, there and nearby, by how well it did. What they leave bends as little as it can, as a thin plate.
What lies still though nothing near does (`RestingParts`) holds it too.
Since the displacement is from the template, not from the frame before, no error adds up while a part is
hidden, and when it comes back it is looked for where it then must be about.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.camera import Camera
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.lifted_motion import LiftedMotion
from vntoolkit.tracking.template import TrackingTemplate

_BENDING = 0.1  # energy of a unit second difference, where a fully seen cell that is a unit off costs 1
_STRETCHING = 1.0  # of a unit first difference that departs from the guess
_GOOD_SQUARE = 0.1  # px²: guesses that err by more per cell bind the less
_LEAST_WEIGHT = 1e-9  # holds pieces of the surface of which nothing is seen
_SEEN_WEIGHT = 0.2  # of a cell, from which it is not asked whether it lies still
_UNSEEN_BELOW, _SEEN_ABOVE = 0.25, 0.75  # confidence
_NEAR_PASSES = 12  # of lattice smoothing: how far around a guess's success counts
_FAR_SHARE = 1e-3  # of the mean over the whole template, where nothing near was put to the test
_LARGEST_SQUARE = 4.0  # px²: a guess that is further off than 2 px per cell is just wrong
_SQUARE_NOISE = 0.02  # px² of the measured differences themselves

Stretch = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]  # Jacobians (nodes, 2, 2), trust (nodes,)


class Extrapolation:
    """Extrapolates displacements over one template's lattice."""

    def __init__(self, lattice: TemplateLattice, template: TrackingTemplate, camera: Camera) -> None:
        """Lay out the bending energy; cells that hang together through the surface only."""
        self._lattice = lattice
        counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        self._whole = float(counts.max(initial=1))
        self._centres = lattice.sums(template.positions_px) / counts[:, None]
        self._links = np.concatenate([np.stack(side.nonzero(), axis=1) for side in _sides(lattice)])
        self._differences = _rows(self._links, (-1.0, 1.0), lattice.count)
        bending = _second_differences(lattice)
        self._bending = sp.csc_array(_BENDING * (bending.T @ bending))
        self._motion = LiftedMotion(lattice, template, camera)
        self._depth = template.vertices_in_camera[:, 2]
        self._pixels_per_length = template.pixels_per_length(camera)

    def carried(
        self,
        displacements: FloatArray,
        confidence: FloatArray,
        stretch: Stretch | None = None,
        rest: FloatArray | None = None,
    ) -> npt.NDArray[np.float64]:
        """Return displacements (n, k) from the template, pixels; those of low confidence (n,) from the plate.

        stretch: Jacobians of positions in the image that lengths on the surface ask for, and their trust.
        rest: (nodes,) how surely a cell lies still; it counts where the cell is not seen.
        """
        seen = seen_share(confidence)[:, None]
        sums = self._lattice.sums(np.hstack([seen * displacements, seen]))
        if not np.any(sums[:, -1] > 0):
            return np.array(displacements, dtype=np.float64)
        weight = (sums[:, -1] / self._whole) ** 2
        means = sums[:, :-1] / np.maximum(sums[:, -1:], 1e-12)
        at_nodes, at_vertices = self._motion.fitted(means, weight)
        if rest is not None:
            still = rest * np.maximum(0.0, 1.0 - weight / _SEEN_WEIGHT)
            means *= (weight / np.maximum(weight + still, 1e-12))[:, None]
            weight = weight + still
        own = means - at_nodes
        steps, strength = self._expected_steps(stretch, at_nodes, own, weight)
        differences = self._differences
        system = sp.csc_array(
            self._bending
            + differences.T @ sp.diags_array(strength) @ differences
            + sp.diags_array(weight + _LEAST_WEIGHT)
        )
        right = weight[:, None] * own + differences.T @ (strength[:, None] * steps)
        factor = splu(system, permc_spec="MMD_AT_PLUS_A", options={"SymmetricMode": True})
        plate = at_vertices + self._lattice.at_vertices(factor.solve(right))
        return np.asarray(plate + seen * (displacements - plate))

    def carried_depth(self, depth: FloatArray, confidence: FloatArray) -> npt.NDArray[np.float64]:
        """Return depths (n,); those of low confidence (n,) from the plate, their changes judged in pixels."""
        offsets = self._pixels_per_length * (depth - self._depth)[:, None]
        return np.asarray(self._depth + self.carried(offsets, confidence)[:, 0] / self._pixels_per_length)

    def _expected_steps(
        self, stretch: Stretch | None, motion: FloatArray, own: FloatArray, weight: FloatArray
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return (links, k), by how much more than the motion as one body a displacement changes along each.

        The mean of the guesses, each by the inverse square of its mean squared error; and how strongly it
        binds, (links,).
        """
        first, second = self._links.T
        seen = np.minimum(weight[first], weight[second]) > 0.5
        measured, by_motion = own[second] - own[first], motion[second] - motion[first]
        whole = np.ones(len(seen))
        guesses = [(np.zeros_like(measured), whole), (-by_motion, whole)]  # one body, no change at all
        if stretch is not None:
            jacobians, trust = stretch
            along = self._centres[second] - self._centres[first]
            mean = 0.5 * (jacobians[first] + jacobians[second])
            by_lengths = np.einsum("eab,eb->ea", mean, along) - along
            guesses.append((by_lengths - by_motion, np.minimum(trust[first], trust[second])))
        total, shares, errors = np.zeros_like(measured), 1e-12 * whole, np.zeros(len(seen))
        for steps, trusted in guesses:
            error = self._mean_square(measured - steps, seen & (trusted > 0.5))
            share = trusted / error**2
            total += share[:, None] * steps
            shares += share
            errors += share * error
        return total / shares[:, None], _STRETCHING * np.minimum(1.0, _GOOD_SQUARE * shares / errors)

    def _mean_square(self, error: FloatArray, tested: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
        """Return (links,) the mean squared error (links, k) of the links tested around each, bounded."""
        square = np.minimum(np.sum(error[tested] ** 2, axis=1), _LARGEST_SQUARE)
        sums = np.zeros((self._lattice.count, 2))
        for end in self._links[tested].T:
            sums[:, 0] += np.bincount(end, square, minlength=len(sums))
            sums[:, 1] += np.bincount(end, minlength=len(sums))
        total, count = sums.sum(axis=0)
        overall = total / count if count else _LARGEST_SQUARE
        near = self._lattice.smoothed(sums, _NEAR_PASSES)
        far = _FAR_SHARE * max(float(near[:, 1].max(initial=0.0)), 1e-9)
        mean = (near[:, 0] + far * overall) / (near[:, 1] + far) + _SQUARE_NOISE
        return np.asarray(0.5 * (mean[self._links[:, 0]] + mean[self._links[:, 1]]))


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

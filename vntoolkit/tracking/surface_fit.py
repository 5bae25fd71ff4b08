"""Where the template is in one frame: all that tells it, each with its information, solved for together.

The unknowns are the displacements of the nodes of a lattice. Relief and shape (`registration`), the outline
(`outline`) and lengths on the surface (`lengths`) enter one linear least-squares problem a step, each
with the inverse of its covariance, so that none acts where or in what direction it knows nothing. The
expected error is that of the same problem: errors are drawn for every term and solved with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray, IntArray, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.flow import dense_flow
from vntoolkit.tracking.lattice import LocalJacobians, TemplateLattice, lattice_on_template
from vntoolkit.tracking.lengths import LinkLengths
from vntoolkit.tracking.outline import Outline
from vntoolkit.tracking.registration import Measurement, TemplateRegistration
from vntoolkit.tracking.slopes import Slopes, sample_depth, sample_image, slopes_from_normals
from vntoolkit.tracking.sparse_factor import nested_dissection_order
from vntoolkit.tracking.template import TrackingTemplate

_CELL_PX = 8  # of the lattice
_ITERATIONS = 3
_CONVERGED_PX = 0.03  # largest step after which no other follows
_TORN_SIGMAS = 3.0  # departure of a link from its length at which it holds half as much
_LEAST_SINGULAR = 0.2  # of a Jacobian: steps are not taken through a surface seen more nearly edge-on
_LEAST_INFORMATION = 1e-6  # 1/px²: holds pieces of which nothing is known
_SAMPLES = 16  # of the error
_CORRELATED_PASSES = 8  # of lattice smoothing: strain that is not foreseen goes on over some cells
_COVERAGE = 1.5  # expected error over its root mean square: about nine in ten errors are then below it
_ERROR_PASSES = 1  # of lattice smoothing of the samples' variance
_LOST_MATCH = 0.5  # share of the expected match under which another start is tried
_BETTER_MATCH = 0.1  # by which that must match better
_HIDDEN = 0.25  # share hidden from which a depth is not that of the pixel that a vertex lies in
_TELLING = (0.2, 0.5)  # expected match from which a mismatch begins to tell that the surface is hidden


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedFrame:
    """positions_px: (n, 2). depth: (n,). uncertainty_px: (n,) the expected error, pixels."""

    positions_px: Points2
    depth: npt.NDArray[np.float64]
    uncertainty_px: npt.NDArray[np.float64]


class SurfaceFit:
    """Fits one template to any frame, from where it was in the frame before."""

    def __init__(self, template: TrackingTemplate, normal_map: NormalMap, camera: Camera) -> None:
        """Prepare what hangs on the template alone; normal_map: of its frame."""
        lattice = lattice_on_template(template, _CELL_PX)
        slopes = slopes_from_normals(normal_map, camera)
        self._lattice, self._camera = lattice, camera
        self._registration = TemplateRegistration(template, lattice, slopes)
        self._outline = Outline(template, lattice, normal_map.mask, slopes)
        self._lengths = LinkLengths(lattice, template, camera, slopes)
        self._jacobians = LocalJacobians(lattice, template.positions_px)
        self._nodes_of_template = self._lengths.nodes(template.positions_px)
        self._system = LatticeSystem(self._lengths.links, self._lengths.centres)
        self._template_depth = template.vertices_in_camera[:, 2]

    def fit(
        self,
        before_px: Points2,
        last_px: Points2,
        previous: NormalMap,
        normal_map: NormalMap,
        depth_map: DepthMap,
    ) -> FittedFrame:
        """Fit to a frame, first from where the motion goes on to.

        before_px, last_px: (n, 2) in the last two frames. previous: the last one's normals.
        """
        lattice, lengths = self._lattice, self._lengths
        slopes = slopes_from_normals(normal_map, self._camera)
        figure = self._outline.figure(normal_map.mask, slopes)
        positions: Points2 = 2.0 * np.asarray(last_px, dtype=np.float64) - before_px
        around = self._jacobians.of(positions)
        told = self._registration.measure(positions, around, slopes)
        if np.sum(told.found) < _LOST_MATCH * np.sum(told.expected):
            positions = self._restarted(positions, last_px, told, previous, normal_map, slopes)
            around = self._jacobians.of(positions)
            told = self._registration.measure(positions, around, slopes)
        lost = told.found < _LOST_MATCH * told.expected
        if lost.any() and not lost.all():
            positions = self._resumed(positions, told, lost, slopes)
            around = self._jacobians.of(positions)
            told = self._registration.measure(positions, around, slopes)
        for number in range(_ITERATIONS):
            if number > 0:
                around = self._jacobians.of(positions)
                told = self._registration.measure(positions, around, slopes)
            hidden = self._hidden(told)
            inverse = _inverse(around)
            information = _congruent(told.information, inverse)
            pull = np.einsum("nji,nj->ni", inverse, told.pull)
            outline, outline_pull = self._outline.measure(positions, figure)
            measured = np.minimum(1.0, information[:, 0] + information[:, 2])
            guess, variance = lengths.guessed(positions, around, slopes, depth_map, hidden, measured)
            now = lengths.nodes(positions)
            steps = guess - (now[lengths.links[:, 1]] - now[lengths.links[:, 0]])
            weight = 1.0 / (variance + np.sum(steps**2, axis=1) / _TORN_SIGMAS**2)
            solution = self._system.solve(information + outline, pull + outline_pull, weight, steps)
            step = lattice.at_vertices(solution.displacement)
            positions = positions + step
            if np.abs(step).max() < _CONVERGED_PX:
                break
        return FittedFrame(
            positions_px=positions,
            depth=self._depth(positions, depth_map, hidden),
            uncertainty_px=self._uncertainty(solution),
        )

    def _restarted(
        self,
        positions: Points2,
        last_px: Points2,
        told: Measurement,
        previous: NormalMap,
        normal_map: NormalMap,
        slopes: Slopes,
    ) -> npt.NDArray[np.float64]:
        """Where DIS flow (`kroeger2016`) leads, as far as the template matches better there."""
        lattice = self._lattice
        flow = dense_flow(previous, normal_map)
        flown = last_px + sample_image(flow, last_px)
        at_nodes = self._lengths.nodes(flown - positions)
        moved = positions + lattice.at_vertices(at_nodes)
        there = self._registration.measure(moved, self._jacobians.of(moved), slopes)
        better = there.found > told.found + _BETTER_MATCH
        return np.asarray(positions + lattice.at_vertices(np.where(better[:, None], at_nodes, 0.0)))

    def _resumed(
        self,
        positions: Points2,
        told: Measurement,
        lost: npt.NDArray[np.bool_],
        slopes: Slopes,
    ) -> npt.NDArray[np.float64]:
        """Where the motion of what matches goes on to over what is lost, as far as it matches better there.

        What comes back into the mask, or from behind something, may lie farther off than one step reaches.
        """
        lattice = self._lattice
        here = self._lengths.nodes(positions)
        moved = here - self._nodes_of_template
        kept = (~lost).astype(np.float64)
        information = np.column_stack([kept, np.zeros_like(kept), kept])
        links = self._lengths.links
        filled = self._system.solve(
            information, kept[:, None] * moved, np.ones(len(links)), np.zeros((len(links), 2))
        ).displacement
        at_nodes = np.where(lost[:, None], filled - moved, 0.0)
        there_px = positions + lattice.at_vertices(at_nodes)
        there = self._registration.measure(there_px, self._jacobians.of(there_px), slopes)
        better = there.found > told.found + _BETTER_MATCH
        return np.asarray(positions + lattice.at_vertices(np.where(better[:, None], at_nodes, 0.0)))

    def _hidden(self, told: Measurement) -> npt.NDArray[np.float64]:
        """(nodes,) from 0 to 1: relief that should match and does not."""
        low, high = _TELLING
        telling = np.clip((told.expected - low) / (high - low), 0.0, 1.0)
        missing = np.clip(1.0 - told.match / (_LOST_MATCH * np.maximum(told.expected, low)), 0.0, 1.0)
        sums = self._lattice.smoothed(np.column_stack([telling * missing, np.ones(len(missing))]), 1)
        return np.asarray(sums[:, 0] / sums[:, 1])

    def _depth(self, positions: Points2, depth_map: DepthMap, hidden: FloatArray) -> npt.NDArray[np.float64]:
        """(n,) read from the frame; what is hidden is carried along by what is seen around it."""
        depth, found = sample_depth(depth_map.depth, depth_map.mask, positions)
        doubt = self._lattice.at_vertices(hidden[:, None])[:, 0] / _HIDDEN
        seen = found * np.clip(1.0 - doubt, 0.0, 1.0)
        if seen.min() >= 1.0:
            return np.asarray(depth)
        offset = np.where(found, depth - self._template_depth, 0.0)
        sums = self._lattice.sums(np.column_stack([seen, seen * offset]))
        filled = self._system.filled(sums[:, 0], sums[:, 1])
        return np.asarray(
            self._template_depth
            + seen * offset
            + (1.0 - seen) * self._lattice.at_vertices(filled[:, None])[:, 0]
        )

    def _uncertainty(self, solution: LatticeSolution) -> npt.NDArray[np.float64]:
        """(n,) what about nine in ten errors are below."""
        errors = solution.errors(np.random.default_rng(0), self._lattice, self._lengths.along)
        square = np.square(errors).sum(axis=1).mean(axis=1)
        sums = self._lattice.smoothed(np.column_stack([square, np.ones(len(square))]), _ERROR_PASSES)
        root = _COVERAGE * np.sqrt(sums[:, :1] / sums[:, 1:])
        return self._lattice.at_vertices(root)[:, 0]


class LatticeSystem:
    """Σ_nodes (d_i − m_i)ᵀ I_i (d_i − m_i) + Σ_links w_e |d_b − d_a − r_e|², laid out once."""

    def __init__(self, links: IntArray, centres: Points2) -> None:
        """Order the unknowns; links (e, 2) between the nodes at centres (m, 2)."""
        m, (a, b) = len(centres), links.T
        self.links, self.count = links, m
        order = nested_dissection_order(links, centres)
        self.order = (2 * order[:, None] + [0, 1]).ravel()
        rank = np.empty(2 * m, dtype=np.int64)
        rank[self.order] = np.arange(2 * m)
        i = np.arange(m)
        rows = [2 * i, 2 * i, 2 * i + 1, 2 * i + 1, 2 * a, 2 * b, 2 * a + 1, 2 * b + 1]
        columns = [2 * i, 2 * i + 1, 2 * i, 2 * i + 1, 2 * b, 2 * a, 2 * b + 1, 2 * a + 1]
        where = rank[np.concatenate(rows)], rank[np.concatenate(columns)]
        pattern = sp.csc_array(sp.coo_array((np.arange(1.0, len(where[0]) + 1), where)))
        pattern.sort_indices()
        self._place, self._pattern = pattern.data.astype(np.int64) - 1, pattern

    def solve(
        self, information: FloatArray, pull: FloatArray, weight: FloatArray, steps: FloatArray
    ) -> LatticeSolution:
        """Return the minimum; information I (m, 3), pull (m, 2) = I m, weight (e,), steps (e, 2) = r."""
        degree = _LEAST_INFORMATION + self._at_nodes(weight, weight)
        diagonal = [
            information[:, 0] + degree,
            information[:, 1],
            information[:, 1],
            information[:, 2] + degree,
        ]
        data = np.concatenate([*diagonal, *[-weight] * 4])
        pattern = self._pattern
        matrix = sp.csc_array((data[self._place], pattern.indices, pattern.indptr), shape=pattern.shape)
        factor = splu(matrix, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        right = np.array(pull, dtype=np.float64)
        for k in range(2):
            right[:, k] += self._at_nodes(-weight * steps[:, k], weight * steps[:, k])
        solution = LatticeSolution(self, factor, information, weight)
        solution.displacement = solution.solved(right[:, :, None])[:, :, 0]
        return solution

    def filled(self, weight: FloatArray, weighted: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m,) a value known as weighted / weight, harmonic where the weight (m,) is small."""
        information = np.column_stack([weight, np.zeros_like(weight), weight])
        ones, none = np.ones(len(self.links)), np.zeros((len(self.links), 2))
        return self.solve(information, np.column_stack([weighted, weighted]), ones, none).displacement[:, 0]

    def _at_nodes(self, first: FloatArray, second: FloatArray) -> npt.NDArray[np.float64]:
        a, b = self.links.T
        count = self.count
        return np.asarray(np.bincount(a, first, count) + np.bincount(b, second, count), dtype=np.float64)


class LatticeSolution:
    """displacement: (m, 2)."""

    displacement: npt.NDArray[np.float64]

    def __init__(self, system: LatticeSystem, factor, information: FloatArray, weight: FloatArray) -> None:  # type: ignore[no-untyped-def]
        self._system, self._factor, self._information, self._weight = system, factor, information, weight

    def solved(self, right: FloatArray) -> npt.NDArray[np.float64]:
        """Return (m, 2, k) for right-hand sides (m, 2, k)."""
        order = self._system.order
        flat = np.empty((2 * self._system.count, right.shape[2]))
        flat[order] = self._factor.solve(np.ascontiguousarray(right.reshape(len(flat), -1)[order]))
        return flat.reshape(right.shape)

    def errors(
        self, rng: np.random.Generator, lattice: TemplateLattice, along: Points2
    ) -> npt.NDArray[np.float64]:
        """Return (m, 2, k) samples of the error: every term is given its own at random, and solved with.

        That of the links is a strain that goes on over some cells. along: (e, 2) the links on the template.
        """
        system = self._system
        m, (a, b) = system.count, system.links.T
        right = np.einsum("nij,njk->nik", _cholesky(self._information), rng.standard_normal((m, 2, _SAMPLES)))
        strain = lattice.smoothed(rng.standard_normal((m, 4 * _SAMPLES)), _CORRELATED_PASSES)
        strain = (strain / strain.std()).reshape(m, 2, 2, _SAMPLES)
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        on_links = np.einsum("eijk,ej->eik", 0.5 * (strain[a] + strain[b]), along)
        on_links = (np.sqrt(self._weight)[:, None, None] * on_links).reshape(len(a), -1)
        incidence = sp.csr_array(
            (np.repeat([1.0, -1.0], len(a)), (np.concatenate([b, a]), np.tile(np.arange(len(a)), 2))),
            shape=(m, len(a)),
        )
        right += (incidence @ on_links).reshape(m, 2, _SAMPLES)
        right += np.sqrt(_LEAST_INFORMATION) * rng.standard_normal(right.shape)
        return self.solved(right)


def _inverse(around: FloatArray) -> npt.NDArray[np.float64]:
    """Inverse (m, 2, 2) of Jacobians (m, 4), bounded where they are nearly singular."""
    a, b, c, d = around.T
    determinant = a * d - b * c
    bounded = np.where(determinant < 0, -1.0, 1.0) * np.maximum(np.abs(determinant), _LEAST_SINGULAR)
    return np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2) / bounded[:, None, None]


def _congruent(information: FloatArray, inverse: FloatArray) -> npt.NDArray[np.float64]:
    """J⁻ᵀ I J⁻¹ (m, 3) of information (m, 3) and J⁻¹ (m, 2, 2): in pixels of the frame."""
    full = information[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    full = np.swapaxes(inverse, 1, 2) @ full @ inverse
    return np.stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1]], axis=1)


def _cholesky(information: FloatArray) -> npt.NDArray[np.float64]:
    """Lower roots (m, 2, 2) of information (m, 3)."""
    a = np.sqrt(np.maximum(information[:, 0], 1e-30))
    b = information[:, 1] / a
    c = np.sqrt(np.maximum(information[:, 2] - b * b, 0.0))
    return np.stack([a, np.zeros_like(a), b, c], axis=1).reshape(-1, 2, 2)

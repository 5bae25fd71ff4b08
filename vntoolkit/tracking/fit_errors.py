"""The error to expect of a fit: errors are drawn for every term of the problem, and solved with.

Windows overlap, and strain goes on from edge to edge: errors of neighbours are alike. So each kind is drawn
as white noise, smoothed as far as it reaches. How large the strain is that nothing foresees is read from how
far the solution departs from the prior (a variance component, `foerstner1979`): as far as from drawn
strain, if it is as large as given. Only the part that varies slowly over the figure is compared: that part
adds up to errors. Where edges depart farther than elsewhere, as along an arm that opens, the strain is larger
than the mean.

The finest relief sits on the surface. Shapes beside an occluding contour may stay in place while the surface
turns beneath them: windows that see them then all have the same error. So have those on the running template
of a place that the template no longer matches: it may have been laid off its place. All lengths share one
error too: the difference between the two parts of their prior.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.tracking.edge_prior import NEAR_PASSES, STRAIN_PASSES, EdgePrior
from vntoolkit.tracking.factors import Factor, cholesky, full_of
from vntoolkit.tracking.lattice import NODES_BY_PASS, TemplateLattice
from vntoolkit.tracking.lattice_system import LatticeSolution
from vntoolkit.tracking.modes import slow_monomials

_SAMPLES = 16
_PRIOR = 0.1  # share of the given strain in what is found


class FitErrors:
    """Expected errors of the fits of one template."""

    def __init__(self, lattice: TemplateLattice, prior: EdgePrior, passes: Sequence[int]) -> None:
        """Draw what every frame's errors are made of; passes: of each window's lattice smoothing."""
        self._lattice, self._edges = lattice, prior.edges
        m = lattice.count
        rng = np.random.default_rng(0)
        shape = (m, 2, _SAMPLES)
        self._drawn = []
        for each in passes:
            alike = _unit(lattice.smoothed(rng.standard_normal((m, 2 * _SAMPLES)), each))
            self._drawn.append((alike / np.sqrt(NODES_BY_PASS * each)).reshape(shape))
        self._drawn.append(self._drawn[0])  # of the running template: it errs as the finest relief does
        self._drawn.append(rng.standard_normal(shape))  # of the outline
        local = _unit(lattice.smoothed(rng.standard_normal((m, 4 * _SAMPLES)), STRAIN_PASSES))
        strain = local.reshape(m, 2, 2, _SAMPLES)[self._edges].mean(axis=1)
        along = prior.along / np.linalg.norm(prior.along, axis=1, keepdims=True)
        self._local = np.einsum("eijk,ej->eik", strain, along)
        self._compared = _compared(prior)

    def expected(
        self,
        solution: LatticeSolution,
        factors: Sequence[Factor],
        deviation: FloatArray,
        residuals: FloatArray,
        shared: FloatArray,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the expected squared error (nodes,) of a fit, and (edges,) how far each is known.

        factors: of windows, running template and outline, in pixels of the frame. deviation: (edges,)
        standard deviation of the prior, by direction. residuals: (edges, 2) of the prior. shared: (edges, 2)
        deviation of all of it together. An edge that errs as its prior does is known by 0, one without error
        by 1.
        """
        measured = np.zeros((self._lattice.count, 2, _SAMPLES))
        for each, drawn in zip(factors, self._drawn, strict=True):
            measured += np.einsum("nij,njk->nik", cholesky(each.information), drawn)
        size = deviation[:, None, None]
        straight = np.zeros_like(self._local)
        slid = [
            each.shared_px[:, None, None] * full_of(each.information)
            for each in factors
            if each.shared_px.any()
        ]
        nothing = np.zeros((len(measured), 2, _SAMPLES + 1))
        unmoved = np.zeros((len(deviation), 2, 2 * len(slid)))
        errors, left = solution.solved(
            np.concatenate([measured, nothing, *slid], axis=2),
            np.concatenate([straight, size * self._local, shared[:, :, None], unmoved], axis=2),
        )
        by_measurement, by_local, by_shared = np.split(errors, [_SAMPLES, 2 * _SAMPLES], axis=2)
        foreseen = (left[:, :, :_SAMPLES] + left[:, :, _SAMPLES : 2 * _SAMPLES]) / size
        usual = np.square(self._compared @ foreseen.reshape(len(deviation), 2 * _SAMPLES)).sum() / _SAMPLES
        scaled = residuals / deviation[:, None]
        found = np.square(self._compared @ scaled).sum()
        whole = np.sqrt(_PRIOR + (1.0 - _PRIOR) * (found / usual if usual > 0 else 1.0))
        strain = whole * self._varies(scaled[:, :, None], foreseen)
        drawn = np.square(by_measurement + strain[:, None, None] * by_local).sum(axis=1).mean(axis=1)
        square = np.asarray(drawn + np.square(by_shared).sum(axis=(1, 2)))
        return square, self._known(by_measurement + by_local, size * self._local)

    def _known(self, errors: FloatArray, foreseen: FloatArray) -> npt.NDArray[np.float64]:
        """(edges,) the share by which drawn errors (nodes, 2, k) of an edge are below those of its prior."""
        a, b = self._edges.T
        squares = [np.square(each).sum(axis=(1, 2)) for each in (errors[b] - errors[a], foreseen)]
        return np.clip(1.0 - squares[0] / np.maximum(squares[1], 1e-12), 0.0, 1.0)

    def _varies(self, *residuals: FloatArray) -> npt.NDArray[np.float64]:
        """(nodes,) strain around each over its root mean square, by residuals (edges, 2, k)."""
        m, (a, b) = self._lattice.count, self._edges.T
        squares = [np.square(each).sum(axis=(1, 2)) for each in residuals]
        sums = np.stack([np.bincount(a, x, m) + np.bincount(b, x, m) for x in squares], axis=1)
        found, usual = self._lattice.smoothed(sums, NEAR_PASSES).T
        square = _PRIOR + (1.0 - _PRIOR) * _SAMPLES * found / np.maximum(usual, 1e-12)
        return np.asarray(np.sqrt(square / square.mean()))


def _compared(prior: EdgePrior) -> npt.NDArray[np.float64]:
    """(k, edges) orthonormal polynomials of the place, of edges across and of edges along apart."""
    if len(prior.edges) == 0:
        return np.zeros((1, 0))
    terms = _polynomials(0.5 * (prior.centres[prior.edges[:, 0]] + prior.centres[prior.edges[:, 1]]))
    across = (np.abs(prior.along[:, 0]) > np.abs(prior.along[:, 1]))[:, None]
    return np.vstack([np.linalg.qr(terms * chosen)[0].T for chosen in (across, ~across)])


def _polynomials(place: FloatArray) -> npt.NDArray[np.float64]:
    """(m, k) orthonormal polynomials of places (m, 2), by rising degree."""
    return np.asarray(np.linalg.qr(slow_monomials(place))[0])


def _unit(fields: FloatArray) -> npt.NDArray[np.float64]:
    return np.asarray(fields / max(float(fields.std()), 1e-12))

"""The error to expect of a fit: errors are drawn for every term of the problem, and solved with.

Windows overlap, and strain goes on from link to link: errors of neighbours are alike. So each kind is drawn
as white noise, smoothed as far as it reaches. How large the strain is that nothing foresees is read from how
far the solution departs from the guesses (a variance component, `foerstner1979`): as far as from drawn
strain, if it is as large as given. Only the part that varies slowly over the figure is compared: that part
adds up to errors. Where links depart farther than elsewhere, as along an arm that opens, the strain is larger
than the mean.

The finest relief sits on the surface. Shapes beside an occluding contour may stay in place while the surface
turns beneath them: windows that see them then all have the same error. So have those on what is remembered of
a place that the template no longer matches: it may have been remembered off its place. All lengths share one
error too: the difference between their two guesses.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.lattice_system import LatticeSolution
from vntoolkit.tracking.lengths import STRAIN_PASSES, LinkLengths, slow_monomials
from vntoolkit.tracking.registration import TemplateRegistration, WindowSteps

_SAMPLES = 16
_PRIOR = 0.1  # share of the given strain in what is found
_NEAR_PASSES = 8  # of lattice smoothing: how far around departures of links tell of a place


class FitErrors:
    """Expected errors of the fits of one template."""

    def __init__(
        self, lattice: TemplateLattice, registration: TemplateRegistration, lengths: LinkLengths
    ) -> None:
        """Draw what every frame's errors are made of."""
        self._lattice, self._links = lattice, lengths.links
        m = lattice.count
        rng = np.random.default_rng(0)
        shape = (m, 2, _SAMPLES)
        self._windows = []
        for windows in registration.windows:
            alike = _unit(lattice.smoothed(rng.standard_normal((m, 2 * _SAMPLES)), windows.passes))
            self._windows.append((alike / np.sqrt(windows.nodes)).reshape(shape))
        self._windows.append(self._windows[0])  # of what is remembered: it errs as the finest relief does
        self._outline = rng.standard_normal(shape)
        local = _unit(lattice.smoothed(rng.standard_normal((m, 4 * _SAMPLES)), STRAIN_PASSES))
        strain = local.reshape(m, 2, 2, _SAMPLES)[self._links].mean(axis=1)
        along = lengths.along / np.linalg.norm(lengths.along, axis=1, keepdims=True)
        self._local = np.einsum("eijk,ej->eik", strain, along)
        self._compared = _compared(lengths)

    def expected(
        self,
        solution: LatticeSolution,
        windows: list[WindowSteps],
        outline: FloatArray,
        sd: FloatArray,
        departures: FloatArray,
        doubt: FloatArray,
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return (nodes,) the expected squared error, px², and (links,) how far links are known.

        windows: in pixels of the frame, as the information (nodes, 3) of the outline. sd: (links,) standard
        deviation of the steps. departures: (links, 2) of the solution from what lengths guess. doubt: (links,
        2, k) as guessed. A link that errs as its guess does is known by 0, one that does not err by 1.
        """
        measured = np.einsum("nij,njk->nik", cholesky(outline), self._outline)
        for each, drawn in zip(windows, self._windows, strict=False):
            measured += np.einsum("nij,njk->nik", cholesky(each.information), drawn)
        size = sd[:, None, None]
        straight = np.zeros_like(self._local)
        shared = [
            each.slide_px[:, None, None] * each.information[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
            for each in windows
            if each.slide_px.any()
        ]
        nothing = np.zeros((len(outline), 2, _SAMPLES + doubt.shape[2]))
        unmoved = np.zeros((len(sd), 2, 2 * len(shared)))
        errors, left = solution.solved(
            np.concatenate([measured, nothing, *shared], axis=2),
            np.concatenate([straight, size * self._local, doubt, unmoved], axis=2),
        )
        by_measurement, by_local, by_given = np.split(errors, [_SAMPLES, 2 * _SAMPLES], axis=2)
        foreseen = (left[:, :, :_SAMPLES] + left[:, :, _SAMPLES : 2 * _SAMPLES]) / size
        usual = np.square(self._compared @ foreseen.reshape(len(sd), 2 * _SAMPLES)).sum() / _SAMPLES
        departs = departures / sd[:, None]
        found = np.square(self._compared @ departs).sum()
        whole = np.sqrt(_PRIOR + (1.0 - _PRIOR) * (found / usual if usual > 0 else 1.0))
        strain = whole * self._varies(departs[:, :, None], foreseen)
        drawn = np.square(by_measurement + strain[:, None, None] * by_local).sum(axis=1).mean(axis=1)
        square = np.asarray(drawn + np.square(by_given).sum(axis=(1, 2)))
        return square, self._told(by_measurement + by_local, size * self._local)

    def _told(self, errors: FloatArray, guessed: FloatArray) -> npt.NDArray[np.float64]:
        """(links,) the share by which drawn errors (nodes, 2, k) of a link are below those of its guess."""
        a, b = self._links.T
        squares = [np.square(each).sum(axis=(1, 2)) for each in (errors[b] - errors[a], guessed)]
        return np.clip(1.0 - squares[0] / np.maximum(squares[1], 1e-12), 0.0, 1.0)

    def _varies(self, *departures: FloatArray) -> npt.NDArray[np.float64]:
        """(nodes,) strain around each over its root mean square, by departures (links, 2, k) of links."""
        m, (a, b) = self._lattice.count, self._links.T
        squares = [np.square(each).sum(axis=(1, 2)) for each in departures]
        sums = np.stack([np.bincount(a, x, m) + np.bincount(b, x, m) for x in squares], axis=1)
        found, usual = self._lattice.smoothed(sums, _NEAR_PASSES).T
        square = _PRIOR + (1.0 - _PRIOR) * _SAMPLES * found / np.maximum(usual, 1e-12)
        return np.asarray(np.sqrt(square / square.mean()))


def _compared(lengths: LinkLengths) -> npt.NDArray[np.float64]:
    """(k, links) orthonormal polynomials of the place, of links across and of links along apart."""
    if len(lengths.links) == 0:
        return np.zeros((1, 0))
    terms = _polynomials(0.5 * (lengths.centres[lengths.links[:, 0]] + lengths.centres[lengths.links[:, 1]]))
    across = (np.abs(lengths.along[:, 0]) > np.abs(lengths.along[:, 1]))[:, None]
    return np.vstack([np.linalg.qr(terms * chosen)[0].T for chosen in (across, ~across)])


def _polynomials(place: FloatArray) -> npt.NDArray[np.float64]:
    """(m, k) orthonormal polynomials of places (m, 2), by rising degree."""
    return np.asarray(np.linalg.qr(slow_monomials(place))[0])


def _unit(fields: FloatArray) -> npt.NDArray[np.float64]:
    return np.asarray(fields / max(float(fields.std()), 1e-12))


def cholesky(information: FloatArray) -> npt.NDArray[np.float64]:
    """Lower roots (m, 2, 2) of information (m, 3)."""
    a = np.sqrt(np.maximum(information[:, 0], 1e-30))
    b = information[:, 1] / a
    c = np.sqrt(np.maximum(information[:, 2] - b * b, 0.0))
    return np.stack([a, np.zeros_like(a), b, c], axis=1).reshape(-1, 2, 2)

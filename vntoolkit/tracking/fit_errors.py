"""The error to expect of a fit: errors are drawn for every term of the problem, and solved with.

Windows overlap, and strain goes on from link to link: errors of neighbours are alike. So each kind is drawn
as white noise, smoothed as far as it reaches. How large the strain is that nothing foresees is read from what
the solution leaves of it (a variance component, `foerstner1979`): as much as drawn strain leaves, if it is as
large as given. Only the part that varies slowly over the figure is compared: that part adds up to errors.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from vntoolkit.arrays import FloatArray
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.lattice_system import LatticeSolution
from vntoolkit.tracking.lengths import STRAIN_PASSES, LinkLengths
from vntoolkit.tracking.registration import TemplateRegistration, WindowSteps

_SAMPLES = 16
_DEGREE = 2  # of the polynomials in place that strain is compared by
_PRIOR = 0.1  # share of the given strain in what is found


class FitErrors:
    """Expected errors of the fits of one template."""

    def __init__(
        self, lattice: TemplateLattice, registration: TemplateRegistration, lengths: LinkLengths
    ) -> None:
        """Draw what every frame's errors are made of."""
        self._lattice, self._links = lattice, lengths.links
        m, e = lattice.count, len(lengths.links)
        rng = np.random.default_rng(0)
        shape = (m, 2, _SAMPLES)
        self._windows = []
        for halvings in range(registration.band_count):
            white = rng.standard_normal((m, 2 * _SAMPLES))
            alike = _unit(registration.spread(white, halvings))
            self._windows.append((alike / np.sqrt(registration.nodes_of_window(halvings))).reshape(shape))
        self._outline = rng.standard_normal(shape)
        strain = _unit(lattice.smoothed(rng.standard_normal((m, 4 * _SAMPLES)), STRAIN_PASSES))
        strain = strain.reshape(m, 2, 2, _SAMPLES)
        along = lengths.along / np.linalg.norm(lengths.along, axis=1, keepdims=True)
        a, b = self._links.T
        self._strain = np.einsum("eijk,ej->eik", 0.5 * (strain[a] + strain[b]), along)
        self._incidence = sp.csr_array(
            (np.repeat([1.0, -1.0], e), (np.concatenate([b, a]), np.tile(np.arange(e), 2))), shape=(m, e)
        )
        self._slow = _slow(lengths)

    def square(
        self,
        solution: LatticeSolution,
        bands: list[WindowSteps],
        outline: FloatArray,
        weight: FloatArray,
        steps: FloatArray,
        sd: FloatArray,
    ) -> npt.NDArray[np.float64]:
        """Return (nodes,) the expected squared error, px².

        bands: in pixels of the frame, as the information (nodes, 3) of the outline. weight (links,) and steps
        (links, 2): as solved with. sd: (links,) standard deviation of the steps.
        """
        fixed = np.einsum("nij,njk->nik", cholesky(outline), self._outline)
        for band in bands:
            fixed += np.einsum("nij,njk->nik", cholesky(band.information), self._windows[band.halvings])
        e = len(sd)
        drawn = sd[:, None, None] * self._strain
        by_strain = (self._incidence @ (weight[:, None, None] * drawn).reshape(e, -1)).reshape(fixed.shape)
        errors = solution.solved(np.concatenate([fixed, by_strain], axis=2))
        fixed, by_strain = errors[:, :, :_SAMPLES], errors[:, :, _SAMPLES:]
        (a, b), d = self._links.T, solution.displacement
        left = (d[b] - d[a] - steps) / sd[:, None]
        expected = ((fixed + by_strain)[b] - (fixed + by_strain)[a]) / sd[:, None, None] - self._strain
        found = np.square(self._slow @ left).sum()
        foreseen = np.square(self._slow @ expected.reshape(e, -1)).sum() / _SAMPLES
        factor = np.sqrt(_PRIOR + (1.0 - _PRIOR) * (found / foreseen if foreseen > 0 else 1.0))
        return np.asarray(np.square(fixed + factor * by_strain).sum(axis=1).mean(axis=1))


def _slow(lengths: LinkLengths) -> npt.NDArray[np.float64]:
    """(k, links) orthonormal polynomials of the place, of links across and of links along apart."""
    if len(lengths.links) == 0:
        return np.zeros((1, 0))
    centre = 0.5 * (lengths.centres[lengths.links[:, 0]] + lengths.centres[lengths.links[:, 1]])
    x, y = ((centre - centre.mean(axis=0)) / np.maximum(centre.std(axis=0), 1.0)).T
    across = np.abs(lengths.along[:, 0]) > np.abs(lengths.along[:, 1])
    parts = []
    for chosen in (across, ~across):
        terms = [x**i * y**j * chosen for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)]
        parts.append(np.linalg.qr(np.stack(terms, axis=1))[0].T)
    return np.vstack(parts)


def _unit(fields: FloatArray) -> npt.NDArray[np.float64]:
    return np.asarray(fields / max(float(fields.std()), 1e-12))


def cholesky(information: FloatArray) -> npt.NDArray[np.float64]:
    """Lower roots (m, 2, 2) of information (m, 3)."""
    a = np.sqrt(np.maximum(information[:, 0], 1e-30))
    b = information[:, 1] / a
    c = np.sqrt(np.maximum(information[:, 2] - b * b, 0.0))
    return np.stack([a, np.zeros_like(a), b, c], axis=1).reshape(-1, 2, 2)

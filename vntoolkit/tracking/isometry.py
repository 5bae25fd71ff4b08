"""The Jacobian of the image motion that preserves lengths on the surface, predicted from normals.

A step dx on the template is |dx|² + (∇z · dx)² long, squared, on the surface: G_t = I + ∇z ∇zᵀ there, and
G_c alike in the current frame. Cloth and skin keep their lengths, so that the correspondence's Jacobian J
obeys Jᵀ G_c J = G_t, which leaves a turn R open: J = G_c^(−1/2) R G_t^(1/2). On simulated knitwear such
lengths agree to some 5 %, over folds in which J itself varies between 0.3 and 1.6: a strip of cloth that
comes back into sight is found by it, where the plainest continuation of the motion is off by 15 pixels.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.sampling import sample_image
from vntoolkit.tracking.template import TrackingTemplate

_TURN_PASSES = 2  # of lattice smoothing: the turn in the image is that of the surroundings
_WHOLE = 0.5  # mean weight of the slopes in a cell from which they are fully trusted
_LEAST_SHARE = 0.3  # of a cell's pixels on the surface, else its mean says nothing
_LEAST_WEIGHT = 0.02  # of a slope that counts in full: towards where there is no surface it fades to 0
_STRAINS = (0.7, 0.4)  # logarithmic: twice as long or short is wrong, half as much again is not reliable
_TINY = 1e-9


class Isometry:
    """Predicts the Jacobian of the correspondence from the normals of template and frame."""

    def __init__(
        self, lattice: TemplateLattice, template: TrackingTemplate, slopes: npt.NDArray[np.float32]
    ) -> None:
        """Measure the template; slopes: (h, w, 3) of its frame, the finest of `slope_pyramid`."""
        self._lattice = lattice
        self._counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        self._template_metric, self._template_weight = self._metric(slopes, template.positions_px)
        self._template_root = _square_root(self._template_metric)
        self._inverse_template_root = np.linalg.inv(self._template_root)

    def jacobians(
        self, slopes: npt.NDArray[np.float32], positions_px: Points2, around: FloatArray
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return J (nodes, 2, 2) at positions (n, 2), and how far to trust it, (nodes,) from 0 to 1.

        slopes: of the current frame. around: (nodes, 4) Jacobians so far, which give the turn.
        """
        metric, weight = self._metric(slopes, positions_px)
        root = _square_root(metric)
        inverse = np.linalg.inv(root)
        ones = np.ones((self._lattice.count, 1))
        sums = self._lattice.smoothed(np.hstack([around, ones]), _TURN_PASSES)
        mean = (sums[:, :4] / sums[:, 4:]).reshape(-1, 2, 2)
        turn = _nearest_turn(root @ mean @ self._inverse_template_root)
        seen = np.minimum(weight, self._template_weight) / (_WHOLE * np.maximum(self._counts, 1))
        whole = self._counts >= _LEAST_SHARE * self._counts.max(initial=1)
        return inverse @ turn @ self._template_root, np.clip(seen, 0.0, 1.0) * whole

    def plausibility(
        self, slopes: npt.NDArray[np.float32], positions_px: Points2, jacobians: FloatArray
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return (n,) from 1 where lengths on the surface stay to 0 where no surface could stretch so far.

        The second is stricter: the first says what is surely wrong and must move, the second what may be
        relied on. positions_px: (n, 2). jacobians: (nodes, 4) of them. What slips off a rim, or on to another
        row of stitches, matches well and is betrayed by the stretch around it.
        """
        metric, weight = self._metric(slopes, positions_px)
        strain = _square_root(metric) @ jacobians.reshape(-1, 2, 2) @ self._inverse_template_root
        product = np.abs(np.linalg.det(strain))
        total = np.sum(strain**2, axis=(1, 2))
        spread = np.sqrt(np.maximum(total**2 - 4 * product**2, 0.0))
        longest = np.sqrt(0.5 * (total + spread))
        shortest = product / np.maximum(longest, _TINY)
        worst = np.maximum(np.log(np.maximum(longest, 1.0)), -np.log(np.clip(shortest, _TINY, 1.0)))
        known = np.minimum(weight, self._template_weight) >= _WHOLE * np.maximum(self._counts, 1)
        shares = [np.where(known, 1.0 / (1.0 + (worst / limit) ** 4), 1.0) for limit in _STRAINS]
        surely, reliably = self._lattice.at_vertices(np.column_stack(shares)).T
        return surely, reliably

    def _metric(
        self, slopes: npt.NDArray[np.float32], positions_px: Points2
    ) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """(nodes, 2, 2) weighted mean of I + ∇z ∇zᵀ over each node, and the sum of the weights."""
        sampled = sample_image(slopes, positions_px)
        weight = sampled[:, 2]
        p, q = (sampled[:, k] / np.maximum(weight, _LEAST_WEIGHT) for k in range(2))
        sums = self._lattice.sums(np.column_stack([weight, weight * p * p, weight * p * q, weight * q * q]))
        means = sums[:, [1, 2, 2, 3]] / np.maximum(sums[:, :1], _TINY)
        return np.eye(2) + means.reshape(-1, 2, 2), sums[:, 0]


def _square_root(metric: FloatArray) -> npt.NDArray[np.float64]:
    """Return the symmetric root of positive definite (m, 2, 2), by Cayley and Hamilton."""
    determinant = np.sqrt(np.linalg.det(metric))
    trace = np.sqrt(metric[:, 0, 0] + metric[:, 1, 1] + 2 * determinant)
    return np.asarray((metric + determinant[:, None, None] * np.eye(2)) / trace[:, None, None])


def _nearest_turn(matrix: FloatArray) -> npt.NDArray[np.float64]:
    """Return the rotation (m, 2, 2) nearest to each matrix."""
    cosine, sine = matrix[:, 0, 0] + matrix[:, 1, 1], matrix[:, 1, 0] - matrix[:, 0, 1]
    length = np.maximum(np.hypot(cosine, sine), _TINY)
    cosine, sine = cosine / length, sine / length
    return np.stack([cosine, -sine, sine, cosine], axis=1).reshape(-1, 2, 2)

"""Taking the performer's own steps and turns out of the captured garment, so that it stays on the figure."""

from __future__ import annotations

from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.skinning.weights import SkinWeights

_MAX_POINTS = 5000  # a rigid motion needs no more, and the fit then takes no time


class Anchor(Enum):
    """What holds the captured garment in place.

    TRUNK: the rigid motion of what covers the trunk is taken out; folds and sleeves keep moving. NONE: the
    garment moves as captured, performer's steps included.
    """

    TRUNK = "trunk"
    NONE = "none"


class TrunkAnchor:
    """Finds, frame by frame, the rigid motion that takes the garment's trunk back to the first frame."""

    def __init__(self, rest_vertices: Points, weights: SkinWeights, trunk: tuple[int, ...]) -> None:
        on_trunk = np.where(np.isin(weights.joints, trunk), weights.weights, 0).sum(axis=1)
        chosen = np.flatnonzero(on_trunk > 0.5 * on_trunk.max())
        self._chosen = chosen[:: max(1, len(chosen) // _MAX_POINTS)]
        self._weights = on_trunk[self._chosen]
        self._rest = np.asarray(rest_vertices, dtype=np.float64)[self._chosen]

    def rest_from_now(self, vertices: Points) -> RigidTransform:
        """Return the rigid motion from the garment now, (n, 3), to its first frame (Kabsch, weighted)."""
        now = np.asarray(vertices, dtype=np.float64)[self._chosen]
        return _fit_rigid(now, self._rest, self._weights)


def _fit_rigid(source: Points, target: Points, weights: FloatArray) -> RigidTransform:
    share = weights / weights.sum()
    centre_s, centre_t = share @ source, share @ target
    covariance = (target - centre_t).T @ ((source - centre_s) * share[:, None])
    u, _, vt = np.linalg.svd(covariance)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    return RigidTransform(rotation=rotation, translation=centre_t - rotation @ centre_s)

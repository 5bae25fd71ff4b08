"""Measurements as factors: each tells of the nodes' displacements d by its information I and by I d.

Factors add up, whatever they come from. Where one tells nothing, or in what direction, its information is 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray


class Factor(NamedTuple):
    """information: (nodes, 3) I_uu, I_uv, I_vv in 1/px². right_hand_side: (nodes, 2) I d.

    shared_px: (nodes,) an error that all nodes may have alike, as of a contour that the surface slides under.
    """

    information: npt.NDArray[np.float64]
    right_hand_side: npt.NDArray[np.float64]
    shared_px: npt.NDArray[np.float64]

    def in_frame(self, inverse: FloatArray) -> Factor:
        """Return this, of pixels of the template, in pixels of the frame; inverse: (m, 2, 2) J⁻¹."""
        turned = np.swapaxes(inverse, 1, 2)
        information = upper_of(turned @ full_of(self.information) @ inverse)
        right = (turned @ self.right_hand_side[..., None])[..., 0]
        return self._replace(information=information, right_hand_side=right)


def factor(information: FloatArray, displacement: FloatArray) -> Factor:
    """Return the factor of displacements (nodes, 2) measured with that information (nodes, 3)."""
    right = np.einsum("nij,nj->ni", full_of(information), displacement)
    return Factor(np.asarray(information), right, np.zeros(len(right)))


def total(factors: Iterable[Factor]) -> Factor:
    """Return what factors tell together, without what they share."""
    information, right, _ = zip(*factors, strict=True)
    return Factor(np.sum(information, axis=0), np.sum(right, axis=0), np.zeros(len(right[0])))


def full_of(information: FloatArray) -> npt.NDArray[np.float64]:
    """Return (m, 2, 2) of the upper triangles (m, 3) of symmetric matrices."""
    return np.asarray(information[:, [0, 1, 1, 2]].reshape(-1, 2, 2), dtype=np.float64)


def upper_of(matrix: FloatArray) -> npt.NDArray[np.float64]:
    """Return (m, 3) of symmetric (m, 2, 2)."""
    return np.stack([matrix[:, 0, 0], matrix[:, 0, 1], matrix[:, 1, 1]], axis=1)


def cholesky(information: FloatArray) -> npt.NDArray[np.float64]:
    """Return lower roots (m, 2, 2) of information (m, 3), which may be singular."""
    a = np.sqrt(np.maximum(information[:, 0], 1e-30))
    b = information[:, 1] / a
    c = np.sqrt(np.maximum(information[:, 2] - b * b, 0.0))
    return np.stack([a, np.zeros_like(a), b, c], axis=1).reshape(-1, 2, 2)

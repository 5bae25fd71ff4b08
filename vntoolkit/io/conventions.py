"""Axes on disk: conventions of normal maps, and the flip between camera frame and graphics frame."""

from typing import TYPE_CHECKING

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.options.export import MeshUpAxis

if TYPE_CHECKING:
    from vntoolkit.geometry.motion import Motion


def graphics_from_camera(vectors: FloatArray, up: MeshUpAxis = MeshUpAxis.Y) -> FloatArray:
    """Rotate points or directions (..., 3) about x by 180° (y up) or 90° (z up); the winding is unchanged.

    With y up it is its own inverse.
    """
    vectors = np.asarray(vectors)
    if up is MeshUpAxis.Z:
        return np.stack([vectors[..., 0], vectors[..., 2], -vectors[..., 1]], axis=-1)
    turned = np.array(vectors)
    for axis in (1, 2):  # a product with (1, -1, -1) takes four times as long
        np.negative(turned[..., axis], out=turned[..., axis])
    return turned


def motion_with_axes_turned(motion: "Motion") -> "Motion":
    """Return the motion in the other frame: y up on disk, y down in memory."""
    return motion.turned(graphics_from_camera(np.eye(3)))

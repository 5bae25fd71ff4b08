"""Views by how far the head is turned in them: an even choice, and neighbours."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray
from vntoolkit.calibration.head.hull import View
from vntoolkit.geometry.rigid import RigidTransform


def spread_over_turn(views: Sequence[View], count: int) -> IntArray:
    """Choose views (count,) spread evenly over the turn, by their angle from the first one's end."""
    angles = turn_angles_deg([view.camera_from_head for view in views])
    wanted = np.linspace(angles.min(), angles.max(), count) if count > 1 else [np.median(angles)]
    return np.unique([int(np.argmin(np.abs(angles - angle))) for angle in wanted])


def turn_angles_deg(poses: Sequence[RigidTransform], reference: int = 0) -> FloatArray:
    """Return the turn (f,) of every pose from the reference, signed, about the axis most turning is about."""
    turns = np.array([(pose @ poses[reference].inverse()).rotation_vector for pose in poses])
    _, _, right = np.linalg.svd(turns, full_matrices=False)
    return np.rad2deg(turns @ right[0])


def neighbours_of(views: Sequence[View], reference: int, angles_deg: Sequence[float]) -> list[int]:
    """Return the views nearest to the given turns to both sides of the reference, at least half as far."""
    apart = turn_angles_deg([view.camera_from_head for view in views], reference)
    chosen: list[int] = []
    for angle in angles_deg:
        for signed in (-angle, angle):
            k = int(np.argmin(np.abs(apart - signed)))
            if 0.5 * angle < apart[k] * np.sign(signed) < 2.0 * angle and k not in chosen:
                chosen.append(k)
    return chosen

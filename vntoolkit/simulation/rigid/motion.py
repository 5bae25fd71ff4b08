"""Smooth motion of a rigid object through all six degrees of freedom."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import Vector3
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.simulation.studio import studio_centre


@dataclass(frozen=True, kw_only=True, eq=False)
class Sway:
    """Motion along and about three axes by six sines of different periods, so that it repeats late.

    turns_deg: amplitudes about x, y, z. shifts_m: amplitudes along x, y, z. periods_s: six, rotations first.
    phases: six, radians. rest: object's orientation at the middle of the motion.
    """

    turns_deg: tuple[float, float, float]
    shifts_m: tuple[float, float, float]
    periods_s: tuple[float, ...]
    phases: Vector3
    frame_rate_hz: float = 60.0
    rest: RigidTransform = RigidTransform()  # noqa: RUF009  frozen, hence safe to share

    def camera_from_object(self, frame: int) -> RigidTransform:
        """Return the pose of a frame; the object's origin stays near the studio's centre."""
        time_s = frame / self.frame_rate_hz
        waves = np.sin(2 * np.pi * time_s / np.array(self.periods_s) + self.phases)
        rotation = Rotation.from_euler("xyz", waves[:3] * np.array(self.turns_deg), degrees=True)
        shift = studio_centre() + waves[3:] * np.array(self.shifts_m)
        return RigidTransform(rotation=rotation.as_matrix(), translation=shift) @ self.rest

"""What motion capture delivers: a skeleton, and per frame how its joints are turned."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vntoolkit.arrays import FloatArray, Matrix3, Points, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadMotion
from vntoolkit.geometry.skeleton import Skeleton

_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A moving skeleton.

    rotations: (frames, j, 4) unit quaternions (x, y, z, w), each joint's turn against its parent.
    root_positions: (frames, 3) of the root joint. frame_rate_hz: frames per second. metres_per_unit: the
    length of 1 in metres, or None where the file does not say (BVH never does).
    """

    skeleton: Skeleton
    rotations: FloatArray
    root_positions: Points
    frame_rate_hz: float
    metres_per_unit: float | None = None

    def __post_init__(self) -> None:
        rotations = np.asarray(self.rotations, dtype=np.float64)
        positions = np.asarray(self.root_positions, dtype=np.float64)
        require_shape(rotations, (None, len(self.skeleton.names), 4), "joint rotations", BadMotion)
        require_shape(positions, (len(rotations), 3), "root positions", BadMotion)
        require_finite(rotations, "joint rotations", BadMotion)
        require_finite(positions, "root positions", BadMotion)
        if not len(rotations):
            raise BadMotion("motion: expected at least one frame")
        if np.abs(np.linalg.norm(rotations, axis=-1) - 1).max() > _UNIT_TOLERANCE:
            raise BadMotion("joint rotations: expected unit quaternions")
        if not 0 < self.frame_rate_hz < np.inf:
            raise BadMotion(f"frame rate: expected a positive number, got {self.frame_rate_hz}")
        if self.metres_per_unit is not None and not 0 < self.metres_per_unit < np.inf:
            raise BadMotion(f"metres per unit: expected a positive number, got {self.metres_per_unit}")
        object.__setattr__(self, "rotations", read_only(rotations))
        object.__setattr__(self, "root_positions", read_only(positions))

    def __len__(self) -> int:
        return int(self.rotations.shape[0])

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last frame."""
        return (len(self) - 1) / self.frame_rate_hz

    def turned(self, rotation: Matrix3) -> Motion:
        """Return the motion in axes turned by `rotation` (3, 3): rest pose, positions and joint turns."""
        rotation = np.asarray(rotation, dtype=np.float64)
        skeleton = replace(
            self.skeleton,
            offsets=self.skeleton.offsets @ rotation.T,
            tip_offsets=self.skeleton.tip_offsets @ rotation.T,
        )
        axes, scalars = self.rotations[..., :3], self.rotations[..., 3:]
        return replace(
            self,
            skeleton=skeleton,
            rotations=np.concatenate([axes @ rotation.T, scalars], axis=-1),
            root_positions=self.root_positions @ rotation.T,
        )

    def in_metres(self, figure_height_m: float) -> Motion:
        """Return the motion in metres; a file without unit is scaled to the figure's height in metres."""
        height = self.skeleton.height
        if self.metres_per_unit is None and not height > 0:
            raise BadMotion("motion: the skeleton has no height, so its scale cannot be guessed")
        factor = self.metres_per_unit if self.metres_per_unit is not None else figure_height_m / height
        return replace(
            self,
            skeleton=self.skeleton.scaled(factor),
            root_positions=self.root_positions * factor,
            metres_per_unit=1.0,
        )

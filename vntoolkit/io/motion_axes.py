"""Motion between the axes on disk (y up) and in memory (y down): half a turn about x, its own inverse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vntoolkit.geometry.motion import Motion
from vntoolkit.geometry.skeleton import Skeleton
from vntoolkit.io.conventions import graphics_from_camera


def skeleton_with_axes_turned(skeleton: Skeleton) -> Skeleton:
    """Return the skeleton in the other of the two frames."""
    return replace(
        skeleton,
        offsets=graphics_from_camera(skeleton.offsets),
        tip_offsets=graphics_from_camera(skeleton.tip_offsets),
    )


def motion_with_axes_turned(motion: Motion) -> Motion:
    """Return the motion in the other of the two frames."""
    axes, scalars = motion.rotations[..., :3], motion.rotations[..., 3:]
    return replace(
        motion,
        skeleton=skeleton_with_axes_turned(motion.skeleton),
        rotations=np.concatenate([graphics_from_camera(axes), scalars], axis=-1),
        root_positions=graphics_from_camera(motion.root_positions),
    )

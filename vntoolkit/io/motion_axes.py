"""Motion between the axes on disk (y up) and in memory (y down): half a turn about x, its own inverse."""

from __future__ import annotations

import numpy as np

from vntoolkit.geometry.motion import Motion
from vntoolkit.io.conventions import graphics_from_camera


def motion_with_axes_turned(motion: Motion) -> Motion:
    """Return the motion in the other of the two frames."""
    return motion.turned(graphics_from_camera(np.eye(3)))

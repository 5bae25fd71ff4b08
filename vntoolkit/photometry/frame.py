"""One linear colour frame of a capture: what every later stage starts from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import LinearImage, Mask, read_only
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput


@dataclass(frozen=True, kw_only=True, eq=False)
class LinearFrame:
    """Light as the camera measured it, in three channels.

    rgb: (h, w, 3) float32, linear, black level removed, 1.0 = full scale (slightly negative where noise
    lies below black). clipped: (h, w) bool, True where any channel reached the white level.
    number: the frame's number in its capture, counted from 0.
    """

    rgb: LinearImage
    clipped: Mask
    number: int = 0

    def __post_init__(self) -> None:
        rgb = np.asarray(self.rgb, dtype=np.float32)
        require_shape(rgb, (None, None, 3), "frame")
        clipped = np.asarray(self.clipped)
        require_shape(clipped, rgb.shape[:2], "clipped mask")
        if clipped.dtype != np.bool_:
            raise BadInput(f"clipped mask: expected booleans, got {clipped.dtype}")
        object.__setattr__(self, "rgb", read_only(rgb))
        object.__setattr__(self, "clipped", read_only(clipped))

    @property
    def shape(self) -> tuple[int, int]:
        """(h, w)."""
        return self.rgb.shape[0], self.rgb.shape[1]

"""Normal map conventions on disk, and the one flip between the camera and the graphics frame."""

from __future__ import annotations

from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray


class NormalConvention(Enum):
    """Axes of a normal map file.

    OPENGL: x right, y up, z towards the viewer (Blender, DiLiGenT, ours; the default). DIRECTX: the same with
    y down (green flipped). OPENCV: x right, y down, z away from the viewer, the camera frame itself.
    """

    OPENGL = "opengl"
    DIRECTX = "directx"
    OPENCV = "opencv"

    @property
    def signs(self) -> tuple[float, float, float]:
        """Factors of x, y, z between the camera frame and this convention; their own inverse."""
        return {"opengl": (1.0, -1.0, -1.0), "directx": (1.0, 1.0, -1.0), "opencv": (1.0, 1.0, 1.0)}[
            self.value
        ]


def graphics_from_camera(vectors: FloatArray) -> FloatArray:
    """Turn points or directions (..., 3) by half a turn about x; its own inverse, windings stay."""
    vectors = np.asarray(vectors)
    return vectors * np.array([1, -1, -1], dtype=vectors.dtype)

"""Axes on disk: conventions of normal maps, and the flip between camera frame and graphics frame."""

from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.motion import Motion


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


class MeshUpAxis(Enum):
    """Which axis of a mesh file points up.

    Y: x right, y up, z towards the viewer (ours, MeshLab's, glTF's; the default). Z: x right, y away from the
    viewer, z up (Blender's own, CAD's, robotics').
    """

    Y = "y"
    Z = "z"

    @property
    def meaning(self) -> str:
        """The three axes in words."""
        if self is MeshUpAxis.Y:
            return "x right, y up, z towards the viewer"
        return "x right, y away from the viewer, z up"


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


def motion_with_axes_turned(motion: Motion) -> Motion:
    """Return the motion in the other frame: y up on disk, y down in memory."""
    return motion.turned(graphics_from_camera(np.eye(3)))

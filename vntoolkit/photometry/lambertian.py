"""The forward model: the colour of a matte surface under three coloured lights."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.photometry.response import LightResponse


def rgb_from_normals(normals_in_camera: FloatArray, response: LightResponse) -> FloatArray:
    """Equation 1: r = M n (+ ambient), where all three lights reach the surface.

    normals_in_camera: (..., 3). Returns (..., 3) linear RGB.
    """
    return np.asarray(normals_in_camera) @ response.matrix.T + response.ambient


def shaded_rgb_from_normals(normals_in_camera: FloatArray, response: LightResponse) -> FloatArray:
    """Equation 1 with attached shadow: each light's share is cut off where it turns negative.

    normals_in_camera: (..., 3). Returns (..., 3). Needs the lights apart: with `light_colours` unknown, a
    channel stands for a light.
    """
    contributions = np.maximum(np.asarray(normals_in_camera) @ response.lights.T, 0.0)
    colours = np.eye(3) if response.light_colours is None else response.light_colours
    return contributions @ colours + response.ambient

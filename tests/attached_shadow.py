"""The forward model with attached shadow, for captures that tests make themselves."""

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.photometry.response import LightResponse


def shaded_rgb_from_normals(normals_in_camera: FloatArray, response: LightResponse) -> FloatArray:
    """Equation 1 with attached shadow: each light's share is cut off where it turns negative.

    normals_in_camera: (..., 3). Returns (..., 3). Needs the lights apart: with `light_colours` unknown, a
    channel stands for a light. A response that varies is taken at its centre.
    """
    contributions = np.maximum(np.asarray(normals_in_camera) @ response.lights.T, 0.0)
    colours = np.eye(3) if response.light_colours is None else response.light_colours
    return contributions @ colours + response.ambient

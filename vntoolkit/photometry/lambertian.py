"""The forward model: the colour of a matte surface under three coloured lights; and its inverse."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.photometry.response import LightResponse


def rgb_from_normals(
    normals_in_camera: FloatArray, response: LightResponse, positions_px: FloatArray | None = None
) -> FloatArray:
    """Equation 1: r = M n (+ ambient), where all three lights reach the surface.

    normals_in_camera: (..., 3). positions_px: (..., 2), which only a response that varies over the image
    needs; default: the pixels of an image (h, w, 3). Returns (..., 3) linear RGB.
    """
    normals = np.asarray(normals_in_camera)
    if response.variation is None:
        return normals @ response.matrix.T + response.ambient
    matrices, ambients = response.at(_positions(positions_px, normals))
    return np.asarray((matrices @ normals[..., None])[..., 0] + ambients)


def scaled_normals_from_rgb(
    rgb: FloatArray, response: LightResponse, positions_px: FloatArray | None = None
) -> FloatArray:
    """Equation 1 solved for the normal times the relative albedo: M⁻¹(r − a), (..., 3).

    rgb: (..., 3). positions_px: as for `rgb_from_normals`.
    """
    if response.variation is None:
        return np.asarray((rgb - response.ambient) @ response.inverse.T)
    matrices, ambients = response.at(_positions(positions_px, rgb))
    return np.asarray(np.linalg.solve(matrices, (rgb - ambients)[..., None])[..., 0])


def shaded_rgb_from_normals(normals_in_camera: FloatArray, response: LightResponse) -> FloatArray:
    """Equation 1 with attached shadow: each light's share is cut off where it turns negative.

    normals_in_camera: (..., 3). Returns (..., 3). Needs the lights apart: with `light_colours` unknown, a
    channel stands for a light. A response that varies is taken at its centre.
    """
    contributions = np.maximum(np.asarray(normals_in_camera) @ response.lights.T, 0.0)
    colours = np.eye(3) if response.light_colours is None else response.light_colours
    return contributions @ colours + response.ambient


def _positions(positions_px: FloatArray | None, values: FloatArray) -> FloatArray:
    if positions_px is not None:
        return positions_px
    v, u = np.indices(values.shape[:2])
    return np.stack([u, v], axis=-1).astype(np.float64)

"""The Lambertian model: the colour of a matte surface under three coloured lights, and its inverse."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from vntoolkit.arrays import FloatArray, LinearImage
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
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


def _positions(positions_px: FloatArray | None, values: FloatArray) -> FloatArray:
    if positions_px is not None:
        return positions_px
    v, u = np.indices(values.shape[:2])
    return np.stack([u, v], axis=-1).astype(np.float64)


class Leveller:
    """Converts a frame from M(u, v) to the M₀ of the centre: r' = M₀ M(u, v)⁻¹ (r − a(u, v)) + a₀.

    For stages that need one M, such as shadow detection. Exact where all three lights reach the pixel. Where
    one does not, the mixing adds a little of the other lights to it, less so the more the lights' directions
    at the pixel resemble those at the centre. To detect missing lights, use `frame_by_strength`.
    """

    def __init__(self, response: LightResponse, shape: tuple[int, int]) -> None:
        v, u = np.indices(shape)
        matrices, ambients = response.at(np.stack([u, v], axis=-1))
        mix = response.matrix @ np.linalg.inv(matrices)
        offset = response.ambient - (mix @ ambients[..., None])[..., 0]
        self._mix, self._offset = mix.astype(np.float32), offset.astype(np.float32)
        split = response.contributions_from_rgb
        gains = np.linalg.norm(response.lights, axis=1) / np.linalg.norm(split @ matrices, axis=-1)
        scale = np.linalg.inv(split) @ (gains[..., None] * split)
        self._scale = scale.astype(np.float32)
        self._scale_offset = (response.ambient - (scale @ ambients[..., None])[..., 0]).astype(np.float32)

    def frame(self, frame: LinearFrame) -> LinearFrame:
        """Return the frame as the response of the centre would have formed it."""
        return _mixed(frame, self._mix, self._offset)

    def frame_by_strength(self, frame: LinearFrame) -> LinearFrame:
        """Return the frame with every light as strong as at the centre; a missing light stays missing.

        The lights' directions remain those of the pixel, so normals computed from it have a small error.
        """
        return _mixed(frame, self._scale, self._scale_offset)


@lru_cache(maxsize=1)
def leveller_of(response: LightResponse, shape: tuple[int, int]) -> Leveller:
    """Return the leveller of frames (h, w); the last one is kept, since it takes longer than a frame."""
    return Leveller(response, shape)


def _mixed(frame: LinearFrame, mix: FloatArray, offset: FloatArray) -> LinearFrame:
    rgb = np.empty(frame.rgb.shape, np.float32)
    _mix_kernel(np.ascontiguousarray(frame.rgb), mix, offset, rgb)
    return LinearFrame(rgb=rgb, clipped=frame.clipped, number=frame.number)


@njit(cache=True)
def _mix_kernel(rgb: LinearImage, mix: FloatArray, offset: FloatArray, out: LinearImage) -> None:
    height, width = rgb.shape[:2]
    for v in range(height):
        for u in range(width):
            r, g, b = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
            for i in range(3):
                mixed = mix[v, u, i, 0] * r + mix[v, u, i, 1] * g + mix[v, u, i, 2] * b
                out[v, u, i] = mixed + offset[v, u, i]

"""Footage under near lights, made to look as if one response held for the whole image."""

from __future__ import annotations

import numpy as np

from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse


class Leveller:
    """Takes each pixel from its own response to the central one: r' = M₀ M(u, v)⁻¹ (r − a(u, v)) + a₀.

    For stages that reason about lights (shadows) and know one M. Exact where all three lights arrive; where
    one does not, as good as the lights' directions at the pixel resemble those at the centre: the mixing
    lends a missing light a little of the others. To see which lights are missing, use `frame_by_strength`.
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
        """Return the frame as the central response would have made it."""
        rgb = np.einsum("vuij,vuj->vui", self._mix, frame.rgb) + self._offset
        return LinearFrame(rgb=rgb, clipped=frame.clipped, number=frame.number)

    def frame_by_strength(self, frame: LinearFrame) -> LinearFrame:
        """Return the frame with every light as strong as at the centre, a missing one still missing.

        The directions stay the pixel's own, so that normals from it are a little off.
        """
        rgb = np.einsum("vuij,vuj->vui", self._scale, frame.rgb) + self._scale_offset
        return LinearFrame(rgb=rgb, clipped=frame.clipped, number=frame.number)

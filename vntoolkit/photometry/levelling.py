"""Footage under near lights, made to look as if one response held for the whole image."""

from __future__ import annotations

import numpy as np

from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse


class Leveller:
    """Takes each pixel from its own response to the central one: r' = M₀ M(u, v)⁻¹ (r − a(u, v)) + a₀.

    For stages that reason about lights (shadows) and know one M. Exact where all three lights arrive; where
    one does not, as good as the lights' directions at the pixel resemble those at the centre.
    """

    def __init__(self, response: LightResponse, shape: tuple[int, int]) -> None:
        v, u = np.indices(shape)
        matrices, ambients = response.at(np.stack([u, v], axis=-1))
        mix = response.matrix @ np.linalg.inv(matrices)
        offset = response.ambient - (mix @ ambients[..., None])[..., 0]
        self._mix, self._offset = mix.astype(np.float32), offset.astype(np.float32)

    def frame(self, frame: LinearFrame) -> LinearFrame:
        """Return the frame as the central response would have made it."""
        rgb = np.einsum("vuij,vuj->vui", self._mix, frame.rgb) + self._offset
        return LinearFrame(rgb=rgb, clipped=frame.clipped, number=frame.number)

"""Some pixels of the surface, with M⁻¹ and ambient light at each, for checks of the lengths M⁻¹(r − a)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.diagnosis.evidence import Evidence, Single, lengths_of, scaled_normals

_BLUR_PX = 1.0
_RIM_PX = 2
_STEEPEST = 0.15
_PIXELS_A_FRAME = 4000


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePixels:
    """rgb: (n, 3). inverse: M⁻¹, (3, 3) or (n, 3, 3). ambient: (3,) or (n, 3). blocks, frames: (n,) numbers.

    blocks_a_side: block k lies in row k // blocks_a_side. positions: (n, 2) from the picture's centre, in
    halves of its larger side.
    """

    rgb: FloatArray
    inverse: FloatArray
    ambient: FloatArray
    blocks: npt.NDArray[np.int64]
    frames: npt.NDArray[np.int64]
    blocks_a_side: int
    positions: FloatArray

    def __len__(self) -> int:
        return len(self.rgb)

    def of(self, chosen: Mask | slice) -> SurfacePixels:
        """Return some of them."""
        return SurfacePixels(
            rgb=self.rgb[chosen],
            inverse=self.inverse if self.inverse.ndim == 2 else self.inverse[chosen],
            ambient=self.ambient if self.ambient.ndim == 1 else self.ambient[chosen],
            blocks=self.blocks[chosen],
            frames=self.frames[chosen],
            blocks_a_side=self.blocks_a_side,
            positions=self.positions[chosen],
        )

    def scaled_normals(self, rgb: FloatArray) -> FloatArray:
        """Return M⁻¹(rgb − a), (n, 3)."""
        lit = rgb - self.ambient
        if self.inverse.ndim == 2:
            return np.asarray(lit @ self.inverse.T)
        return np.asarray(np.einsum("nij,nj->ni", self.inverse, lit))

    def colours(self, scaled: FloatArray) -> FloatArray:
        """Return M n + a, (n, 3)."""
        matrix = np.linalg.inv(self.inverse)
        return np.asarray(np.einsum("...ij,...j->...i", matrix, scaled) + self.ambient)


def surface_pixels(evidence: Evidence, chosen: Callable[[int, Single], Mask]) -> SurfacePixels:
    """Return pixels that face the camera, well inside what is chosen.

    chosen: gives, for a frame's number and the lengths (h, w) of its M⁻¹(r − a), the pixels to take, (h, w);
    the length of one that faces away is 0.
    """
    rgb, index = [], []
    size = 2 * _RIM_PX + 1
    for k, frame in enumerate(evidence.light):
        light = cv2.GaussianBlur(frame, (0, 0), _BLUR_PX)
        scaled = scaled_normals(evidence, light)
        length = lengths_of(scaled)
        facing = scaled[..., 2] < -_STEEPEST * length
        good = (facing & chosen(k, np.where(facing, length, np.float32(0.0)))).astype(np.uint8)
        places = np.flatnonzero(cv2.erode(good, np.ones((size, size), np.uint8), borderValue=0))
        places = places[:: max(1, len(places) // _PIXELS_A_FRAME)]
        rgb.append(light.reshape(-1, 3)[places])
        index.append(places)
    frames = np.repeat(np.arange(len(index)), [len(places) for places in index])
    places = np.concatenate(index)
    height, width = evidence.light.shape[1:3]
    v, u = np.divmod(places, width)
    centred = np.stack([u - (width - 1) / 2, v - (height - 1) / 2], axis=1)
    inverse, ambient = evidence.inverse.astype(np.float64), evidence.ambient.astype(np.float64)
    return SurfacePixels(
        rgb=np.concatenate(rgb).astype(np.float64),
        inverse=inverse if inverse.ndim == 2 else inverse.reshape(-1, 3, 3)[places],
        ambient=ambient if ambient.ndim == 1 else ambient.reshape(-1, 3)[places],
        blocks=evidence.blocks.ravel()[places],
        frames=frames,
        blocks_a_side=math.isqrt(int(evidence.blocks.max()) + 1),
        positions=centred / (max(height, width) / 2),
    )

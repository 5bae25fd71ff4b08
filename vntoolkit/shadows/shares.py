"""What a frame says of each light: contributions, albedo and normal under full light, trust in the colour."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Matrix3, Weight
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

_CLIPPED_TRUST = 0.05  # a saturated channel is a bound, not a value
_SMALLEST_ALBEDO = 1e-3


@dataclass(frozen=True, kw_only=True, eq=False)
class LightShares:
    """One frame, split by light.

    contributions: (h, w, 3), light k's part of the colour (a channel where the light colours are unknown).
    lights: (3, 3), row k = direction times strength; directions: the same, unit length. length, normals:
    (h, w) and (h, w, 3), |M⁻¹(r − a)| and its direction, albedo and normal where all lights arrive. trust:
    (h, w), 1, less where clipped.
    """

    contributions: FloatArray
    lights: Matrix3
    directions: Matrix3
    length: FloatArray
    normals: FloatArray
    trust: Weight

    def relative_to(self, albedo: FloatArray) -> FloatArray:
        """Contributions over the albedo (h, w): L_k · n where light k arrives."""
        return self.contributions / np.maximum(albedo, _SMALLEST_ALBEDO)[..., None]

    def shares(self, albedo: FloatArray) -> FloatArray:
        """Contributions over albedo and strength: the cosine to each light where it arrives."""
        return self.relative_to(albedo) / np.linalg.norm(self.lights, axis=1).astype(np.float32)

    def shrunk(self, mask: Mask, factor: int) -> tuple[LightShares, Mask]:
        """Return the same frame, and its mask, at 1/factor of the size, averaged over the mask."""
        size = (max(1, round(mask.shape[1] / factor)), max(1, round(mask.shape[0] / factor)))
        cover = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)

        def mean(image: FloatArray) -> FloatArray:
            inside = image * (mask if image.ndim == 2 else mask[..., None])
            small = cv2.resize(inside.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            return small / np.maximum(cover if image.ndim == 2 else cover[..., None], 1e-6)

        scaled = mean(self.normals * self.length[..., None])
        length, normals = _length_and_direction(scaled)
        small = LightShares(
            contributions=mean(self.contributions),
            lights=self.lights,
            directions=self.directions,
            length=length,
            normals=normals,
            trust=mean(self.trust),
        )
        return small, cover > 0.5


def shares_from_frame(frame: LinearFrame, response: LightResponse) -> LightShares:
    """Split a frame by light; values that are not finite count as black."""
    rgb = np.nan_to_num(frame.rgb - response.ambient.astype(np.float32), posinf=1.0, neginf=0.0)
    contributions = rgb @ response.contributions_from_rgb.T.astype(np.float32)
    scaled = rgb @ response.inverse.T.astype(np.float32)
    length, normals = _length_and_direction(scaled)
    return LightShares(
        contributions=contributions,
        lights=response.lights,
        directions=response.light_directions,
        length=length,
        normals=normals,
        trust=np.where(frame.clipped, _CLIPPED_TRUST, 1.0).astype(np.float32),
    )


def _length_and_direction(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split (h, w, 3) into length and direction; towards the viewer where there is no length."""
    length = np.linalg.norm(vectors, axis=-1)
    some = (length > 1e-6)[..., None]
    direction = np.where(some, vectors / np.maximum(length, 1e-6)[..., None], (0.0, 0.0, -1.0))
    return length, direction.astype(np.float32)

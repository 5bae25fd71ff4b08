"""What a frame says of each light: contributions, albedo and normal under full light, trust in the colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Matrix3, Vector3, Weight
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

_WORKING_PIXELS = 100_000  # surfaces are solved on images of about this size: more show no other shadows
_CLIPPED_TRUST = 0.05  # a saturated channel is a bound, not a value
_SMALLEST_ALBEDO = 1e-3
_SMALLEST_REST = 0.05  # 1 − |M⁻¹a|²: an ambient light as strong as the lamps leaves no root
_MARGIN_PX = 4  # room for filters around the mask
Window = tuple[slice, slice]
TOWARDS_VIEWER = np.array([0.0, 0.0, -1.0], dtype=np.float32)  # single, so that images stay so


@dataclass(frozen=True, kw_only=True, eq=False)
class LightShares:
    """One frame, split by light.

    contributions: (h, w, 3), light k's part of the colour (a channel where the light colours are unknown),
    with the ambient light in it. ambient: (3,), its part of that on a surface of albedo 1; it comes back from
    the surface like any light, so on dark hair little of it does. lights: (3, 3), row k = direction times
    strength; directions: the same, unit length. length, normals: (h, w) and (h, w, 3), albedo and normal
    where all lights arrive. trust: (h, w), 1, less where clipped.
    """

    contributions: FloatArray
    ambient: Vector3
    lights: Matrix3
    directions: Matrix3
    length: FloatArray
    normals: FloatArray
    trust: Weight

    def relative_to(self, albedo: FloatArray) -> FloatArray:
        """Contributions over the albedo (h, w): L_k · n where light k arrives."""
        relative = self.contributions / np.maximum(albedo, _SMALLEST_ALBEDO)[..., None]
        return relative - self.ambient.astype(np.float32)

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
            ambient=self.ambient,
            lights=self.lights,
            directions=self.directions,
            length=length,
            normals=normals,
            trust=mean(self.trust),
        )
        return small, cover > 0.5


def shrinking(mask: Mask) -> int:
    """Return by what whole factor a surface is solved smaller than the image of `mask`."""
    return max(1, round(float(np.sqrt(mask.size / _WORKING_PIXELS))))


def shares_from_frame(frame: LinearFrame, response: LightResponse) -> LightShares:
    """Split a frame by light; values that are not finite count as black."""
    rgb = np.nan_to_num(frame.rgb, posinf=1.0, neginf=0.0)
    contributions = rgb @ response.contributions_from_rgb.T.astype(np.float32)
    length, normals = _albedo_and_normal(rgb, response)
    return LightShares(
        contributions=contributions,
        ambient=response.contributions_from_rgb @ response.ambient,
        lights=response.lights,
        directions=response.light_directions,
        length=length,
        normals=normals,
        trust=np.where(frame.clipped, _CLIPPED_TRUST, 1.0).astype(np.float32),
    )


def _albedo_and_normal(rgb: FloatArray, response: LightResponse) -> tuple[FloatArray, FloatArray]:
    """Solve r = ρ (M n + a), |n| = 1, for the albedo ρ (h, w) and the normal n (h, w, 3).

    With v = M⁻¹r and w = M⁻¹a, |v − ρ w| = ρ is a quadratic in ρ with one positive root as long as the
    ambient light is weaker than the lamps.
    """
    scaled = rgb @ response.inverse.T.astype(np.float32)
    haze = (response.inverse @ response.ambient).astype(np.float32)
    rest = max(1.0 - float(haze @ haze), _SMALLEST_REST)
    along = scaled @ haze
    albedo = (np.sqrt(along**2 + rest * np.einsum("...i,...i->...", scaled, scaled)) - along) / rest
    _, normals = _length_and_direction(scaled - albedo[..., None] * haze)
    return albedo, normals


def _length_and_direction(vectors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Split (h, w, 3) into length and direction; towards the viewer where there is no length."""
    length = lengths_of(vectors)[..., 0]
    some = (length > 1e-6)[..., None]
    direction = np.where(some, vectors / np.maximum(length, 1e-6)[..., None], TOWARDS_VIEWER)
    return length, direction.astype(np.float32)


# The rectangle around a mask: where a figure fills a third of its frame, the rest shall take no time.


def window_around(mask: Mask) -> Window:
    """Return (rows, columns) that hold all of `mask` and a margin; the whole image where it is empty."""
    if not mask.any():
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    return _span(np.asarray(mask.any(axis=1))), _span(np.asarray(mask.any(axis=0)))


def frame_in_window(frame: LinearFrame, window: Window) -> LinearFrame:
    """Return the frame's pixels in the window."""
    return LinearFrame(rgb=frame.rgb[window], clipped=frame.clipped[window], number=frame.number)


def in_whole_image(
    part: npt.NDArray[Any], window: Window, shape: tuple[int, ...], outside: Any = 0
) -> npt.NDArray[Any]:
    """Return an image of (h, w) = `shape` with `part` in the window and `outside` around it."""
    if part.shape[:2] == shape[:2]:
        return part
    whole = np.full((*shape[:2], *part.shape[2:]), outside, dtype=part.dtype)
    whole[window] = part
    return whole


def _span(used: npt.NDArray[np.bool_]) -> slice:
    first, last = int(used.argmax()), len(used) - int(used[::-1].argmax())
    return slice(max(first - _MARGIN_PX, 0), min(last + _MARGIN_PX, len(used)))


# Reductions of many short vectors; numpy's own, over an axis of three, take five times as long.


def lengths_of(vectors: FloatArray) -> FloatArray:
    """Return the lengths (..., 1) of vectors (..., n)."""
    squared: FloatArray = np.einsum("...i,...i->...", vectors, vectors)
    return np.sqrt(squared)[..., None]


def largest_of_three(values: FloatArray) -> FloatArray:
    """Return the largest (...) of values (..., 3)."""
    return np.maximum(np.maximum(values[..., 0], values[..., 1]), values[..., 2])


def median_of_three(values: FloatArray) -> FloatArray:
    """Return the median (...) of values (..., 3)."""
    first, second, third = values[..., 0], values[..., 1], values[..., 2]
    low, high = np.minimum(first, second), np.maximum(first, second)
    return np.maximum(low, np.minimum(high, third))


def all_of_three(values: Mask) -> Mask:
    """Return where all of (..., 3) booleans are True, (...)."""
    return values[..., 0] & values[..., 1] & values[..., 2]

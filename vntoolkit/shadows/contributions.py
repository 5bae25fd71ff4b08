"""What a frame says of each light: contributions, albedo and normal under full light, trust in the colour."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import cv2
import numpy as np

from vntoolkit.arrays import Array, ArrayLike, BoolArray, FloatArray, Mask, Matrix3, Vector3, Weight
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

_WORKING_PIXELS = 100_000  # surfaces are solved on images of about this size: more show no other shadows
_CLIPPED_TRUST = 0.05  # a saturated channel is a bound, not a value
_SMALLEST_ALBEDO = 1e-3
_SMALLEST_REST = 0.05  # 1 − |M⁻¹a|²: an ambient light as strong as the lamps leaves no root
_MARGIN_PX = 4  # room for filters around the mask
Window = tuple[slice, slice]
Numbers = tuple[Any, ...]  # float32


@dataclass(frozen=True, kw_only=True, eq=False)
class LightContributions:
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
        return self._over(albedo, np.ones(3))

    def cosines(self, albedo: FloatArray) -> FloatArray:
        """Contributions over albedo and strength: the cosine to each light where it arrives."""
        return self._over(albedo, 1.0 / np.linalg.norm(self.lights, axis=1))

    def _over(self, albedo: FloatArray, scale: Vector3) -> FloatArray:
        over = np.float32(1.0) / np.maximum(albedo, np.float32(_SMALLEST_ALBEDO))
        relative: FloatArray = np.empty_like(self.contributions)
        for k in range(3):  # a fifth of the time of one product over an axis of three
            np.multiply(self.contributions[..., k], over * np.float32(scale[k]), out=relative[..., k])
            relative[..., k] -= np.float32(self.ambient[k] * scale[k])
        return relative


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkingImage:
    """A frame at the size on which its surface is solved.

    rgb: (h, w, 3). trust: (h, w), 1, less where clipped. mask: (h, w), the subject. camera: that sees
    this image, None for orthographic.
    """

    rgb: FloatArray
    trust: Weight
    mask: Mask
    response: LightResponse
    camera: Camera | None

    @cached_property
    def light(self) -> LightContributions:
        """What the image says of each light."""
        return contributions_from_rgb(self.rgb, self.response, self.trust)

    @cached_property
    def halved(self) -> "WorkingImage":
        """The image at half the size; made once, for all who ask."""
        return self.shrunk(2)

    def shrunk(self, factor: int) -> "WorkingImage":
        """Return the image at 1/factor of the size, averaged over the mask."""
        size = [max(1, round(length / factor)) for length in self.mask.shape[::-1]]
        inside = self.mask.astype(np.float32)
        sums = (self.rgb * inside[..., None], self.trust * inside, inside)
        rgb, trust, cover = (cv2.resize(image, size, interpolation=cv2.INTER_AREA) for image in sums)
        over = 1.0 / np.maximum(cover, np.float32(1e-6))
        return WorkingImage(
            rgb=rgb * over[..., None],
            trust=np.asarray(trust * over, dtype=np.float32),
            mask=cover > 0.5,
            response=self.response,
            camera=None if self.camera is None else self.camera.scaled(1.0 / factor),
        )


def working_image(
    frame: LinearFrame, response: LightResponse, mask: Mask, camera: Camera | None
) -> tuple[WorkingImage, int]:
    """Return a frame at a size that suffices, and its pixels per pixel of that size."""
    image = WorkingImage(
        rgb=np.ascontiguousarray(frame.rgb, dtype=np.float32),
        trust=_trust_of(frame),
        mask=mask,
        response=response,
        camera=camera,
    )
    factor = shrinking(mask)
    return (image if factor == 1 else image.shrunk(factor)), factor


def shrinking(mask: Mask) -> int:
    """Return by what whole factor a surface is solved smaller than the image of `mask`."""
    return max(1, round(float(np.sqrt(mask.size / _WORKING_PIXELS))))


def contributions_from_frame(frame: LinearFrame, response: LightResponse) -> LightContributions:
    """Split a frame by light."""
    return contributions_from_rgb(
        np.ascontiguousarray(frame.rgb, dtype=np.float32), response, _trust_of(frame)
    )


def contributions_from_rgb(rgb: FloatArray, response: LightResponse, trust: Weight) -> LightContributions:
    """Split an image (h, w, 3) by light. trust: (h, w), 1, less where clipped."""
    contributions, normals = np.empty_like(rgb), np.empty_like(rgb)
    length = np.empty(rgb.shape[:2], np.float32)
    ambient, rest = _ambient_of(response)
    _split_kernel(
        flat(rgb), numbers_of(response.contributions_from_rgb), numbers_of(response.inverse),
        numbers_of(ambient), np.float32(rest), flat(contributions), length, flat(normals),
    )  # fmt: skip
    return LightContributions(
        contributions=contributions,
        ambient=response.contributions_from_rgb @ response.ambient,
        lights=response.lights,
        directions=response.light_directions,
        length=length,
        normals=normals,
        trust=trust,
    )


def _trust_of(frame: LinearFrame) -> Weight:
    return np.where(frame.clipped, np.float32(_CLIPPED_TRUST), np.float32(1.0))


def _ambient_of(response: LightResponse) -> tuple[FloatArray, float]:
    """Return w = M⁻¹a, (3,) float32, and 1 − |w|²."""
    ambient: FloatArray = (response.inverse @ response.ambient).astype(np.float32)
    return ambient, max(1.0 - float(ambient @ ambient), _SMALLEST_REST)


def brighter_than(frame: LinearFrame, response: LightResponse, darkest: float, mask: Mask) -> Mask:
    """Return (h, w), the pixels of a mask whose M⁻¹(r − a) is longer than `darkest`."""
    affine = np.column_stack([response.inverse, -response.inverse @ response.ambient])
    scaled = cv2.transform(np.asarray(frame.rgb, np.float32), affine)
    return mask & (np.einsum("vuc,vuc->vu", scaled, scaled) > darkest**2)


@njit
def _split_kernel(
    rgb: FloatArray, split: Numbers, inverse: Numbers, ambient: Numbers, rest: np.float32,
    contributions: FloatArray, length: FloatArray, normals: FloatArray,
) -> None:  # fmt: skip
    """Fill the contributions, the albedo and the normal. rest: 1 − |w|²."""
    h, w = length.shape
    for v in range(h):
        line, seen, size, normal = rgb[v], contributions[v], length[v], normals[v]
        for u in range(w):
            r, g, b = line[3 * u], line[3 * u + 1], line[3 * u + 2]
            seen[3 * u], seen[3 * u + 1], seen[3 * u + 2] = _turned(split, r, g, b)
            normal[3 * u], normal[3 * u + 1], normal[3 * u + 2], size[u] = _scaled_normal(
                r, g, b, inverse, ambient, rest
            )


# Parts of compiled loops. The compiler does eight pixels at a time where what is the same for all of them
# comes as tuples of numbers, rows are slices that begin at 0, and images of three channels are flat.


def flat(image: FloatArray) -> FloatArray:
    """Return an image (h, w, 3) as rows (h, 3 w), float32: how far apart pixels are must be known."""
    single: FloatArray = np.ascontiguousarray(image, dtype=np.float32)
    return single.reshape(len(single), -1)


def numbers_of(values: ArrayLike) -> Numbers:
    """Return an array's values as a flat tuple of float32."""
    return tuple(np.float32(value) for value in np.ravel(np.asarray(values)))


@njit(forceinline=True)
def _turned(matrix: Numbers, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Return a 3×3 matrix, nine numbers, times a vector."""
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[3] * x + matrix[4] * y + matrix[5] * z,
        matrix[6] * x + matrix[7] * y + matrix[8] * z,
    )


@njit(forceinline=True)
def _scaled_normal(
    r: Any, g: Any, b: Any, inverse: Numbers, ambient: Numbers, rest: Any
) -> tuple[Any, Any, Any, Any]:
    """Solve r = ρ (M n + a), |n| = 1, for the normal n and the albedo ρ.

    With s = M⁻¹r and w = M⁻¹a (ambient), |s − ρ w| = ρ is a quadratic in ρ with one positive root as long as
    the ambient light is weaker than the lamps. rest: 1 − |w|². Where there is no light the normal faces the
    viewer.
    """
    x, y, z = _turned(inverse, r, g, b)
    along = x * ambient[0] + y * ambient[1] + z * ambient[2]
    squared = x * x + y * y + z * z
    albedo = (np.sqrt(along * along + rest * squared) - along) / rest
    x, y, z = x - albedo * ambient[0], y - albedo * ambient[1], z - albedo * ambient[2]
    long = np.sqrt(x * x + y * y + z * z)
    sound = long > np.float32(1e-6)
    over = np.float32(1.0) / (long if sound else np.float32(1.0))
    zero = np.float32(0.0)
    return (
        x * over if sound else zero, y * over if sound else zero, z * over if sound else np.float32(-1.0),
        albedo,
    )  # fmt: skip


# The rectangle around a mask: where a figure fills a third of its frame, the rest shall take no time.


def window_around(mask: Mask) -> Window:
    """Return (rows, columns) that hold all of `mask` and a margin; the whole image where it is empty."""
    if not mask.any():
        return slice(0, mask.shape[0]), slice(0, mask.shape[1])
    return _span(np.asarray(mask.any(axis=1))), _span(np.asarray(mask.any(axis=0)))


def frame_in_window(frame: LinearFrame, window: Window) -> LinearFrame:
    """Return the frame's pixels in the window, laid out as a whole frame's: loops compile for each layout."""
    rgb: FloatArray = np.ascontiguousarray(frame.rgb[window])
    return LinearFrame(rgb=rgb, clipped=np.ascontiguousarray(frame.clipped[window]), number=frame.number)


def in_whole_image(part: Array, window: Window, shape: tuple[int, ...], outside: Any = 0) -> Array:
    """Return an image of (h, w) = `shape` with `part` in the window and `outside` around it."""
    if part.shape[:2] == shape[:2]:
        return part
    whole = np.full((*shape[:2], *part.shape[2:]), outside, dtype=part.dtype)
    whole[window] = part
    return whole


def _span(used: BoolArray) -> slice:
    first, last = int(used.argmax()), len(used) - int(used[::-1].argmax())
    return slice(max(first - _MARGIN_PX, 0), min(last + _MARGIN_PX, len(used)))


# Reductions of many short vectors; numpy's own, over an axis of three, take five times as long.


def lengths_of(vectors: FloatArray) -> FloatArray:
    """Return the lengths (..., 1) of vectors (..., n)."""
    squared: FloatArray = np.einsum("...i,...i->...", vectors, vectors)
    return np.sqrt(squared)[..., None]


def all_of_three(values: Mask) -> Mask:
    """Return where all of (..., 3) booleans are True, (...)."""
    return values[..., 0] & values[..., 1] & values[..., 2]


def largest_of_three(values: FloatArray) -> FloatArray:
    """Return the largest of (..., 3) values, (...)."""
    largest: FloatArray = np.maximum(np.maximum(values[..., 0], values[..., 1]), values[..., 2])
    return largest

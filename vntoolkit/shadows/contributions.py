"""What a frame says of each light: contributions, albedo and normal under full light, trust in the colour."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numba import prange

from vntoolkit.arrays import Array, ArrayLike, BoolArray, FloatArray, IntArray, Mask, Matrix3, Vector3, Weight
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.levelling import FLAGS
from vntoolkit.photometry.response import LightResponse

_WORKING_PIXELS = 100_000  # surfaces are solved on images of about this size: more show no other shadows
CLIPPED_TRUST = 0.05  # a saturated channel is a bound, not a value
_SMALLEST_ALBEDO = 1e-3
_SMALLEST_REST = 0.05  # 1 − |M⁻¹a|²: an ambient light as strong as the lamps leaves no root
_MARGIN_PX = 4  # room for filters around the mask
Window = tuple[slice, slice]
Numbers = tuple[Any, ...]  # float32
TOWARDS_VIEWER = np.array([0.0, 0.0, -1.0], dtype=np.float32)  # single, so that images stay so


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
        out: FloatArray = np.empty(self.contributions.shape, np.float32)
        _over_kernel(
            flat(self.contributions), np.ascontiguousarray(albedo, np.float32), numbers_of(self.ambient),
            numbers_of(scale), flat(out),
        )  # fmt: skip
        return out

    def shrunk(self, mask: Mask, factor: int) -> "tuple[LightContributions, Mask]":
        """Return the same frame, and its mask, at 1/factor of the size, averaged over the mask."""
        mean, cover = mean_inside(mask, factor)
        scaled = mean(self.normals * self.length[..., None])
        length, normals = _length_and_direction(scaled)
        small = LightContributions(
            contributions=mean(self.contributions),
            ambient=self.ambient,
            lights=self.lights,
            directions=self.directions,
            length=length,
            normals=normals,
            trust=mean(self.trust),
        )
        return small, cover > 0.5


@dataclass(frozen=True, kw_only=True, eq=False)
class WorkingImage:
    """A frame at the size on which its surface is solved.

    light: of (h, w) pixels, what the frame says of each light. mask: (h, w), the subject. camera: that sees
    this image, None for orthographic.
    """

    light: LightContributions
    mask: Mask
    camera: Camera | None

    @cached_property
    def halved(self) -> "WorkingImage":
        """The image at half the size; made once, for all who ask."""
        light, mask = self.light.shrunk(self.mask, 2)
        return WorkingImage(
            light=light, mask=mask, camera=None if self.camera is None else self.camera.scaled(0.5)
        )


def working_image(
    frame: LinearFrame, response: LightResponse, mask: Mask, camera: Camera | None
) -> tuple[WorkingImage, int]:
    """Split a frame by light, at a size that suffices; return also its pixels per pixel of that size."""
    factor = shrinking(mask)
    light, small_mask = _small_contributions(frame, response, mask, factor)
    small_camera = None if camera is None else camera.scaled(1.0 / factor)
    return WorkingImage(light=light, mask=small_mask, camera=small_camera), factor


def mean_inside(mask: Mask, factor: int) -> tuple[Callable[[FloatArray], FloatArray], FloatArray]:
    """Return how to average an image over the mask at 1/factor of the size, and how much is mask there."""
    size = (max(1, round(mask.shape[1] / factor)), max(1, round(mask.shape[0] / factor)))
    cover: FloatArray = np.asarray(
        cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA), dtype=np.float32
    )

    def mean(image: FloatArray) -> FloatArray:
        inside = image * (mask if image.ndim == 2 else mask[..., None])
        small = cv2.resize(inside.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return small / np.maximum(cover if image.ndim == 2 else cover[..., None], 1e-6)

    return mean, cover


def shrinking(mask: Mask) -> int:
    """Return by what whole factor a surface is solved smaller than the image of `mask`."""
    return max(1, round(float(np.sqrt(mask.size / _WORKING_PIXELS))))


def contributions_from_frame(frame: LinearFrame, response: LightResponse) -> LightContributions:
    """Split a frame by light; values that are not finite count as black."""
    rgb = np.ascontiguousarray(frame.rgb, dtype=np.float32)
    contributions, normals = np.empty_like(rgb), np.empty_like(rgb)
    length = np.empty(frame.shape, np.float32)
    haze, rest = haze_of(response)
    _split_kernel(
        flat(rgb), numbers_of(response.contributions_from_rgb), numbers_of(response.inverse),
        numbers_of(haze), np.float32(rest), flat(contributions), length, flat(normals),
    )  # fmt: skip
    return LightContributions(
        contributions=contributions,
        ambient=response.contributions_from_rgb @ response.ambient,
        lights=response.lights,
        directions=response.light_directions,
        length=length,
        normals=normals,
        trust=np.where(frame.clipped, np.float32(CLIPPED_TRUST), np.float32(1.0)),
    )


def haze_of(response: LightResponse) -> tuple[FloatArray, float]:
    """Return w = M⁻¹a, (3,) float32, and 1 − |w|²."""
    haze: FloatArray = (response.inverse @ response.ambient).astype(np.float32)
    return haze, max(1.0 - float(haze @ haze), _SMALLEST_REST)


def _small_contributions(
    frame: LinearFrame, response: LightResponse, mask: Mask, factor: int
) -> tuple[LightContributions, Mask]:
    """Split a frame by light at 1/factor of the size, its colours averaged over the mask; also its mask."""
    if factor == 1:
        return contributions_from_frame(frame, response), mask
    height, width = (max(1, round(length / factor)) for length in mask.shape)
    rgb = np.empty((height, width, 3), np.float32)
    trust, cover = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    _shrink_kernel(flat(frame.rgb), frame.clipped, np.asarray(mask), rgb, trust, cover)
    clipped: Mask = np.zeros((height, width), np.bool_)
    small = contributions_from_frame(LinearFrame(rgb=rgb, clipped=clipped), response)
    return replace(small, trust=trust), cover > 0.5


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _shrink_kernel(
    rgb: FloatArray, clipped: Mask, mask: Mask, mean: FloatArray, trust: FloatArray, cover: FloatArray
) -> None:
    """Fill the means over the mask of each small pixel's area, and how much of that is mask."""
    h, w = mask.shape
    height, width = cover.shape
    zero, one, low = np.float32(0.0), np.float32(1.0), np.float32(CLIPPED_TRUST)
    for row in prange(height):
        top, bottom = np.float32(row * h / height), np.float32((row + 1) * h / height)
        r, g, b = np.zeros(w, np.float32), np.zeros(w, np.float32), np.zeros(w, np.float32)
        t, c = np.zeros(w, np.float32), np.zeros(w, np.float32)
        for v in range(int(top), min(int(np.ceil(bottom)), h)):
            tall = min(np.float32(v + 1), bottom) - max(np.float32(v), top)
            line, inside, bound = rgb[v], mask[v], clipped[v]
            for u in range(w):  # without a branch: eight pixels at a time
                part = tall if inside[u] else zero
                r[u] += part * finite(line[3 * u])
                g[u] += part * finite(line[3 * u + 1])
                b[u] += part * finite(line[3 * u + 2])
                t[u] += part * (low if bound[u] else one)
                c[u] += part
        whole = (bottom - top) * np.float32(w / width)
        for column in range(width):
            left, right = np.float32(column * w / width), np.float32((column + 1) * w / width)
            sr, sg, sb, st, sc = zero, zero, zero, zero, zero
            for u in range(int(left), min(int(np.ceil(right)), w)):
                wide = min(np.float32(u + 1), right) - max(np.float32(u), left)
                sr, sg, sb = sr + wide * r[u], sg + wide * g[u], sb + wide * b[u]
                st, sc = st + wide * t[u], sc + wide * c[u]
            scale = one / sc if sc > np.float32(1e-6) else zero
            mean[row, column, 0], mean[row, column, 1], mean[row, column, 2] = (
                sr * scale,
                sg * scale,
                sb * scale,
            )
            trust[row, column], cover[row, column] = st * scale, sc / whole


def brighter_than(frame: LinearFrame, response: LightResponse, darkest: float, mask: Mask) -> Mask:
    """Return (h, w), the pixels of a mask whose M⁻¹(r − a) is longer than `darkest`."""
    out: Mask = np.empty(frame.shape, np.bool_)
    _brighter_kernel(
        flat(frame.rgb), numbers_of(response.inverse), numbers_of(response.ambient),
        np.float32(darkest**2), np.asarray(mask), out,
    )  # fmt: skip
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _brighter_kernel(
    rgb: FloatArray, inverse: Numbers, ambient: Numbers, least: Any, mask: Mask, out: Mask
) -> None:
    h, w = mask.shape
    for v in prange(h):
        line, inside, to = rgb[v], mask[v], out[v]
        for u in range(w):
            r, g, b = line[3 * u] - ambient[0], line[3 * u + 1] - ambient[1], line[3 * u + 2] - ambient[2]
            x, y, z = turned(inverse, r, g, b)
            to[u] = inside[u] & (x * x + y * y + z * z > least)


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _split_kernel(
    rgb: FloatArray, split: Numbers, inverse: Numbers, haze: Numbers, rest: np.float32,
    contributions: FloatArray, length: FloatArray, normals: FloatArray,
) -> None:  # fmt: skip
    """Fill the contributions, the albedo and the normal. rest: 1 − |w|²."""
    h, w = length.shape
    for v in range(h):
        line, seen, size, normal = rgb[v], contributions[v], length[v], normals[v]
        for u in range(w):
            r, g, b = finite(line[3 * u]), finite(line[3 * u + 1]), finite(line[3 * u + 2])
            seen[3 * u], seen[3 * u + 1], seen[3 * u + 2] = turned(split, r, g, b)
            normal[3 * u], normal[3 * u + 1], normal[3 * u + 2], size[u] = scaled_normal(
                r, g, b, inverse, haze, rest
            )


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def _over_kernel(
    contributions: FloatArray, albedo: FloatArray, ambient: Numbers, scale: Numbers, out: FloatArray
) -> None:
    """Fill out (h, w, 3) with contributions over the albedo, less the ambient light, times the scale."""
    h, w = albedo.shape
    for v in range(h):
        line, below, to = contributions[v], albedo[v], out[v]
        for u in range(w):
            over = np.float32(1.0) / max(below[u], np.float32(_SMALLEST_ALBEDO))
            to[3 * u] = (line[3 * u] * over - ambient[0]) * scale[0]
            to[3 * u + 1] = (line[3 * u + 1] * over - ambient[1]) * scale[1]
            to[3 * u + 2] = (line[3 * u + 2] * over - ambient[2]) * scale[2]


# Parts of compiled loops. The compiler does eight pixels at a time where what is the same for all of them
# comes as tuples of numbers, rows are slices that begin at 0, and images of three channels are flat.


def flat(image: FloatArray) -> FloatArray:
    """Return an image (h, w, 3) as rows (h, 3 w), float32: how far apart pixels are must be known."""
    single: FloatArray = np.ascontiguousarray(image, dtype=np.float32)
    return single.reshape(len(single), -1)


def numbers_of(values: ArrayLike) -> Numbers:
    """Return an array's values as a flat tuple of float32."""
    return tuple(np.float32(value) for value in np.ravel(np.asarray(values)))


@njit(cache=True, forceinline=True, error_model="numpy")
def turned(matrix: Numbers, x: Any, y: Any, z: Any) -> tuple[Any, Any, Any]:
    """Return a 3×3 matrix, nine numbers, times a vector."""
    return (
        matrix[0] * x + matrix[1] * y + matrix[2] * z,
        matrix[3] * x + matrix[4] * y + matrix[5] * z,
        matrix[6] * x + matrix[7] * y + matrix[8] * z,
    )


@njit(cache=True, forceinline=True, error_model="numpy")
def finite(value: Any) -> Any:
    """Return a colour; one that is no number is black, one that is infinite white."""
    sound = value - value == np.float32(0.0)
    return value if sound else (np.float32(1.0) if value > np.float32(0.0) else np.float32(0.0))


@njit(cache=True, forceinline=True, error_model="numpy")
def scaled_normal(
    r: Any, g: Any, b: Any, inverse: Numbers, haze: Numbers, rest: Any
) -> tuple[Any, Any, Any, Any]:
    """Solve r = ρ (M n + a), |n| = 1, for the normal n and the albedo ρ.

    With s = M⁻¹r and w = M⁻¹a (haze), |s − ρ w| = ρ is a quadratic in ρ with one positive root as long as the
    ambient light is weaker than the lamps. rest: 1 − |w|². Where there is no light the normal faces the
    viewer.
    """
    x, y, z = turned(inverse, r, g, b)
    along = x * haze[0] + y * haze[1] + z * haze[2]
    squared = x * x + y * y + z * z
    albedo = (np.sqrt(along * along + rest * squared) - along) / rest
    x, y, z = x - albedo * haze[0], y - albedo * haze[1], z - albedo * haze[2]
    long = np.sqrt(x * x + y * y + z * z)
    sound = long > np.float32(1e-6)
    over = np.float32(1.0) / (long if sound else np.float32(1.0))
    zero = np.float32(0.0)
    return (
        x * over if sound else zero, y * over if sound else zero, z * over if sound else np.float32(-1.0),
        albedo,
    )  # fmt: skip


@njit(cache=True, forceinline=True, error_model="numpy")
def place_between(index: int, length: int, small: int) -> tuple[int, int, Any]:
    """Return the two pixels of a smaller image beside one of a larger, and how near it is to the second."""
    place = (np.float32(index) + np.float32(0.5)) * np.float32(small / length) - np.float32(0.5)
    place = min(max(place, np.float32(0.0)), np.float32(small - 1))
    first = int(place)
    return first, min(first + 1, small - 1), place - np.float32(first)


@njit(cache=True, error_model="numpy")
def columns_between(length: int, small: int) -> tuple[IntArray, FloatArray]:
    """Return `place_between` of a row of `length` pixels: the first of the two, and the nearness."""
    first, part = np.empty(length, np.uint32), np.empty(length, np.float32)
    for u in range(length):
        left, _, part[u] = place_between(u, length, small)
        first[u] = left
    return first, part


@njit(cache=True, fastmath=FLAGS, error_model="numpy")
def row_between(
    images: FloatArray, v: int, h: int, first: IntArray, part: FloatArray, out: FloatArray
) -> None:
    """Fill out (k, n), a piece of row v of h, from the first k smaller images (k', h', w'), bilinearly.

    first, part: (n,), see `columns_between`.
    """
    _, height, width = images.shape
    up, down, t = place_between(v, h, height)
    line = np.empty(width + 1, np.float32)
    for k in range(len(out)):
        above, below, to = images[k, up], images[k, down], out[k]
        for column in range(width):
            line[column] = above[column] + t * (below[column] - above[column])
        line[width] = line[width - 1]
        for u in range(len(to)):
            left = line[first[u]]
            to[u] = left + part[u] * (line[first[u] + np.uint32(1)] - left)


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


def largest_of_three(values: FloatArray) -> FloatArray:
    """Return the largest (...) of values (..., 3)."""
    return np.maximum(np.maximum(values[..., 0], values[..., 1]), values[..., 2])


def all_of_three(values: Mask) -> Mask:
    """Return where all of (..., 3) booleans are True, (...)."""
    return values[..., 0] & values[..., 1] & values[..., 2]

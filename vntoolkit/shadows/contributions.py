"""What a frame says of each light: contributions, albedo and normal under full light, trust in the colour."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Matrix3, Vector3, Weight
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

_WORKING_PIXELS = 100_000  # surfaces are solved on images of about this size: more show no other shadows
CLIPPED_TRUST = 0.05  # a saturated channel is a bound, not a value
_SMALLEST_ALBEDO = 1e-3
_SMALLEST_REST = 0.05  # 1 − |M⁻¹a|²: an ambient light as strong as the lamps leaves no root
_MARGIN_PX = 4  # room for filters around the mask
Window = tuple[slice, slice]
FLAGS = {"contract", "arcp", "nsz"}  # of compiled loops: NaN and infinity keep their meaning
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
        relative = self.contributions / np.maximum(albedo, _SMALLEST_ALBEDO)[..., None]
        return relative - self.ambient.astype(np.float32)

    def cosines(self, albedo: FloatArray) -> FloatArray:
        """Contributions over albedo and strength: the cosine to each light where it arrives."""
        return self.relative_to(albedo) / np.linalg.norm(self.lights, axis=1).astype(np.float32)

    def shrunk(self, mask: Mask, factor: int) -> tuple[LightContributions, Mask]:
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
        rgb, response.contributions_from_rgb.astype(np.float32), response.inverse.astype(np.float32), haze,
        np.float32(rest), contributions, length, normals,
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


def small_contributions(
    frame: LinearFrame, response: LightResponse, mask: Mask, factor: int
) -> tuple[LightContributions, Mask]:
    """Split a frame by light at 1/factor of the size, its colours averaged over the mask; also its mask."""
    if factor == 1:
        return contributions_from_frame(frame, response), mask
    height, width = (max(1, round(length / factor)) for length in mask.shape)
    rgb = np.empty((height, width, 3), np.float32)
    trust, cover = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    _shrink_kernel(np.ascontiguousarray(frame.rgb), frame.clipped, np.asarray(mask), rgb, trust, cover)
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
                r[u] += part * finite(line[u, 0])
                g[u] += part * finite(line[u, 1])
                b[u] += part * finite(line[u, 2])
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
        np.ascontiguousarray(frame.rgb), response.inverse.astype(np.float32),
        response.ambient.astype(np.float32), np.float32(darkest**2), np.asarray(mask), out,
    )  # fmt: skip
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def _brighter_kernel(
    rgb: FloatArray, inverse: FloatArray, ambient: FloatArray, least: Any, mask: Mask, out: Mask
) -> None:
    i00, i01, i02, i10, i11, i12 = (
        inverse[0, 0], inverse[0, 1], inverse[0, 2], inverse[1, 0], inverse[1, 1], inverse[1, 2],
    )  # fmt: skip
    i20, i21, i22 = inverse[2, 0], inverse[2, 1], inverse[2, 2]
    a0, a1, a2 = ambient[0], ambient[1], ambient[2]
    h, w = mask.shape
    for v in prange(h):
        line, inside, to = rgb[v], mask[v], out[v]
        for u in range(w):
            r, g, b = line[u, 0] - a0, line[u, 1] - a1, line[u, 2] - a2
            x, y = i00 * r + i01 * g + i02 * b, i10 * r + i11 * g + i12 * b
            z = i20 * r + i21 * g + i22 * b
            to[u] = inside[u] & (x * x + y * y + z * z > least)


@njit(cache=True, parallel=True, fastmath=FLAGS, error_model="numpy")
def _split_kernel(
    rgb: FloatArray, split: FloatArray, inverse: FloatArray, haze: FloatArray, rest: np.float32,
    contributions: FloatArray, length: FloatArray, normals: FloatArray,
) -> None:  # fmt: skip
    """Fill the contributions, the albedo and the normal. rest: 1 − |w|²."""
    h, w, _ = rgb.shape
    for v in prange(h):
        for u in range(w):
            r, g, b = finite(rgb[v, u, 0]), finite(rgb[v, u, 1]), finite(rgb[v, u, 2])
            for i in range(3):
                contributions[v, u, i] = split[i, 0] * r + split[i, 1] * g + split[i, 2] * b
            x, y, z, length[v, u] = scaled_normal(r, g, b, inverse, haze, rest)
            normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = x, y, z


@njit(cache=True, inline="always", error_model="numpy")
def finite(value: Any) -> Any:
    """Return a colour; one that is no number is black, one that is infinite white."""
    sound = value - value == np.float32(0.0)
    return value if sound else (np.float32(1.0) if value > np.float32(0.0) else np.float32(0.0))


@njit(cache=True, inline="always", error_model="numpy")
def scaled_normal(
    r: Any, g: Any, b: Any, inverse: FloatArray, haze: FloatArray, rest: Any
) -> tuple[Any, Any, Any, Any]:
    """Solve r = ρ (M n + a), |n| = 1, for the normal n and the albedo ρ.

    With s = M⁻¹r and w = M⁻¹a (haze), |s − ρ w| = ρ is a quadratic in ρ with one positive root as long as the
    ambient light is weaker than the lamps. rest: 1 − |w|². Where there is no light the normal faces the
    viewer.
    """
    x = inverse[0, 0] * r + inverse[0, 1] * g + inverse[0, 2] * b
    y = inverse[1, 0] * r + inverse[1, 1] * g + inverse[1, 2] * b
    z = inverse[2, 0] * r + inverse[2, 1] * g + inverse[2, 2] * b
    along = x * haze[0] + y * haze[1] + z * haze[2]
    squared = x * x + y * y + z * z
    albedo = np.float32((np.sqrt(along * along + rest * squared) - along) / rest)
    x, y, z = x - albedo * haze[0], y - albedo * haze[1], z - albedo * haze[2]
    long = np.sqrt(x * x + y * y + z * z)
    if long > np.float32(1e-6):
        return x / long, y / long, z / long, albedo
    return np.float32(0.0), np.float32(0.0), np.float32(-1.0), albedo


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


def all_of_three(values: Mask) -> Mask:
    """Return where all of (..., 3) booleans are True, (...)."""
    return values[..., 0] & values[..., 1] & values[..., 2]

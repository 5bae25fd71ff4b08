"""Frames as one M would have formed them, where M changes over the picture.

At every pixel that is an affine map of colours. It changes slowly: parabolas between the points of a coarse
grid give it, in one pass with what else is done to a row of pixels.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from vntoolkit.arrays import Array, Box, FloatArray
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

_ERROR = 1e-5  # of a map's numbers: what parabolas may be off by, as float32 colours are after M⁻¹
_WIDEST = 64  # steps of the grid in pixels: the widest of these powers of two is taken that keeps to it


class ColourMaps(NamedTuple):
    """Affine maps of colours, r' = K r + o, over an image.

    grid: (rows, columns, 12) float32, K row by row, then o, at every `step` pixels from the first one on; an
    odd number of rows and of columns. ramp: (2 step,), 0, 1, 2, …: a loop counter's conversion is slow.
    """

    grid: Array
    step: int
    ramp: Array


class Leveller:
    """Converts a frame from M(u, v) to the M₀ of the centre: r' = M₀ M(u, v)⁻¹ (r − a(u, v)) + a₀.

    For stages that need one M, such as shadow detection. Exact where all three lights reach the pixel. Where
    one does not, the mixing adds a little of the other lights to it, less so the more the lights' directions
    at the pixel resemble those at the centre. To detect missing lights, use `frame_by_strength`.

    maps: what `frame` does, for loops over rows.
    """

    def __init__(self, response: LightResponse, shape: tuple[int, int]) -> None:
        split, lights = response.contributions_from_rgb, response.lights
        strengths = np.linalg.norm(lights, axis=1)

        def level(matrices: FloatArray) -> FloatArray:
            return np.asarray(response.matrix @ np.linalg.inv(matrices))

        def by_strength(matrices: FloatArray) -> FloatArray:
            gains = strengths / np.linalg.norm(split @ matrices, axis=-1)
            return np.asarray(np.linalg.inv(split) @ (gains[..., None] * split))

        self.maps = _maps(response, shape, level)
        self._by_strength = _maps(response, shape, by_strength)

    def frame(self, frame: LinearFrame, box: Box | None = None) -> LinearFrame:
        """Return the frame as the response of the centre would have formed it.

        box: the rows and the columns that count; beyond them all is 0. None for all.
        """
        return _mapped(frame, self.maps, box)

    def frame_by_strength(self, frame: LinearFrame, box: Box | None = None) -> LinearFrame:
        """Return the frame with every light as strong as at the centre; a missing light stays missing.

        The lights' directions remain those of the pixel, so normals computed from it have a small error. box:
        as for `frame`.
        """
        return _mapped(frame, self._by_strength, box)

    def part_by_strength(self, frame: LinearFrame, box: Box) -> LinearFrame:
        """Return `frame_by_strength` of some rows and columns alone."""
        part = LinearFrame(rgb=frame.rgb[box], clipped=frame.clipped[box], number=frame.number)
        return _mapped(part, self._by_strength, None, (int(box[0].start), int(box[1].start)))


@lru_cache(maxsize=1)
def leveller_of(response: LightResponse, shape: tuple[int, int]) -> Leveller:
    """Return the leveller of frames (h, w); the last one is kept."""
    return Leveller(response, shape)


def _maps(
    response: LightResponse, shape: tuple[int, int], mix: Callable[[FloatArray], FloatArray]
) -> ColourMaps:
    """Lay out the maps K (r − a) + a₀ over an image (h, w). mix: K, (..., 3, 3), from M."""

    def at(step: int) -> FloatArray:
        """Return the maps, (rows, columns, 12), of which every second one is a step apart."""
        v, u = (step / 2 * np.arange(4 * ((n - 1) // (2 * step) + 1) + 1) for n in shape)
        matrices, ambients = response.at(np.stack(np.meshgrid(u, v), axis=-1))
        k = mix(matrices)
        offset = response.ambient - (k @ ambients[..., None])[..., 0]
        return np.concatenate([k.reshape(*offset.shape[:2], 9), offset], axis=-1)

    step = _WIDEST
    while True:
        maps = at(step)
        grid, error = maps[::2, ::2], 0.0
        for axis, between in ((1, maps[::2, 1::2]), (0, maps[1::2, ::2])):
            whole = np.moveaxis(grid, axis, 0)
            before, middle, after = whole[:-2:2], whole[1::2], whole[2::2]
            near, far = (np.moveaxis(between, axis, 0)[k::2] for k in range(2))
            error = max(
                error,
                float(np.abs(0.375 * before + 0.75 * middle - 0.125 * after - near).max()),
                float(np.abs(0.375 * after + 0.75 * middle - 0.125 * before - far).max()),
            )
        if error < _ERROR or step == 1:
            break
        step //= 2
    ramp = np.arange(2 * step, dtype=np.float32)
    return ColourMaps(np.ascontiguousarray(grid, np.float32), step, ramp)


def _mapped(
    frame: LinearFrame, maps: ColourMaps, box: Box | None, corner: tuple[int, int] = (0, 0)
) -> LinearFrame:
    """corner: row and column of the picture that the frame begins with."""
    rows, columns = box or (slice(0, frame.shape[0]), slice(0, frame.shape[1]))
    inside = int(rows.start), int(rows.stop), int(columns.start), int(columns.stop)
    out = np.empty(frame.rgb.shape, np.float32)
    _map_kernel(np.ascontiguousarray(frame.rgb, np.float32), maps, corner, inside, out)
    return LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)


@njit
def _map_kernel(rgb: Any, maps: ColourMaps, corner: Any, inside: Any, out: Any) -> None:
    top, bottom, left, right = inside
    width = right - left
    for v in range(len(out)):
        to = out[v]
        if not top <= v < bottom:
            to[:] = 0.0
            continue
        r, g, b = np.empty(width, np.float32), np.empty(width, np.float32), np.empty(width, np.float32)
        line = rgb[v, left:right]
        for u in range(width):
            r[u], g[u], b[u] = line[u, 0], line[u, 1], line[u, 2]
        map_row(maps, v + corner[0], left + corner[1], r, g, b)
        to[:left] = 0.0
        to[right:] = 0.0
        for u in range(width):
            to[left + u, 0], to[left + u, 1], to[left + u, 2] = r[u], g[u], b[u]


@njit
def span_of(inside: Any) -> tuple[int, int]:
    """Return the first pixel of a row that is inside and the one after the last; (0, 0) for none."""
    first, last = 0, len(inside)
    while first < last and not inside[first]:
        first += 1
    while last > first and not inside[last - 1]:
        last -= 1
    return (first, last) if first < last else (0, 0)


@njit
def map_row(maps: ColourMaps, v: int, first: int, r: Any, g: Any, b: Any) -> None:
    """Map the colours of a row from pixel `first` on, in place."""
    grid, step, ramp = maps.grid, maps.step, maps.ramp
    half, one, two = np.float32(0.5), np.float32(1.0), np.float32(2.0)
    last, wide = first + len(r), 2 * step
    per_pixel = one / np.float32(step)
    top, y = v // wide * 2, np.float32(v % wide) * per_pixel - one
    w_above, w_middle, w_below = half * y * (y - one), one - y * y, half * y * (y + one)
    k, s, c = np.empty(12, np.float32), np.empty(12, np.float32), np.empty(12, np.float32)
    for part in range(first // wide, (last - 1) // wide + 1 if last > first else 0):
        begin, end = max(part * wide, first), min((part + 1) * wide, last)
        at = np.float32(begin - part * wide) * per_pixel - one
        above, middle, below = grid[top], grid[top + 1], grid[top + 2]
        column = 2 * part
        for e in range(12):
            left = w_above * above[column, e] + w_middle * middle[column, e] + w_below * below[column, e]
            centre = w_above * above[column + 1, e] + w_middle * middle[column + 1, e]
            centre += w_below * below[column + 1, e]
            right = w_above * above[column + 2, e] + w_middle * middle[column + 2, e]
            right += w_below * below[column + 2, e]
            slope, bend = half * (right - left), half * (left + right) - centre
            k[e] = centre + at * (slope + at * bend)
            s[e] = (slope + two * at * bend) * per_pixel
            c[e] = bend * per_pixel * per_pixel
        k0, k1, k2, k3, k4, k5, k6, k7, k8 = k[0], k[1], k[2], k[3], k[4], k[5], k[6], k[7], k[8]
        s0, s1, s2, s3, s4, s5, s6, s7, s8 = s[0], s[1], s[2], s[3], s[4], s[5], s[6], s[7], s[8]
        c0, c1, c2, c3, c4, c5, c6, c7, c8 = c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8]
        k9, k10, k11, s9, s10, s11, c9, c10, c11 = k[9], k[10], k[11], s[9], s[10], s[11], c[9], c[10], c[11]
        x, y_, z = (
            r[begin - first : end - first],
            g[begin - first : end - first],
            b[begin - first : end - first],
        )
        for u in range(end - begin):
            t = ramp[u]
            red, green, blue = x[u], y_[u], z[u]
            x[u] = (k0 + t * (s0 + t * c0)) * red + (k1 + t * (s1 + t * c1)) * green
            x[u] += (k2 + t * (s2 + t * c2)) * blue + (k9 + t * (s9 + t * c9))
            y_[u] = (k3 + t * (s3 + t * c3)) * red + (k4 + t * (s4 + t * c4)) * green
            y_[u] += (k5 + t * (s5 + t * c5)) * blue + (k10 + t * (s10 + t * c10))
            z[u] = (k6 + t * (s6 + t * c6)) * red + (k7 + t * (s7 + t * c7)) * green
            z[u] += (k8 + t * (s8 + t * c8)) * blue + (k11 + t * (s11 + t * c11))

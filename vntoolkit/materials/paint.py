"""Paint that varies inside a material, told by the lengths of normals and by their neighbours.

One length a pixel tells one number; freckles, lips and brows are of several colours. So a pixel's log s is
held against the normal that its neighbourhood lets expect. What is left is a turn of the normal, or paint.
Each has a covariance. Paint is of one of three kinds (none, the material's pigment, darkening of nearly any
hue), weighed by their likelihoods. The neighbourhood is that of the pixels without paint, from coarse to
fine: a level that shows few of them takes its normals from the level above (push and pull, gortler1996).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import FloatArray, Mask, Points
from vntoolkit.materials.pigment import exponential
from vntoolkit.materials.reflectance import Lamps, lamps_from_response
from vntoolkit.materials.split_frame import block_size
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

Single = npt.NDArray[np.float32]
MaterialLabels = npt.NDArray[np.uint8]
_BLOCKS = 20_000  # of the subject; noise is finer than these, and freckles are not
_LEVELS, _ROUNDS = 5, 2
# Variances of a normal's two components: of its change over one block, which doubles with twice the distance,
# and of what one block tells of its surroundings.
_CHANGE, _OF_BLOCK = np.float32(np.radians(5.0) ** 2), np.float32(np.radians(3.0) ** 2)
_LENGTH = np.float32(0.03)  # standard deviation of lengths for other reasons: gloss, light between folds
_PLAIN_LENGTH = np.float32(0.06)  # from where a length is a sign of paint
_LEAST_VARIANCE = np.float32(1e-5)
# The kinds of paint: standard deviation of log ρ along the pigment's line, and across it over that; of a
# grey, and of its hue over that; how frequent each is.
_NO_PAINT, _PIGMENT, _GREY = (0.06, 0.29), (0.4, 0.2), (0.7, 0.4)
_FREQUENT = np.log(np.array([0.7, 0.2, 0.1])).astype(np.float32)
_USUAL = np.float32(1.0)  # squared deviation of three numbers that needs no paint
_LEAST_SHARE = np.float32(0.06)  # of the strongest lamp's light: less may be shadow, which tells nothing
_LEAST_LIGHT, _TINY = np.float32(0.02), np.float32(1e-9)
_NONE, _HALF, _ONE, _FAR = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(80.0)
_MOST = np.float32(2.5)  # of log ρ
_NO_LABEL = 255


def told_by_neighbours(
    frame: LinearFrame,
    labels: MaterialLabels,
    mask: Mask,
    response: LightResponse,
    rho: Points,
    lines: Points,
) -> Mask:
    """(m,), True for materials whose normals change no more from block to block than is counted on.

    Of knit and of dark hair, which is noise, neighbours tell less than lengths do. The arguments are those of
    `without_paint`.
    """
    lamps = lamps_from_response(response, np.zeros(3))
    blocks = _blocks_of(np.ascontiguousarray(frame.rgb), labels, mask, lamps, rho, lines)
    smooth = np.zeros(len(rho), np.bool_)
    sums, of = blocks.sums, blocks.labels
    normals = sums[..., :3] / np.maximum(sums[..., 3:], _TINY)
    squares = ((normals[:, 1:] - normals[:, :-1]) ** 2).sum(axis=2)
    both = (sums[:, 1:, 3] > 0) & (sums[:, :-1, 3] > 0) & (of[:, 1:] == of[:, :-1])
    for m in range(len(rho)):
        steps = squares[both & (of[:, 1:] == m)]
        smooth[m] = steps.size > 0 and np.median(steps) < _CHANGE
    return smooth


def without_paint(
    frame: LinearFrame,
    labels: MaterialLabels,
    mask: Mask,
    response: LightResponse,
    rho: Points,
    lines: Points,
    out: Single,
) -> LinearFrame:
    """Return the frame as it would be without the paint of its subject, a mask (h, w).

    labels: (h, w), numbers of the materials. rho: (m, 3), their reflectances. lines: (m, 3), of length 1,
    their pigments; one of 0 has no paint. out: (h, w, 3), which the frame's colours are written to.
    """
    lamps = lamps_from_response(response, np.zeros(3))
    rgb, merge = np.ascontiguousarray(frame.rgb), np.linalg.inv(lamps.split)
    blocks = _blocks_of(rgb, labels, mask, lamps, rho, lines)
    gains = _gains_of(blocks, lamps, lines)
    split = lamps.split.astype(np.float32)
    _take_out(rgb, labels, mask, split, merge.astype(np.float32), gains, blocks.labels, blocks.factor, out)
    return LinearFrame(rgb=out, clipped=frame.clipped, number=frame.number)


class _Blocks(NamedTuple):
    """Blocks of factor × factor pixels.

    light: (h, w, 3), over ρ, without ambient light; 0 where a lamp is missing. labels: (h, w), the material
    of each, 255 for none. sums: (h, w, 4), normals, weighed by how likely each is without paint, and weights.
    """

    light: Single
    labels: MaterialLabels
    sums: Single
    factor: int


def _blocks_of(
    rgb: Single, labels: MaterialLabels, mask: Mask, lamps: Lamps, rho: Points, lines: Points
) -> _Blocks:
    factor = block_size(mask, _BLOCKS)
    h, w = (-(-n // factor) for n in mask.shape)
    light, of = np.zeros((h, w, 3), np.float32), np.full((h, w), _NO_LABEL, np.uint8)
    sums = np.zeros((h, w, 4), np.float32)
    split, haze, inverse = (each.astype(np.float32) for each in (lamps.split, lamps.haze, lamps.inverse))
    over, has_paint = (1.0 / np.asarray(rho)).astype(np.float32), np.asarray(lines).any(axis=1)
    _take_blocks(rgb, labels, mask, factor, split, over, haze, inverse, has_paint, light, of, sums)
    return _Blocks(light, of, sums, factor)


def _gains_of(blocks: _Blocks, lamps: Lamps, lines: Points) -> Single:
    """(h, w, 3), 1 / ρ of the paint of each block."""
    lights, inverse = np.linalg.inv(lamps.inverse).astype(np.float32), lamps.inverse.astype(np.float32)
    kinds = np.array([_kinds(line) for line in np.asarray(lines)], np.float32)
    sums, gains = [blocks.sums], np.ones(blocks.light.shape, np.float32)
    for _ in range(_LEVELS):
        sums.append(np.zeros((*(-(-n // 2) for n in sums[-1].shape[:2]), 4), np.float32))
    expected = [np.empty_like(each) for each in sums]
    for _ in range(_ROUNDS):
        for fine, coarse in pairwise(sums):
            _add_up(fine, coarse)
        _begin(sums[-1], expected[-1])
        for level in range(_LEVELS - 1, -1, -1):
            _expect(expected[level + 1], sums[level], level, expected[level])
        _tell(blocks.light, blocks.labels, expected[0], lights, inverse, kinds, gains, sums[0])
    return gains


def _kinds(line: FloatArray) -> FloatArray:
    """(3, 3, 3), the covariance of log ρ of each kind of paint."""
    along, grey = np.outer(line, line), np.full((3, 3), 1.0 / 3.0)
    return np.array([
        spread**2 * (main + across**2 * (np.eye(3) - main))
        for (spread, across), main in ((_NO_PAINT, along), (_PIGMENT, along), (_GREY, grey))
    ])  # fmt: skip


@njit(cache=True, parallel=True, error_model="numpy")
def _take_blocks(
    rgb: Any, labels: Any, mask: Any, factor: int, split: Any, over: Any, haze: Any, inverse: Any,
    has_paint: Any, s: Any, of: Any, sums: Any,
) -> None:  # fmt: skip
    """Fill s (h, w, 3), the blocks' light over ρ without ambient light, their materials, and, weighed by how
    likely each is without paint, their normals and these weights, (h, w, 4).
    """
    h, w = of.shape
    for i in prange(h):
        for j in range(w):
            top, left = i * factor, j * factor
            bottom, right = min(top + factor, mask.shape[0]), min(left + factor, mask.shape[1])
            middle = (top + bottom) // 2, (left + right) // 2
            m = labels[middle]
            if not mask[middle] or not has_paint[m]:
                continue
            r, g, b, count = _NONE, _NONE, _NONE, 0
            for v in range(top, bottom):
                for u in range(left, right):
                    if mask[v, u] and labels[v, u] == m:
                        r, g, b, count = r + rgb[v, u, 0], g + rgb[v, u, 1], b + rgb[v, u, 2], count + 1
            if 2 * count <= factor * factor:
                continue
            of[i, j] = m
            share = _ONE / np.float32(count)
            most, least = _NONE, np.float32(np.inf)
            for k in range(3):
                x = (split[k, 0] * r + split[k, 1] * g + split[k, 2] * b) * share * over[m, k] - haze[k]
                s[i, j, k] = x
                most, least = max(most, x), min(least, x)
            if not least > _LEAST_SHARE * most:
                s[i, j] = _NONE
                continue
            n0, n1, n2 = _times(inverse, s[i, j, 0], s[i, j, 1], s[i, j, 2])
            length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            off = (length - _ONE) / _PLAIN_LENGTH
            weight = _ONE / (_ONE + off * off)
            _weigh(n0 / length, n1 / length, n2 / length, weight * weight, sums[i, j])


@njit(cache=True, inline="always", error_model="numpy")
def _times(matrix: Any, x: Any, y: Any, z: Any) -> Any:
    return (
        matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2] * z,
        matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2] * z,
        matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2] * z,
    )


@njit(cache=True, inline="always", error_model="numpy")
def _weigh(x: Any, y: Any, z: Any, weight: Any, out: Any) -> None:
    out[0], out[1], out[2], out[3] = weight * x, weight * y, weight * z, weight


@njit(cache=True, fastmath=True, error_model="numpy")
def _add_up(fine: Any, coarse: Any) -> None:
    """Fill the sums over 2 × 2 cells."""
    h, w = fine.shape[:2]
    for i in range(coarse.shape[0]):
        coarse[i] = _NONE
        for v in range(2 * i, min(2 * i + 2, h)):
            for u in range(w):
                for k in range(4):
                    coarse[i, u // 2, k] += fine[v, u, k]


@njit(cache=True, error_model="numpy")
def _begin(sums: Any, out: Any) -> None:
    """Fill the expected normals and their variances, (h, w, 4), of the coarsest level."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            weight = sums[i, j, 3]
            for k in range(3):
                out[i, j, k] = sums[i, j, k] / max(weight, _TINY)
            out[i, j, 3] = _OF_BLOCK / (weight + _OF_BLOCK)


@njit(cache=True, fastmath=True, error_model="numpy")
def _expect(above: Any, sums: Any, level: int, out: Any) -> None:
    """Fill the expected normals and variances of a level, from those above it and, but for single blocks,
    from its own.
    """
    h, w = out.shape[:2]
    change = _CHANGE * np.float32(2**level)
    for i in range(h):
        near, far = i // 2, min(max(i // 2 - 1 + 2 * (i % 2), 0), above.shape[0] - 1)
        for j in range(w):
            here, there = j // 2, min(max(j // 2 - 1 + 2 * (j % 2), 0), above.shape[1] - 1)
            for k in range(4):
                out[i, j, k] = np.float32(0.5625) * above[near, here, k] + np.float32(0.0625) * above[
                    far, there, k
                ] + np.float32(0.1875) * (above[near, there, k] + above[far, here, k])  # fmt: skip
            variance = out[i, j, 3] + change
            weight = sums[i, j, 3]
            if level and weight > _TINY:
                gain = variance / (variance + _OF_BLOCK / weight)
                for k in range(3):
                    out[i, j, k] += gain * (sums[i, j, k] / weight - out[i, j, k])
                variance *= _ONE - gain
            out[i, j, 3] = variance


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _tell(
    s: Any, of: Any, expected: Any, lights: Any, inverse: Any, kinds: Any, gains: Any, sums: Any
) -> None:
    """Fill 1 / ρ of the paint, (h, w, 3), and the normals without it, weighed by how likely there is none."""
    h, w = of.shape
    g = lights @ lights.T
    level = _LENGTH * _LENGTH
    for i in prange(h):
        x, y, z = np.empty(3, np.float32), np.empty(3, np.float32), np.empty(3, np.float32)
        chance = np.empty(3, np.float32)
        for j in range(w):
            m = of[i, j]
            if m == _NO_LABEL or not s[i, j, 0] > _NONE:
                continue
            n0, n1, n2, variance = expected[i, j]
            over = _ONE / (np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY)
            e0, e1, e2 = _times(lights, n0 * over, n1 * over, n2 * over)
            e0, e1, e2 = max(e0, _LEAST_LIGHT), max(e1, _LEAST_LIGHT), max(e2, _LEAST_LIGHT)
            d0, d1, d2 = np.log(s[i, j, 0] / e0), np.log(s[i, j, 1] / e1), np.log(s[i, j, 2] / e2)
            # Covariance of log (l · n) where n turns, and where all light is off alike.
            v00 = variance * (g[0, 0] / (e0 * e0) - _ONE) + level + _LEAST_VARIANCE
            v11 = variance * (g[1, 1] / (e1 * e1) - _ONE) + level + _LEAST_VARIANCE
            v22 = variance * (g[2, 2] / (e2 * e2) - _ONE) + level + _LEAST_VARIANCE
            v01 = variance * (g[0, 1] / (e0 * e1) - _ONE) + level
            v02 = variance * (g[0, 2] / (e0 * e2) - _ONE) + level
            v12 = variance * (g[1, 2] / (e1 * e2) - _ONE) + level
            for kind in range(3):
                k = kinds[m, kind]
                a, b, c = v00 + k[0, 0], v11 + k[1, 1], v22 + k[2, 2]
                f, q, r = v01 + k[0, 1], v02 + k[0, 2], v12 + k[1, 2]
                c00, c01, c02 = b * c - r * r, q * r - f * c, f * r - q * b
                c11, c12, c22 = a * c - q * q, f * q - a * r, a * b - f * f
                determinant = max(a * c00 + f * c01 + q * c02, _TINY * _TINY)
                one = _ONE / determinant
                p0 = (c00 * d0 + c01 * d1 + c02 * d2) * one
                p1 = (c01 * d0 + c11 * d1 + c12 * d2) * one
                p2 = (c02 * d0 + c12 * d1 + c22 * d2) * one
                squares = d0 * p0 + d1 * p1 + d2 * p2
                x[kind], y[kind], z[kind] = _times(k, p0, p1, p2)
                if kind == 0 and squares < _USUAL:
                    chance[0], chance[1], chance[2] = _NONE, -_FAR, -_FAR
                    x[1:], y[1:], z[1:] = _NONE, _NONE, _NONE
                    break
                chance[kind] = _FREQUENT[kind] - _HALF * (squares + np.log(determinant))
            most = max(chance[0], chance[1], chance[2])
            total, l0, l1, l2 = _NONE, _NONE, _NONE, _NONE
            for kind in range(3):
                chance[kind] = np.exp(chance[kind] - most)
                total += chance[kind]
                l0, l1, l2 = (
                    l0 + chance[kind] * x[kind], l1 + chance[kind] * y[kind], l2 + chance[kind] * z[kind]
                )  # fmt: skip
            over = -_ONE / total
            l0, l1, l2 = (
                exponential(_bounded(l0 * over)),
                exponential(_bounded(l1 * over)),
                exponential(_bounded(l2 * over)),
            )
            gains[i, j, 0], gains[i, j, 1], gains[i, j, 2] = l0, l1, l2
            n0, n1, n2 = _times(inverse, s[i, j, 0] * l0, s[i, j, 1] * l1, s[i, j, 2] * l2)
            over = _ONE / (np.sqrt(n0 * n0 + n1 * n1 + n2 * n2) + _TINY)
            _weigh(n0 * over, n1 * over, n2 * over, chance[0] / total, sums[i, j])


@njit(cache=True, inline="always", error_model="numpy")
def _bounded(x: Any) -> Any:
    return min(max(x, -_MOST), _MOST)


@njit(cache=True, error_model="numpy")
def _between(count: int, blocks: int, factor: int) -> Any:
    """Return, for each pixel of a line, how far it is from one block's middle to the next's, and both."""
    share = np.empty(count, np.float32)
    first, second = np.empty(count, np.int64), np.empty(count, np.int64)
    for u in range(count):
        x = (np.float32(u) + _HALF) / np.float32(factor) - _HALF
        block = int(np.floor(x))
        share[u] = x - np.float32(block)
        first[u], second[u] = max(block, 0), min(block + 1, blocks - 1)
    return share, first, second


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _take_out(
    rgb: Any, labels: Any, mask: Any, split: Any, merge: Any, gains: Any, of: Any, factor: int, out: Any
) -> None:
    """Fill out (h, w, 3). Between the middles of blocks paint is interpolated, within each material."""
    h, w = mask.shape
    rows, columns = of.shape
    down, above, under = _between(h, rows, factor)
    across, before, after = _between(w, columns, factor)
    for v in prange(h):
        y, top, below = down[v], above[v], under[v]
        for u in range(w):
            red, green, blue = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
            if not mask[v, u]:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = red, green, blue
                continue
            x, left, right, m = across[u], before[u], after[u], labels[v, u]
            w00 = (_ONE - y) * (_ONE - x) * np.float32(of[top, left] == m)
            w01 = (_ONE - y) * x * np.float32(of[top, right] == m)
            w10 = y * (_ONE - x) * np.float32(of[below, left] == m)
            w11 = y * x * np.float32(of[below, right] == m)
            total = w00 + w01 + w10 + w11
            if not total > _TINY:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = red, green, blue
                continue
            total = _ONE / total
            w00, w01, w10, w11 = w00 * total, w01 * total, w10 * total, w11 * total
            s0, s1, s2 = _times(split, red, green, blue)
            s0 *= (
                w00 * gains[top, left, 0]
                + w01 * gains[top, right, 0]
                + w10 * gains[below, left, 0]
                + w11 * gains[below, right, 0]
            )
            s1 *= (
                w00 * gains[top, left, 1]
                + w01 * gains[top, right, 1]
                + w10 * gains[below, left, 1]
                + w11 * gains[below, right, 1]
            )
            s2 *= (
                w00 * gains[top, left, 2]
                + w01 * gains[top, right, 2]
                + w10 * gains[below, left, 2]
                + w11 * gains[below, right, 2]
            )
            out[v, u, 0], out[v, u, 1], out[v, u, 2] = _times(merge, s0, s1, s2)

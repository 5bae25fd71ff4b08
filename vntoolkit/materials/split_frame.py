"""One frame split by lamp, at the size that materials are told apart on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import prange

from vntoolkit.arrays import Float32Array, FloatArray, Mask, Vector3
from vntoolkit.materials.reflectance import Lamps, lamps_from_response
from vntoolkit.native import njit
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

WORKING_PIXELS = 60_000  # of the subject; more cost time and tell no other materials
_LEAST_SIGNAL = 4.0  # standard deviations of noise that a lamp's contribution must exceed …
_LEAST_SHARE = 0.06  # … and share of the strongest: the rest may be shadow
_OF_INNER_HALF = 0.3777  # root mean square of the inner half of a normal distribution, in standard deviations
_LEAST_NOISE = 1e-4
CELL = 8  # blocks to the side of what movement is measured on: it holds for movements up to that size


@dataclass(frozen=True, kw_only=True, eq=False)
class SplitFrame:
    """Blocks of factor × factor pixels, and what the lamps contribute to them.

    colours: (h, w, 3) float64, means over the mask. inside: (h, w), at least half of the block is subject.
    lit: (h, w), all three lamps reach it. lamps: with the noise of these means. factor: pixels.
    """

    colours: FloatArray
    inside: Mask
    lit: Mask
    lamps: Lamps
    factor: int

    @property
    def contributions(self) -> FloatArray:
        """(h, w, 3), of the lamps; 0 where not inside."""
        return np.asarray(np.where(self.inside[..., None], self.colours @ self.lamps.split.T, 0.0))


def split_frame(
    frame: LinearFrame,
    response: LightResponse,
    mask: Mask,
    most_pixels: int = WORKING_PIXELS,
    like: SplitFrame | None = None,
) -> SplitFrame:
    """Split a frame by lamp, averaged over blocks until the subject has about `most_pixels`.

    mask: (h, w). like: a frame whose blocks and noise are taken over. Clipped pixels are left out. Raises
    `BadInput` where the lamps' colours are not known.
    """
    factor = block_size(mask, most_pixels) if like is None else like.factor
    rgb, inside = _blocks(frame.rgb, mask, frame.clipped, factor)
    lamps = lamps_from_response(response, noise_of(rgb, inside)) if like is None else like.lamps
    lit = _lit(rgb, inside, lamps.split, _LEAST_SIGNAL * lamps.noise)
    return SplitFrame(colours=rgb, inside=inside, lit=lit, lamps=lamps, factor=factor)


def stacked(splits: Sequence[SplitFrame]) -> SplitFrame:
    """Put frames below each other, a dark row between: the same materials, other normals."""
    if len(splits) == 1:
        return splits[0]

    def joined(images: list[npt.NDArray[Any]]) -> npt.NDArray[Any]:
        width = max(image.shape[1] for image in images)
        pads = [((0, 1), (0, width - image.shape[1])) + ((0, 0),) * (image.ndim - 2) for image in images]
        return np.concatenate([np.pad(image, pad) for image, pad in zip(images, pads, strict=True)])

    lamps = splits[0].lamps
    mixing = np.sqrt(np.mean([split.lamps.mixing**2 for split in splits], axis=0)) * np.sign(lamps.mixing)
    return replace(
        splits[0],
        colours=joined([split.colours for split in splits]),
        inside=joined([split.inside for split in splits]),
        lit=joined([split.lit for split in splits]),
        lamps=lamps._replace(mixing=mixing, noise=np.linalg.norm(mixing, axis=1)),
    )


def block_size(mask: Mask, most_pixels: int = WORKING_PIXELS) -> int:
    """Return the side of the blocks, in pixels, that a mask has about `most_pixels` of."""
    return max(1, round(float(np.sqrt(mask.sum() / most_pixels))))


def cells_of(image: FloatArray | Float32Array) -> Float32Array:
    """Return means of (h, w, 3) over the cells by which `blocks_moved` measures movement."""
    return np.asarray(_cells(image))


def blocks_moved(before: Float32Array, now: Float32Array) -> float:
    """Return by about how many blocks the picture moved, at most about the size of the subject.

    What moves by less than a cell changes it by the movement times its slope. before, now: of `cells_of`.
    """
    mean = 0.5 * (before + now)
    slopes = float((np.diff(mean, axis=0) ** 2).sum() + (np.diff(mean, axis=1) ** 2).sum())
    return CELL * float(np.sqrt(((now - before) ** 2).sum() / max(slopes, _LEAST_NOISE**2)))


def noise_of(rgb: FloatArray, inside: Mask) -> Vector3:
    """(3,), standard deviation of noise of each channel.

    From the difference of second differences along rows and columns (immerkaer1996), which curved shading
    leaves alone; of its values the inner half counts, since edges are larger.
    """
    along = rgb[:, :-2] - 2.0 * rgb[:, 1:-1] + rgb[:, 2:]
    both = np.abs(along[:-2] - 2.0 * along[1:-1] + along[2:])
    whole = inside[:, :-2] & inside[:, 1:-1] & inside[:, 2:]
    whole = whole[:-2] & whole[1:-1] & whole[2:]
    if not whole.any():
        return np.full(3, _LEAST_NOISE)
    half = max(1, int(whole.sum()) // 2)
    found = np.partition(np.ascontiguousarray(both[whole].T), half - 1, axis=1)[:, :half]
    return np.maximum(np.sqrt(np.mean(found**2, axis=1)) / _OF_INNER_HALF / 6.0, _LEAST_NOISE)


@njit(cache=True, parallel=True)
def _cells(image: Any) -> Any:
    h, w, _ = image.shape
    out = np.zeros(((h + CELL - 1) // CELL, (w + CELL - 1) // CELL, 3), np.float32)
    for i in prange(len(out)):
        rows = min((i + 1) * CELL, h) - i * CELL
        for v in range(i * CELL, i * CELL + rows):
            for u in range(w):
                for k in range(3):
                    out[i, u // CELL, k] += image[v, u, k]
        for j in range(out.shape[1]):
            share = np.float32(1.0 / (rows * (min((j + 1) * CELL, w) - j * CELL)))
            for k in range(3):
                out[i, j, k] *= share
    return out


@njit(cache=True, parallel=True)
def _blocks(rgb: Any, mask: Any, clipped: Any, factor: int) -> Any:
    """Return the mean colour over the mask of each block, and whether half of the block is in it."""
    h, w = mask.shape
    height, width = (h + factor - 1) // factor, (w + factor - 1) // factor
    mean = np.zeros((height, width, 3))
    inside = np.zeros((height, width), np.bool_)
    for i in prange(height):
        counts = np.zeros(width, np.int64)
        for v in range(i * factor, min((i + 1) * factor, h)):
            for u in range(w):
                if mask[v, u] and not clipped[v, u]:
                    j = u // factor
                    counts[j] += 1
                    mean[i, j, 0] += rgb[v, u, 0]
                    mean[i, j, 1] += rgb[v, u, 1]
                    mean[i, j, 2] += rgb[v, u, 2]
        for j in range(width):
            if counts[j] > 0:
                share = 1.0 / counts[j]
                for k in range(3):
                    mean[i, j, k] *= share
                inside[i, j] = 2 * counts[j] >= factor * factor
    return mean, inside


@njit(cache=True, parallel=True)
def _lit(rgb: Any, inside: Any, split: Any, least: Any) -> Any:
    """Return whether all three lamps reach a pixel."""
    h, w = inside.shape
    lit = np.zeros((h, w), np.bool_)
    for v in prange(h):
        for u in range(w):
            if inside[v, u]:
                r, g, b = rgb[v, u, 0], rgb[v, u, 1], rgb[v, u, 2]
                s0 = split[0, 0] * r + split[0, 1] * g + split[0, 2] * b
                s1 = split[1, 0] * r + split[1, 1] * g + split[1, 2] * b
                s2 = split[2, 0] * r + split[2, 1] * g + split[2, 2] * b
                share = _LEAST_SHARE * max(s0, s1, s2, 0.0)
                lit[v, u] = (
                    (s0 > max(least[0], share)) & (s1 > max(least[1], share)) & (s2 > max(least[2], share))
                )
    return lit

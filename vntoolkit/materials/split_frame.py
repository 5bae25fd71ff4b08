"""One frame split by lamp, at the size that materials are told apart on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Box, Float32Array, FloatArray, Mask, Matrix3, Vector3, box_of
from vntoolkit.materials.reflectance import Lamps, lamps_from_response
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse

WORKING_PIXELS = 60_000  # of the subject; more cost time and tell no other materials
_LEAST_SIGNAL = 4.0  # standard deviations of noise that a lamp's contribution must exceed …
LEAST_SHARE = 0.06  # … and share of the strongest: the rest may be shadow, which tells nothing
_OF_INNER_HALF = 0.3777  # root mean square of the inner half of a normal distribution, in standard deviations
_LEAST_NOISE = 1e-4
_BOX_BLOCKS = 32  # that a subject moves before another part of the frame is looked at
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
    like: tuple[int, Lamps] | None = None,
) -> SplitFrame:
    """Split a frame by lamp, averaged over blocks until the subject has about `most_pixels`.

    mask: (h, w). like: factor and lamps of a frame that are taken over. Clipped pixels are left out. Raises
    `BadInput` where the lamps' colours are not known.
    """
    factor = block_size(mask, most_pixels) if like is None else like[0]
    sound = mask & ~frame.clipped
    counts = sums_of_blocks(sound, factor)
    rgb = sums_of_blocks(np.where(sound[..., None], frame.rgb, np.float32(0.0)), factor)
    rgb, inside = rgb / np.maximum(counts, 1.0)[..., None], 2.0 * counts >= max(factor**2, 2)
    lamps = lamps_from_response(response, noise_of(rgb, inside)) if like is None else like[1]
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


def sums_of_blocks(image: npt.NDArray[Any], side: int) -> npt.NDArray[np.float64]:
    """Return sums of an image (h, w, …) over blocks of side × side pixels, those at the ends smaller."""
    down, across = (np.arange(0, n, side) for n in image.shape[:2])
    return np.add.reduceat(np.add.reduceat(image, down, axis=0, dtype=np.float64), across, axis=1)


def steady_box(mask: Mask, factor: int, before: Box | None) -> Box:
    """Return rows and columns that hold a subject: those of the frame before, while they do.

    They begin and end between blocks of factor × factor pixels.
    """
    inner = box_of(mask)
    if before is not None and all(
        part.start <= own.start and own.stop <= part.stop for part, own in zip(before, inner, strict=True)
    ):
        return before
    step = _BOX_BLOCKS * factor
    rows, columns = (
        slice(own.start // step * step, min(-(-own.stop // step) * step, size))
        for own, size in zip(inner, mask.shape, strict=True)
    )
    return rows, columns


def cells_of(image: FloatArray | Float32Array) -> Float32Array:
    """Return means of (h, w, 3) over the cells by which `blocks_moved` measures movement."""
    sizes = sums_of_blocks(np.ones(image.shape[:2], np.bool_), CELL)
    return np.asarray(sums_of_blocks(image, CELL) / sizes[..., None], np.float32)


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


def _lit(rgb: FloatArray, inside: Mask, split: Matrix3, least: Vector3) -> Mask:
    """Return whether all three lamps reach a pixel."""
    s = rgb @ split.T
    share = LEAST_SHARE * np.maximum(s.max(axis=2, keepdims=True), 0.0)
    return np.asarray(inside & (s > np.maximum(least, share)).all(axis=2))

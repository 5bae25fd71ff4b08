"""What do the lengths of M⁻¹(r − a) depend on? Robust least squares on their logarithms, with errors.

Every frame has a level of its own: an exposure that changes from frame to frame tilts no normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.diagnosis.evidence import lengths_of
from vntoolkit.diagnosis.surface_pixels import SurfacePixels


@dataclass(frozen=True, kw_only=True, eq=False)
class Regression:
    """slopes: (k,) of the columns. errors: (k,), standard ones, from leaving out block after block."""

    slopes: FloatArray
    errors: FloatArray


def regress_lengths(
    columns: FloatArray, logs: FloatArray, pixels: SurfacePixels, rounds: int = 1, *, widely: bool = False
) -> Regression | None:
    """Fit log lengths (n,) by the columns (n, k) and a level for each frame, outliers weighed down.

    rounds: of weighing. widely: the errors are the largest of those from leaving out single blocks, squares
    of 2×2, and so on up to quarters of the subject: what the columns do not explain may be alike over many
    blocks. None where what is seen lies in one block.
    """
    width = columns.shape[1]
    order = np.argsort(pixels.blocks, kind="stable")
    frames = np.unique(pixels.frames[order], return_inverse=True)[1]
    design = np.column_stack([columns[order], np.eye(frames.max() + 1)[frames]])
    y, (size, terms) = logs[order], design.shape
    ends = np.append(np.flatnonzero(np.diff(pixels.blocks[order])) + 1, size)
    parts = [slice(start, end) for start, end in zip(np.append(0, ends[:-1]), ends, strict=True)]
    if len(parts) < 2:
        return None
    residual = without_levels(y, frames)
    for _ in range(rounds):
        departure = np.abs(residual)
        weight = 1.0 / (1.0 + (departure / (3.0 * np.median(departure) + 1e-6)) ** 2)
        weighted = design * weight[:, None]
        normal = np.stack([weighted[part].T @ design[part] for part in parts])
        right = np.stack([weighted[part].T @ y[part] for part in parts])
        ridge = 1e-9 * np.eye(terms) * size
        found = np.linalg.solve(normal.sum(axis=0) + ridge, right.sum(axis=0))
        residual = y - design @ found
    side = pixels.blocks_a_side
    row, column = np.divmod(pixels.blocks[order][[part.start for part in parts]], side)
    errors = []
    for together in range(1, max(1, side // 2 if widely else 1) + 1):
        squares = np.unique((row // together) * side + column // together, return_inverse=True)[1]
        member = (squares == np.arange(squares.max() + 1)[:, None]).astype(float)
        left_normal, left_right = (np.tensordot(member, sums, axes=1) for sums in (normal, right))
        without = normal.sum(axis=0) - left_normal + ridge
        left_out = np.linalg.solve(without, (right.sum(axis=0) - left_right)[..., None])[:, :width, 0]
        share = (len(member) - 1) / len(member)
        errors.append(np.sqrt(share * ((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0)))
    return Regression(slopes=found[:width], errors=np.max(errors, axis=0))


def spread_of_lengths(scaled: FloatArray, frames: npt.NDArray[np.int64]) -> float:
    """Return the median departure of log lengths from their frame's median; of those facing away the largest.

    scaled: (n, 3). frames: (n,) numbers.
    """
    departure = np.abs(without_levels(np.log(np.maximum(lengths_of(scaled), 1e-12)), frames))
    departure[scaled[:, 2] > 0] = math.inf
    return float(np.median(departure))


def without_levels(logs: FloatArray, frames: npt.NDArray[np.int64]) -> FloatArray:
    """Return log lengths, (n,), less the median of their frame."""
    left = logs.copy()
    for frame in np.unique(frames):
        left[frames == frame] -= np.median(logs[frames == frame])
    return left

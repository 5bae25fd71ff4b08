"""Some pixels of the surface, with M⁻¹ and ambient light at each, for checks of the lengths M⁻¹(r − a)."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from vntoolkit.arrays import Float32Array, FloatArray, Int64Array, Mask
from vntoolkit.diagnosis.evidence import STEEPEST, Evidence, jackknife_error, lengths_of, scaled_normals

_BLUR_PX = 1.0
_PIXELS_A_FRAME = 4000
_TINY = np.float32(1e-6)
_ROUNDS = 4  # of weighing outliers down


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfacePixels:
    """rgb: (n, 3). inverse: M⁻¹, (3, 3) or (n, 3, 3). ambient: (3,) or (n, 3). blocks, frames: (n,) numbers.

    blocks_a_side: block k lies in row k // blocks_a_side. positions: (n, 2) from the picture's centre, in
    halves of its larger side.
    """

    rgb: FloatArray
    inverse: FloatArray
    ambient: FloatArray
    blocks: Int64Array
    frames: Int64Array
    blocks_a_side: int
    positions: FloatArray

    def __len__(self) -> int:
        return len(self.rgb)

    def of(self, chosen: Mask | slice) -> "SurfacePixels":
        """Return some of them."""
        return SurfacePixels(
            rgb=self.rgb[chosen],
            inverse=self.inverse if self.inverse.ndim == 2 else self.inverse[chosen],
            ambient=self.ambient if self.ambient.ndim == 1 else self.ambient[chosen],
            blocks=self.blocks[chosen],
            frames=self.frames[chosen],
            blocks_a_side=self.blocks_a_side,
            positions=self.positions[chosen],
        )

    @cached_property
    def scaled(self) -> FloatArray:
        """(n, 3), M⁻¹(r − a)."""
        return self.scaled_normals(self.rgb)

    @cached_property
    def log_lengths(self) -> FloatArray:
        """(n,) logarithms of |M⁻¹(r − a)|."""
        return np.log(np.maximum(lengths_of(self.scaled), 1e-12))

    @cached_property
    def normals(self) -> FloatArray:
        """(n, 3) unit vectors."""
        return np.asarray(self.scaled / np.exp(self.log_lengths)[:, None])

    @property
    def of_wrong_m(self) -> list[FloatArray]:
        """How log lengths depend on the normal where M is wrong, columns of (n,)."""
        x, y, z = self.normals.T
        return [x * x - z * z, y * y - z * z, x * y, x * z, y * z]

    @property
    def of_uneven_light(self) -> list[FloatArray]:
        """How log lengths depend on the place where light is uneven, columns of (n,)."""
        u, v = self.positions.T
        return [u, v, u * u, v * v, u * v]

    def scaled_normals(self, rgb: FloatArray) -> FloatArray:
        """Return M⁻¹(rgb − a), (n, 3)."""
        lit = rgb - self.ambient
        if self.inverse.ndim == 2:
            return np.asarray(lit @ self.inverse.T)
        return np.asarray(np.einsum("nij,nj->ni", self.inverse, lit))

    def colours(self, scaled: FloatArray) -> FloatArray:
        """Return M n + a, (n, 3)."""
        matrix = np.linalg.inv(self.inverse)
        return np.asarray(np.einsum("...ij,...j->...i", matrix, scaled) + self.ambient)


def surface_pixels(
    evidence: Evidence, chosen: Callable[[int, Float32Array], Mask] | None = None
) -> SurfacePixels:
    """Return pixels that face the camera, of what is chosen, blurred among each other.

    chosen: gives, for a frame's number and the lengths (h, w) of its M⁻¹(r − a), the pixels to take, (h, w);
    the length of one that faces away is 0. None: the evidence's surface.
    """
    rgb, index = [], []
    for k, frame in enumerate(evidence.light):
        usable = (evidence.inside[k] & ~evidence.clipped[k]).astype(np.float32)
        light = cv2.GaussianBlur(frame * usable[..., None], (0, 0), _BLUR_PX)
        light /= np.maximum(cv2.GaussianBlur(usable, (0, 0), _BLUR_PX), _TINY)[..., None]
        scaled = scaled_normals(evidence, light)
        length = lengths_of(scaled)
        facing = scaled[..., 2] < -STEEPEST * length
        lit = evidence.surface[k]
        if chosen is not None:
            lit = chosen(k, np.where(facing, length, np.float32(0.0)))
        places = np.flatnonzero(facing & lit)
        places = places[:: max(1, len(places) // _PIXELS_A_FRAME)]
        rgb.append(light.reshape(-1, 3)[places])
        index.append(places)
    frames = np.repeat(np.arange(len(index)), [len(places) for places in index])
    places = np.concatenate(index)
    height, width = evidence.light.shape[1:3]
    v, u = np.divmod(places, width)
    centred = np.stack([u - (width - 1) / 2, v - (height - 1) / 2], axis=1)
    inverse, ambient = evidence.inverse.astype(np.float64), evidence.ambient.astype(np.float64)
    return SurfacePixels(
        rgb=np.concatenate(rgb).astype(np.float64),
        inverse=inverse if inverse.ndim == 2 else inverse.reshape(-1, 3, 3)[places],
        ambient=ambient if ambient.ndim == 1 else ambient.reshape(-1, 3)[places],
        blocks=evidence.blocks.ravel()[places],
        frames=frames,
        blocks_a_side=math.isqrt(int(evidence.blocks.max()) + 1),
        positions=centred / (max(height, width) / 2),
    )


# What the lengths of M⁻¹(r − a) depend on: robust least squares on their logarithms, with errors. Every frame
# has a level of its own: an exposure that changes from frame to frame tilts no normal.


@dataclass(frozen=True, kw_only=True, eq=False)
class Regression:
    """slopes: (k,) of the columns. errors: (k,), standard ones, from leaving out block after block."""

    slopes: FloatArray
    errors: FloatArray


def regress_lengths(
    columns: FloatArray,
    logs: FloatArray,
    pixels: SurfacePixels,
    rounds: int = _ROUNDS,
    *,
    widely: bool = False,
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
        errors.append(jackknife_error(left_out))
    return Regression(slopes=found[:width], errors=np.max(errors, axis=0))


def spread_of_lengths(scaled: FloatArray, frames: Int64Array) -> float:
    """Return the median departure of log lengths from their frame's median; of those facing away the largest.

    scaled: (n, 3). frames: (n,) numbers.
    """
    departure = np.abs(without_levels(np.log(np.maximum(lengths_of(scaled), 1e-12)), frames))
    departure[scaled[:, 2] > 0] = math.inf
    return float(np.median(departure))


def without_levels(logs: FloatArray, frames: Int64Array) -> FloatArray:
    """Return log lengths, (n,), less the median of their frame."""
    left = logs.copy()
    for frame in np.unique(frames):
        left[frames == frame] -= np.median(logs[frames == frame])
    return left

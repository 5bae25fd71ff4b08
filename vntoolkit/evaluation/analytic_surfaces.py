"""Surfaces with known depth and analytic normals, for judging integrators."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Normals

PEAKS_RANGE = 14.7  # of the unscaled surface, from −6.55 to 8.11


def peaks(height: int, width: int | None = None) -> tuple[FloatArray, Normals]:
    """Return depth (h, w) in pixels, range a quarter of the height, and normals of Matlab's `peaks`."""
    step = 6.0 / (height - 1)
    span = step * (np.arange(width or height) - ((width or height) - 1) / 2)
    y, x = np.meshgrid(step * np.arange(height) - 3.0, span, indexing="ij")
    near, centre = np.exp(-(x**2) - (y + 1) ** 2), np.exp(-(x**2) - y**2)
    left, odd = np.exp(-((x + 1) ** 2) - y**2), x / 5 - x**3 - y**5
    z = 3 * (1 - x) ** 2 * near - 10 * odd * centre - left / 3
    z_x = (-6 * (1 - x) - 6 * x * (1 - x) ** 2) * near - 10 * (0.2 - 3 * x**2 - 2 * x * odd) * centre
    z_x += 2 * (x + 1) / 3 * left
    z_y = -6 * (1 - x) ** 2 * (y + 1) * near + 10 * (5 * y**4 + 2 * y * odd) * centre + 2 * y / 3 * left
    scale = height / 4 / PEAKS_RANGE
    return z * scale, normals_from_gradient(z_x * step * scale, z_y * step * scale)


def tear(size: int, steepness: float) -> tuple[FloatArray, Normals]:
    """Return depth and normals of a flat whose lower right quarter turns into a ramp: the jump grows."""
    v, u = np.mgrid[:size, :size]
    ramp = (u >= size // 2) & (v > size // 2)
    depth = np.where(ramp, steepness * (v - size // 2), 0.0)
    return depth, normals_from_gradient(np.zeros(ramp.shape), np.where(ramp, steepness, 0.0))


def disc_with_hole(size: int) -> Mask:
    """Return a round mask (size, size) with a round hole."""
    v, u = np.mgrid[:size, :size] / size
    disc = (u - 0.5) ** 2 + (v - 0.46) ** 2 < 0.43**2
    return disc & ((u - 0.5) ** 2 + (v - 0.33) ** 2 > 0.1**2)


def normals_from_gradient(p: FloatArray, q: FloatArray) -> Normals:
    """Return unit normals (h, w, 3) in the camera frame of a depth with slopes p along u and q along v."""
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
    return (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)

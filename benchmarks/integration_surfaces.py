"""Surfaces with known depth for the integration benchmark."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.maps import NormalMap


def normals_from_gradient(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
    return (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)


def peaks(height: int, width: int | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return depth (pixels, range a quarter of the height) and analytic normals of the "peaks" surface."""
    step = 6.0 / (height - 1)
    span = step * (np.arange(width or height) - ((width or height) - 1) / 2)
    y, x = np.meshgrid(step * np.arange(height) - 3.0, span, indexing="ij")
    near, centre = np.exp(-(x**2) - (y + 1) ** 2), np.exp(-(x**2) - y**2)
    left, odd = np.exp(-((x + 1) ** 2) - y**2), x / 5 - x**3 - y**5
    z = 3 * (1 - x) ** 2 * near - 10 * odd * centre - left / 3
    z_x = (-6 * (1 - x) - 6 * x * (1 - x) ** 2) * near - 10 * (0.2 - 3 * x**2 - 2 * x * odd) * centre
    z_x += 2 * (x + 1) / 3 * left
    z_y = -6 * (1 - x) ** 2 * (y + 1) * near + 10 * (5 * y**4 + 2 * y * odd) * centre + 2 * y / 3 * left
    scale = height / 4 / 14.7
    return z * scale, normals_from_gradient(z_x * step * scale, z_y * step * scale)


def tear(size: int, steepness: float) -> tuple[np.ndarray, np.ndarray]:
    """Return depth and normals of a flat whose lower right quarter turns into a ramp: the jump grows."""
    v, u = np.mgrid[:size, :size]
    ramp = (u >= size // 2) & (v > size // 2)
    depth = np.where(ramp, steepness * (v - size // 2), 0.0)
    return depth, normals_from_gradient(np.zeros(ramp.shape), np.where(ramp, steepness, 0.0))


def read_object(folder: Path) -> tuple[Camera, NormalMap, np.ndarray]:
    """Read camera, normals and true depth (mm, NaN where unknown) of one real object."""
    stored = cv2.imread(str(folder / "normal_map.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    mask = cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE) > 0
    normals = (stored / 65535.0 * 2.0 - 1.0) * [1.0, -1.0, -1.0]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals[~mask] = 0.0
    height, width = mask.shape
    matrix = np.loadtxt(folder / "K.txt")
    camera = Camera(model=CameraModel.PINHOLE, width=width, height=height, matrix=matrix)
    truth = np.load(folder / "depth_gt.npz")["depth_gt"].astype(np.float64)
    return camera, NormalMap(normals_in_camera=normals, mask=mask), truth

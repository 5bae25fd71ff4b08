"""An egg with a random pattern that turns before a camera under three coloured lights, rendered exactly."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.io.footage.image_writing import write_png

AXES = np.array([0.085, 0.11, 0.10])
CAMERA = Camera.pinhole(width=320, height=240, focal_px=1600.0)
DISTANCE = 2.0
MATRIX = np.array([[-0.12, 0.05, -0.55], [0.13, 0.06, -0.5], [0.01, -0.17, -0.45]])
BACKGROUND = 0.004


def relative_error(matrix: np.ndarray) -> float:
    """Return how far M is from the true one, whatever its scale."""
    scale = (matrix * MATRIX).sum() / np.square(matrix).sum()
    return np.linalg.norm(scale * matrix - MATRIX) / np.linalg.norm(MATRIX)


def turning_poses(frames: int, widest_deg: float) -> list[RigidTransform]:
    angles = np.deg2rad(np.linspace(-widest_deg, widest_deg, frames))
    return [
        RigidTransform(
            rotation=Rotation.from_rotvec([0.02, a, 0.0]).as_matrix(),
            translation=np.array([0.03 * np.sin(a), 0.0, DISTANCE]),
        )
        for a in angles
    ]


def egg_surface(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (n, 3) spread evenly over the egg, metres, and the triangles (m, 3) between them."""
    k = np.arange(count) + 0.5
    height, around = 1 - 2 * k / count, np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - height**2)
    points = np.stack([ring * np.cos(around), height, ring * np.sin(around)], axis=1)
    faces = ConvexHull(points).simplices
    a, b, c = (points[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", a, np.cross(b, c)) < 0
    faces[inward] = faces[inward][:, ::-1]
    return points * AXES, faces.astype(np.int32)


@cache
def pattern(seed: int) -> np.ndarray:
    """Return smooth noise of unit variance in a cube."""
    noise = gaussian_filter(np.random.default_rng(seed).standard_normal((64, 64, 64)), 0.8)
    return noise / noise.std()


def render_egg(
    pose: RigidTransform, pattern_seed: int = 3, shift_m: float = 0.0, size: float = 1.0
) -> np.ndarray:
    """Return the linear image (h, w, 3) of the egg, its places moved by shift_m to the right."""
    axes = AXES * size
    origin = pose.inverse().apply(np.zeros(3)) - pose.inverse().rotate(np.array([shift_m, 0, 0]))
    rays = CAMERA.unproject(CAMERA.pixel_grid(), np.ones((CAMERA.height, CAMERA.width)))
    rays = pose.inverse().rotate(rays)
    a = (rays**2 / axes**2).sum(-1)
    b = (rays * origin / axes**2).sum(-1)
    c = (origin**2 / axes**2).sum() - 1.0
    root = b * b - a * c
    hit = root > 0
    along = (-b - np.sqrt(np.maximum(root, 0.0))) / a
    place = origin + along[..., None] * rays
    normal = place / axes**2
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    shading = np.maximum(pose.rotate(normal) @ MATRIX.T, 0.0)
    texture = map_coordinates(pattern(pattern_seed), (place / 0.12 * 31 + 31.5).reshape(-1, 3).T, order=1)
    albedo = 1.0 + 0.3 * np.clip(texture.reshape(hit.shape), -2.0, 2.0)
    return np.where(hit[..., None], shading * albedo[..., None], BACKGROUND).astype(np.float32)


def write_frames(folder: Path, images: list[np.ndarray], seed: int = 0) -> str:
    """Write 16-bit PNG files with a little noise; returns the folder's name."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    for number, image in enumerate(images):
        noisy = image + 0.002 * rng.standard_normal(image.shape)
        write_png(folder / f"{number:04d}.png", (65535 * np.clip(noisy, 0, 1)).astype(np.uint16))
    return str(folder)

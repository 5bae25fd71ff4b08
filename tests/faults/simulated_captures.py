"""Small captures with known faults: a smooth random surface under three random lights, before a backdrop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.photometry.rig import Rig

H, W = 120, 160


@dataclass(frozen=True)
class Simulated:
    """frames: (k, h, w, 3) linear light with noise, 0 to 1. normals: of frame 0. subject: where it may be."""

    frames: np.ndarray
    normals: np.ndarray
    rig: Rig
    subject: np.ndarray


def random_response(rng: np.random.Generator) -> LightResponse:
    """Lights 25 to 45 degrees off the axis, some 120 degrees apart; red, green and blue with cross-talk."""
    azimuth = np.deg2rad(np.array([90, 210, 330]) + rng.uniform(-25, 25, 3) + rng.uniform(0, 360))
    tilt = np.deg2rad(rng.uniform(25, 45, 3))
    towards = [np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)]
    lights = np.stack(towards, axis=1) * rng.uniform(0.8, 1.2, (3, 1))
    colours = np.eye(3) * 0.85 + rng.uniform(0.02, 0.12, (3, 3))
    return LightResponse(matrix=0.6 * colours.T @ lights)


def random_normals(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, h, w, 3) normals of waves that travel, within some 35 degrees of the camera."""
    v, u = np.mgrid[:H, :W].astype(float)
    p, q = np.zeros((count, H, W)), np.zeros((count, H, W))
    for _ in range(4):
        angle, length = rng.uniform(0, 2 * np.pi), rng.uniform(20, 70)
        ku, kv = np.cos(angle) * 2 * np.pi / length, np.sin(angle) * 2 * np.pi / length
        steps = rng.uniform(0, 2 * np.pi) + np.arange(count)[:, None, None] * rng.uniform(0.5, 1.2)
        wave = 0.3 * rng.uniform(0.5, 1) * np.cos(ku * u + kv * v + steps)
        p += wave * np.cos(angle)
        q += wave * np.sin(angle)
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)


def simulate_capture(seed: int, *, count: int = 1, backdrop: bool = False, noise: float = 0.002) -> Simulated:
    """A cloth that moves; with a backdrop, an ellipse of it before an unevenly painted wall that is still."""
    rng = np.random.default_rng([20111, seed])
    response = random_response(rng)
    normals = random_normals(rng, count)
    frames = np.clip(rgb_from_normals(normals, response), 0, None)
    v, u = np.mgrid[:H, :W]
    subject = np.ones((H, W), dtype=bool)
    if backdrop:
        subject = ((u - W / 2) / (W * 0.36)) ** 2 + ((v - H / 2) / (H * 0.4)) ** 2 < 1
        paint = 0.25 + 0.1 * np.sin(u / rng.uniform(9, 20)) * np.sin(v / rng.uniform(9, 20))
        wall = paint[..., None] * rng.uniform(0.6, 1.4, 3)
        frames = np.where(subject[..., None], frames, wall)
    frames = frames + rng.normal(0, noise, frames.shape)
    camera = Camera.orthographic(width=W, height=H)
    return Simulated(frames, normals[0], Rig(camera=camera, response=response), subject)

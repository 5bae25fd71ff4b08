"""A wrinkled sheet whose tracks are known exactly: a height field that rides on a moving map."""

from __future__ import annotations

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap


class WrinkledVideo:
    """Frame k shows z(u) = wrinkles(x) + bend_k(x) at u = warp_k(x), x in template pixels.

    Frame 0 has warp = identity. The wrinkles are fixed to the material; the bend travels over it.
    """

    def __init__(self, width=192, height=144, seed=1, drift_px=(0.0, 0.0), sway_px=4.0, bend=1.5, noise=0.0):
        self.camera = Camera.orthographic(width=width, height=height)
        self.rng = np.random.default_rng(seed)
        self.width, self.height, self.noise = width, height, noise
        self.drift, self.sway, self.bend = np.asarray(drift_px), sway_px, bend
        wavelengths = self.rng.uniform(9.0, 30.0, 60)
        angles = self.rng.uniform(0, np.pi, 60)
        self._drawn = {}
        self.k = 2 * np.pi / wavelengths[:, None] * np.stack([np.cos(angles), np.sin(angles)], 1)
        self.phase = self.rng.uniform(0, 2 * np.pi, 60)
        self.amplitude = 0.06 / np.linalg.norm(self.k, axis=1)

    def warp(self, x, frame):
        t = 2 * np.pi * frame / 120
        s = self.sway * np.sin(t)
        c = self.sway * (1 - np.cos(0.7 * t)) * 0.6
        du = s * np.cos(2 * np.pi * x[..., 1] / 160 + 0.01 * frame)
        dv = c * np.sin(2 * np.pi * x[..., 0] / 200 + 0.3)
        return x + np.stack([du, dv], -1) + self.drift * frame

    def material(self, u, frame):
        x = u - self.drift * frame
        for _ in range(12):  # contracts by 0.2 a step
            x = x + (u - self.warp(x, frame))
        return x

    def height_at(self, x, frame):
        total = np.full(x.shape[:-1], 200.0)
        for k, phase, amplitude in zip(self.k, self.phase, self.amplitude, strict=True):
            total += amplitude * np.sin(x @ k + phase)
        travelling = np.sin(2 * np.pi * (x[..., 0] / 90 + frame / 150)) * np.cos(2 * np.pi * x[..., 1] / 110)
        return total + self.bend * travelling * np.sin(2 * np.pi * frame / 150)

    def maps(self, frame, mask=None):
        if frame not in self._drawn:
            self._drawn[frame] = self._draw(frame)
        normals, depth = self._drawn[frame]
        mask = np.ones(depth.shape, dtype=bool) if mask is None else mask
        return NormalMap(normals_in_camera=normals, mask=mask), DepthMap(depth=depth, mask=mask)

    def _draw(self, frame):
        grid = self.camera.pixel_grid()
        e = 0.05
        sides = [
            self.height_at(self.material(grid + np.array(d), frame), frame)
            for d in ((e, 0), (-e, 0), (0, e), (0, -e))
        ]
        p, q = (sides[0] - sides[1]) / (2 * e), (sides[2] - sides[3]) / (2 * e)
        normals = np.stack([p, q, -np.ones_like(p)], -1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        if self.noise:
            noise = np.random.default_rng([7, frame]).normal(size=normals.shape) * self.noise
            normals = normals + noise
            normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        return normals.astype(np.float32), self.height_at(self.material(grid, frame), frame)

    def error(self, tracked, template, frame, margin=12):
        truth = self.warp(template.positions_px, frame)
        inside = np.all((truth >= margin) & (truth < [self.width - margin, self.height - margin]), axis=1)
        return np.linalg.norm(tracked.positions_px - truth, axis=1)[inside]

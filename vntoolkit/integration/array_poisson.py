"""Slopes, divergence and Poisson's equation on any array library: the full rectangle, by Fourier transform.

The same quadrature and the same least squares as `divergence` and `spectral.FourierSolver`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vntoolkit.devices import Backend
from vntoolkit.geometry.camera import Camera
from vntoolkit.integration.slopes import rays_from_camera
from vntoolkit.integration.spectral import laplacian_eigenvalues


class ArrayIntegrator:
    """Depth (orthographic) or log depth (perspective), of mean 0, of one camera's full normal maps."""

    def __init__(self, backend: Backend, camera: Camera, steepest_slope_deg: float) -> None:
        """Keep rays and eigenvalues on the device. camera: without distortion."""
        self._backend = backend
        height, width = camera.height, camera.width
        self._shape = (height, width)
        rays = rays_from_camera(camera)
        points = rays.image_plane_points(height, width).astype(np.float32)
        self._rays = None
        if camera.is_perspective:
            self._rays = (backend.to_device(points[..., 0]), backend.to_device(points[..., 1]))
        self._x_u, self._x_v, _, self._y_u, self._y_v, _ = (float(a) for a in rays.affine)
        self._least = float(np.cos(np.deg2rad(steepest_slope_deg)))
        eigenvalues = laplacian_eigenvalues(height, 2 * height)[:, None] + laplacian_eigenvalues(
            width, width + 1
        )
        eigenvalues[0, 0] = np.inf
        self._inverse = backend.to_device((1.0 / eigenvalues).astype(np.float32))
        self._upwards = backend.to_device(np.arange(height)[::-1].copy())
        self._leftwards = backend.to_device(np.arange(width)[::-1].copy())

    def integrate(self, x: Any, y: Any, z: Any) -> Any:
        """Return (h, w) from the three components of unit normals, all valid."""
        xp = self._backend.xp
        if self._rays is None:
            facing, least = -z, xp.full_like(z, self._least)
        else:
            ray_x, ray_y = self._rays
            facing = -(x * ray_x + y * ray_y + z)
            least = self._least * xp.sqrt(ray_x * ray_x + ray_y * ray_y + 1.0)
        inverse = 1.0 / xp.where(facing > least, facing, least)
        p = (x * self._x_u + y * self._y_u) * inverse
        q = (x * self._x_v + y * self._y_v) * inverse
        return self._solve(self._along_rows(p) + self._along_rows(q.T).T)

    def _along_rows(self, slopes: Any) -> Any:
        """Divergence of the wanted differences along the last axis; see `divergence._divergence`."""
        s = slopes / 24.0
        out = self._backend.xp.empty_like(s)
        out[:, 2:-2] = s[:, :-4] - s[:, 4:] + 14.0 * (s[:, 3:-1] - s[:, 1:-3])
        first = 9.0 * s[:, 0] + 19.0 * s[:, 1] - 5.0 * s[:, 2] + s[:, 3]
        second = 13.0 * (s[:, 1] + s[:, 2]) - s[:, 0] - s[:, 3]
        out[:, 0], out[:, 1] = first, second - first
        first = 9.0 * s[:, -1] + 19.0 * s[:, -2] - 5.0 * s[:, -3] + s[:, -4]
        second = 13.0 * (s[:, -2] + s[:, -3]) - s[:, -1] - s[:, -4]
        out[:, -1], out[:, -2] = -first, first - second
        return out

    def _solve(self, divergence: Any) -> Any:
        xp = self._backend.xp
        height, width = self._shape
        spectrum = xp.fft.rfft2(self._mirrored(divergence)) * self._inverse
        return xp.fft.irfft2(spectrum, s=(2 * height, 2 * width))[:height, :width]

    def _mirrored(self, divergence: Any) -> Any:
        """The image, mirrored to twice its height and width."""
        rows = self._backend.xp.concat((divergence, divergence[self._upwards]))
        return self._backend.xp.concat((rows.T, rows[:, self._leftwards].T)).T

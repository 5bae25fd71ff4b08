"""Surfaces whose depth and normals are known in closed form, in the camera frame."""

import numpy as np

from vntoolkit.geometry.camera import Camera


def normals_from_gradient(p, q):
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
    return (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)


def peaks(size):
    """Depth in pixels (range a quarter of the size) and normals of the "peaks" function."""
    step = 6.0 / (size - 1)
    axis = step * np.arange(size) - 3.0
    x, y = np.meshgrid(axis, axis)
    near, centre = np.exp(-(x**2) - (y + 1) ** 2), np.exp(-(x**2) - y**2)
    left, odd = np.exp(-((x + 1) ** 2) - y**2), x / 5 - x**3 - y**5
    z = 3 * (1 - x) ** 2 * near - 10 * odd * centre - left / 3
    z_x = (-6 * (1 - x) - 6 * x * (1 - x) ** 2) * near - 10 * (0.2 - 3 * x**2 - 2 * x * odd) * centre
    z_x += 2 * (x + 1) / 3 * left
    z_y = -6 * (1 - x) ** 2 * (y + 1) * near + 10 * (5 * y**4 + 2 * y * odd) * centre + 2 * y / 3 * left
    scale = size / 4 / 14.7
    return z * scale, normals_from_gradient(z_x * step * scale, z_y * step * scale)


def disc_with_hole(size):
    v, u = np.mgrid[:size, :size] / size
    return ((u - 0.5) ** 2 + (v - 0.46) ** 2 < 0.43**2) & ((u - 0.5) ** 2 + (v - 0.33) ** 2 > 0.1**2)


def sphere_before_camera(camera: Camera, centre, radius, largest_angle_deg):
    """Depth, normals and mask of a sphere, as far as its normals turn from the rays by that angle."""
    rays = camera.unproject(camera.pixel_grid(), np.ones((camera.height, camera.width)))
    centre = np.asarray(centre, dtype=float)
    if camera.is_perspective:
        a, b = (rays**2).sum(-1), rays @ centre
        root = np.maximum(b * b - a * (centre @ centre - radius**2), 0.0)
        depth = (b - np.sqrt(root)) / a
        points = rays * depth[..., None]
    else:
        flat = rays[..., :2] - centre[:2]
        depth = centre[2] - np.sqrt(np.maximum(radius**2 - (flat**2).sum(-1), 0.0))
        points = np.concatenate([rays[..., :2], depth[..., None]], axis=-1)
        rays = np.broadcast_to([0.0, 0.0, 1.0], points.shape)
    normals = (points - centre) / radius
    facing = -(normals * rays).sum(-1) / np.linalg.norm(rays, axis=-1)
    mask = (facing > np.cos(np.deg2rad(largest_angle_deg))) & (
        np.abs(np.linalg.norm(normals, axis=-1) - 1) < 1e-6
    )
    normals[~mask] = 0.0
    return depth, normals.astype(np.float32), mask


def tear(size, steepness):
    """A flat whose lower right quarter turns into a ramp: the jump along the middle column grows."""
    v, u = np.mgrid[:size, :size]
    ramp = (u >= size // 2) & (v > size // 2)
    depth = np.where(ramp, steepness * (v - size // 2), 0.0)
    return depth, normals_from_gradient(np.zeros(ramp.shape), np.where(ramp, steepness, 0.0))


def largest_error(found, truth, mask):
    """Largest error over the mask after the mean offset is removed, as a share of the depth range."""
    difference = (found.astype(np.float64) - truth)[mask]
    return np.abs(difference - difference.mean()).max() / np.ptp(truth[mask])

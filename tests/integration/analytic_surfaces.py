"""Surfaces whose depth and normals are known in closed form, in the camera frame."""

import numpy as np

from vntoolkit.geometry.camera import Camera


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


def largest_error(found, truth, mask):
    """Largest error over the mask after the mean offset is removed, as a share of the depth range."""
    difference = (found.astype(np.float64) - truth)[mask]
    return np.abs(difference - difference.mean()).max() / np.ptp(truth[mask])

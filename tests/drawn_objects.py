"""Objects pressed into a gel, drawn exactly: drums whose radius varies, rolled and turned over the gel.

A drum's axis is its own x; ρ(s, φ) is its radius at s along the axis, at the angle φ about it. Lengths are
millimetres, the frame is the camera's; the gel rests at z = 0 and the object comes from behind it.
"""

import functools
from collections.abc import Callable

import numpy as np
from scipy import ndimage

from vntoolkit.geometry.rigid import RigidTransform

Radius = Callable[[np.ndarray, np.ndarray], np.ndarray]
DRUM_MM, DEEP_MM, DECAY_PX = 5.0, 0.9, 7.0
_GRID_MM = 0.04


def cylinder(s: np.ndarray, angle: np.ndarray) -> np.ndarray:
    return np.full_like(s, DRUM_MM)


def screw(s: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """A thread of 1.6 mm pitch, 0.25 mm high."""
    return DRUM_MM + 0.125 * np.cos(2 * np.pi * s / 1.6 + angle)


def letters(s: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """A printing drum: strokes of letters stand out by 0.25 mm."""
    at = np.stack([(s + 10.0) / _GRID_MM, (angle * DRUM_MM + 16.0) / _GRID_MM])
    return DRUM_MM + ndimage.map_coordinates(_strokes(), at, order=1, mode="nearest")


@functools.cache
def _strokes() -> np.ndarray:
    """Height in mm over (s, y), from (−10, −16) mm in steps of `_GRID_MM`."""
    x, y = np.meshgrid(np.arange(-10, 10, _GRID_MM), np.arange(-16, 16, _GRID_MM), indexing="ij")
    height = np.zeros_like(x)
    rng = np.random.default_rng(6)
    for u, v, turn, length in rng.uniform((-8, -16, 0, 0.7), (8, 16, np.pi, 1.6), (160, 4)):
        along = (x - u) * np.cos(turn) + (y - v) * np.sin(turn)
        across = (y - v) * np.cos(turn) - (x - u) * np.sin(turn)
        away = np.hypot(np.maximum(np.abs(along) - length, 0.0), across)
        height = np.maximum(height, 0.25 / (1 + np.exp((away - 0.25) / 0.07)))
    return height


def pose_of(turn_deg: float = 0.0, roll_deg: float = 0.0, x_mm: float = 0.0) -> RigidTransform:
    """camera_from_object: the drum turned about the line of sight, then rolled about its axis, no slip."""
    roll, turn = np.radians(roll_deg), np.radians(turn_deg)
    turned = RigidTransform.from_rotation_vector((0, 0, turn))
    rolled = RigidTransform.from_rotation_vector((roll, 0, 0))
    # above the drum's point nearest to the camera, which is at −z of its axis, the gel stands still
    shift = turned.rotate(np.array([x_mm, DRUM_MM * roll, DRUM_MM - DEEP_MM]))
    rotation = turned.rotation @ rolled.rotation
    return RigidTransform(rotation=rotation, translation=shift)


def pressed(radius: Radius, pose: RigidTransform, shape: tuple[int, int], pixel_mm: float) -> np.ndarray:
    """Depth of the gel (h, w), mm, negative in the dent; the gel around comes to rest within some pixels."""
    height, width = shape
    v, u = np.indices(shape)
    x, y = (u - (width - 1) / 2) * pixel_mm, (v - (height - 1) / 2) * pixel_mm
    object_from_camera = pose.inverse()
    z = np.full(shape, -DEEP_MM)
    ray = object_from_camera.rotation[:, 2]
    for _ in range(12):  # Newton's steps along the line of sight, to the nearer wall
        p = object_from_camera.apply(np.stack([x, y, z], axis=-1))
        away = np.maximum(np.hypot(p[..., 1], p[..., 2]), 1e-6)
        off = away - radius(p[..., 0], np.arctan2(p[..., 1], -p[..., 2]))
        slope = np.minimum((p[..., 1] * ray[1] + p[..., 2] * ray[2]) / away, -0.2)
        z = np.clip(z - off / slope, -DEEP_MM - 0.6, 4.0)
    touched = z < 0
    distance, nearest = ndimage.distance_transform_edt(~touched, return_indices=True)
    fall = z[nearest[0], nearest[1]] * np.exp(-((distance / DECAY_PX) ** 2))
    return np.where(touched, z, fall)


def normals_of(depth_mm: np.ndarray, pixel_mm: float) -> np.ndarray:
    """Unit normals (h, w, 3) towards the camera."""
    by_v, by_u = np.gradient(depth_mm, pixel_mm)
    normals = np.stack([by_u, by_v, -np.ones_like(by_u)], axis=-1)
    return normals / np.linalg.norm(normals, axis=-1, keepdims=True)

"""A garment made of tubes: a torso with two sleeves, as a capture would deliver it."""

from __future__ import annotations

import numpy as np
import pytest

from vntoolkit.geometry.mesh import Mesh, MeshSequence


def tube(start, end, radius_start, radius_end, rings: int, sides: int) -> tuple[np.ndarray, np.ndarray]:
    """Return vertices and outward faces of an open tube with elliptic rings, flatter in z."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    axis = (end - start) / np.linalg.norm(end - start)
    across = np.cross(axis, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    forward = np.cross(axis, across)
    t = np.linspace(0, 1, rings)[:, None, None]
    a = (2 * np.pi * np.arange(sides) / sides)[None, :, None]
    radius = radius_start + (radius_end - radius_start) * t
    points = start + t * (end - start) + radius * (np.cos(a) * across + 0.65 * np.sin(a) * forward)
    i = np.arange(rings * sides).reshape(rings, sides)
    a0, a1 = i[:-1], np.roll(i, -1, axis=1)[:-1]
    b0, b1 = i[1:], np.roll(i, -1, axis=1)[1:]
    faces = np.concatenate(
        [np.stack([a0, a1, b0], -1).reshape(-1, 3), np.stack([a1, b1, b0], -1).reshape(-1, 3)]
    )
    return points.reshape(-1, 3), faces


def sleeved_tube(rings: int = 24, sides: int = 32) -> Mesh:
    """Return a jumper hung at arms 45° down, in metres, camera axes, five metres from the camera."""
    parts = [
        tube([0, 0.62, 0], [0, 0.0, 0], 0.21, 0.17, rings, sides),
        tube([0.13, 0.06, 0], [0.50, 0.45, 0], 0.10, 0.06, rings, sides),
        tube([-0.13, 0.06, 0], [-0.50, 0.45, 0], 0.10, 0.06, rings, sides),
    ]
    vertices, faces, first = [], [], 0
    for points, triangles in parts:
        vertices.append(points)
        faces.append(triangles + first)
        first += len(points)
    points = np.concatenate(vertices) + np.array([0.1, -0.3, 5.0])
    stripes = 0.5 + 0.5 * np.sign(np.sin(points[:, 1:2] * 60))
    colours = stripes * [0.75, 0.25, 0.2] + (1 - stripes) * [0.85, 0.8, 0.7]
    uv = (points[:, :2] - points[:, :2].min(axis=0)) / np.ptp(points[:, :2], axis=0)
    return Mesh(vertices=points, faces=np.concatenate(faces), colours=colours.astype(np.float32), uv=uv)


def rippling(template: Mesh, frames: int, frame_rate_hz: float = 60.0) -> MeshSequence:
    """Return the garment with a wave that runs down it."""
    phase = template.vertices[:, 1] * 25 - 2 * np.pi * np.arange(frames)[:, None] / 30
    moved = np.repeat(np.asarray(template.vertices)[None], frames, axis=0)
    moved[..., 2] += 0.006 * np.sin(phase)
    return MeshSequence(template=template, vertices=moved.astype(np.float32), frame_rate_hz=frame_rate_hz)


@pytest.fixture
def jumper() -> Mesh:
    return sleeved_tube()


@pytest.fixture
def moving_jumper(jumper: Mesh) -> MeshSequence:
    return rippling(jumper, 30)

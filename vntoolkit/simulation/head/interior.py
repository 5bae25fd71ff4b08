"""What lies behind lips and lids: the mouth's pocket, lid rims, eyeballs, teeth, tongue; centimetres."""

from __future__ import annotations

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points
from vntoolkit.simulation.head.sculpture import EYE_CENTRE, EYE_RADIUS, MOUTH_HALF_WIDTH, MOUTH_HEIGHT
from vntoolkit.simulation.head.slit import Slit

IRIS_RADIUS, PUPIL_RADIUS = 0.54, 0.20
# how far each ring of the pocket opens up and down, and how far it goes in
_POCKET_RINGS = ((0.02, -0.12), (0.06, -0.45), (0.85, -1.05), (1.05, -4.6))
_LID_RINGS = (1.02, 0.90)  # in eyeball radii


def extrude_slit(
    shape: Points, slit: Slit, first: int, eye: FloatArray | None
) -> tuple[Points, Faces, IntArray]:
    """Return rings behind a slit: a closed pocket for the mouth, two rings towards the eyeball for an eye.

    first: the number of the first new vertex. Also returns the rim vertex that each new one hangs on.
    """
    loop = slit.loop
    rim, size, half = shape[loop], len(loop), len(slit.upper)
    rings = []
    if eye is None:
        almond = np.sqrt(np.clip(1.0 - (rim[:, 0] / MOUTH_HALF_WIDTH) ** 2, 0.0, 1.0))
        up = np.where(np.arange(size) < half, 1.0, -1.0) * almond
        for opening, depth in _POCKET_RINGS:
            rings.append(rim + np.stack([0 * up, opening * up, depth * (0.25 + 0.75 * almond)], axis=1))
    else:
        outward = (rim - eye) / np.linalg.norm(rim - eye, axis=1, keepdims=True)
        rings = [eye + radius * EYE_RADIUS * outward for radius in _LID_RINGS]
    here = np.arange(size)
    following = (here + 1) % size
    faces = []
    for ring in range(len(rings)):
        outer = loop if ring == 0 else first + (ring - 1) * size + here
        inner = first + ring * size + here
        faces.append(np.stack([outer[following], outer, inner], axis=1))
        faces.append(np.stack([outer[following], inner, inner[following]], axis=1))
    if eye is None:
        faces.append(_back_wall(first + (len(rings) - 1) * size, half, size))
    return np.concatenate(rings), np.concatenate(faces), np.tile(loop, len(rings))


def _back_wall(start: int, half: int, size: int) -> Faces:
    """Return the faces that join the upper half of the last ring with the lower."""
    upper = start + np.arange(half)
    lower = start + np.concatenate([[0], size - np.arange(1, half - 1), [half - 1]])
    wall = np.concatenate(
        [np.stack([lower[:-1], lower[1:], upper[1:]], 1), np.stack([lower[:-1], upper[1:], upper[:-1]], 1)]
    )
    return wall[(wall[:, 0] != wall[:, 1]) & (wall[:, 1] != wall[:, 2]) & (wall[:, 2] != wall[:, 0])]


def eyeball(side: float) -> tuple[Points, Faces]:
    """Return the eyeball at x < 0 (side -1) or x > 0 (+1), its pole to the front, with a slight cornea."""
    tilt = np.linspace(0.0, 1.0, 49)[1:] ** 1.35 * 0.75 * np.pi
    turn = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
    angle, about = np.meshgrid(tilt, turn, indexing="ij")
    bulge = 1.0 + 0.045 * np.clip(1.0 - (angle / 0.50) ** 2, 0.0, 1.0)
    ball = np.stack([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)], axis=-1)
    points = np.concatenate([[[0.0, 0.0, 1.045]], (bulge[..., None] * ball).reshape(-1, 3)]) * EYE_RADIUS
    faces = 1 + _sheet_faces(len(tilt), len(turn), around=True)
    tip = np.stack([np.zeros(64, dtype=int), 1 + np.arange(64), 1 + (np.arange(64) + 1) % 64], axis=1)
    return points + np.array(EYE_CENTRE) * [side, 1.0, 1.0], np.concatenate([tip, faces])


def teeth(upper: float) -> tuple[Points, Faces]:
    """Return a row of teeth: upper for +1, lower for -1."""
    arc = np.radians(np.linspace(-72.0, 72.0, 145))
    height = np.linspace(0.0, 1.0, 14)
    gap = np.abs(np.sin(arc * 6.0)) ** 0.35
    edge = np.clip((height - 0.8) / 0.2, 0.0, 1.0)
    radius = (0.93 + 0.07 * gap)[None, :] * (1.0 - 0.08 * edge**2)[:, None]
    size = (2.55, 3.25) if upper > 0 else (2.40, 2.95)
    root = MOUTH_HEIGHT + (1.1 if upper > 0 else -1.35)
    tip = MOUTH_HEIGHT + (-0.38 if upper > 0 else -0.42)
    y = root + (tip - root) * height[:, None] * (0.88 + 0.12 * gap)[None, :]
    x, z = size[0] * radius * np.sin(arc), 4.95 + size[1] * radius * np.cos(arc)
    faces = _sheet_faces(len(height), len(arc), around=False)
    return np.stack([x, y, z], axis=-1).reshape(-1, 3), faces if upper > 0 else faces[:, ::-1]


def tongue() -> tuple[Points, Faces]:
    """Return the tongue, lying behind the lower teeth."""
    tilt, turn = np.linspace(0.02, np.pi - 0.02, 24), np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    angle, about = np.meshgrid(tilt, turn, indexing="ij")
    ball = np.stack([np.sin(angle) * np.cos(about), np.sin(angle) * np.sin(about), np.cos(angle)], axis=-1)
    points = ball.reshape(-1, 3) * [1.7, 0.55, 2.1] + [0.0, MOUTH_HEIGHT - 0.85, 5.5]
    return points, _sheet_faces(len(tilt), len(turn), around=True)


def _sheet_faces(rows: int, columns: int, around: bool) -> Faces:
    """Return the triangles of a grid of vertices; rows × columns, closed along its columns or not."""
    row, column = np.meshgrid(
        np.arange(rows - 1), np.arange(columns if around else columns - 1), indexing="ij"
    )
    a = (row * columns + column).ravel()
    b = (row * columns + (column + 1) % columns).ravel()
    lower, upper = np.stack([a, a + columns, b + columns], 1), np.stack([a, b + columns, b], 1)
    return np.concatenate([lower, upper])

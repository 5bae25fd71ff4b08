"""Muscles of the face: each shifts the skin round a few places, smoothly, and parts it at the lips."""

from __future__ import annotations

from enum import Enum

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.simulation.head import anatomy
from vntoolkit.simulation.head.anatomy import Head
from vntoolkit.simulation.head.sculpture import MOUTH_HALF_WIDTH


class Muscle(Enum):
    """What can be contracted."""

    SMILE = "smile"
    GRIMACE = "grimace"
    PUCKER = "pucker"
    LIPS_APART = "lips apart"
    BROWS_UP = "brows up"
    BROWS_KNIT = "brows knit"


# (place, radius, shift) on the side x > 0, mirrored to the other; side +1 or -1 moves that lip alone
_Pull = tuple[tuple[float, float, float], float, tuple[float, float, float], int]
_CORNER = (2.55, -6.8, 8.0)
_PULLS: dict[Muscle, tuple[_Pull, ...]] = {
    Muscle.SMILE: (
        (_CORNER, 1.5, (0.62, 0.62, -0.45), 0),
        ((4.0, -3.9, 7.0), 1.7, (0.05, 0.38, 0.42), 0),
        ((3.2, -1.4, 7.8), 1.0, (0.0, 0.16, 0.10), 0),
        ((1.0, -6.3, 9.4), 1.0, (0.10, 0.06, -0.16), 0),
    ),
    Muscle.GRIMACE: (
        (_CORNER, 1.5, (0.45, -0.45, -0.25), 0),
        ((1.3, -3.7, 9.2), 0.9, (0.10, 0.30, 0.05), 0),
        ((1.0, -6.2, 9.4), 1.0, (0.0, 0.38, 0.05), 1),
        ((0.9, -7.3, 9.4), 1.1, (0.05, -0.42, 0.0), -1),
        ((2.0, -2.0, 8.4), 1.2, (0.0, 0.25, 0.18), 0),
        ((0.0, -10.0, 8.9), 1.2, (0.0, 0.25, 0.10), 0),
    ),
    Muscle.PUCKER: (
        (_CORNER, 1.3, (-0.85, 0.0, 0.45), 0),
        ((0.0, -6.4, 9.5), 1.2, (0.0, 0.06, 0.38), 1),
        ((0.0, -7.3, 9.4), 1.2, (0.0, -0.06, 0.42), -1),
        ((3.9, -6.2, 7.2), 1.5, (-0.20, 0.0, -0.15), 0),
    ),
    Muscle.LIPS_APART: (
        ((0.0, -6.3, 9.5), 1.5, (0.0, 0.26, 0.04), 1),
        ((0.0, -7.2, 9.4), 1.5, (0.0, -0.34, 0.04), -1),
    ),
    Muscle.BROWS_UP: (
        ((1.6, 2.4, 8.6), 1.4, (0.0, 0.50, 0.05), 0),
        ((3.8, 2.6, 7.4), 1.5, (0.0, 0.55, 0.03), 0),
        ((2.0, 5.0, 8.4), 1.8, (0.0, 0.22, 0.0), 0),
    ),
    Muscle.BROWS_KNIT: (
        ((1.5, 2.0, 8.7), 1.2, (-0.30, -0.42, 0.16), 0),
        ((3.4, 2.4, 7.7), 1.3, (-0.12, -0.22, 0.05), 0),
    ),
}
_LEAST_SHIFT_CM = 1e-3


def muscle_fields(head: Head, points: Points) -> dict[Muscle, tuple[IntArray, FloatArray]]:
    """Return per muscle the rows it moves and their shift (k, 3) in centimetres at full strength."""
    fields: dict[Muscle, tuple[IntArray, FloatArray]] = {}
    soft = np.isin(head.part, (anatomy.SKIN, anatomy.CAVITY, anatomy.LID_RIM))
    almond = np.sqrt(np.clip(1.0 - (points[:, 0] / MOUTH_HALF_WIDTH) ** 2, 0.0, 1.0))
    for muscle, pulls in _PULLS.items():
        shift = np.zeros_like(points)
        for place, radius, pull, lip in pulls:
            for mirror in (1.0, -1.0) if place[0] else (1.0,):
                flip = np.array([mirror, 1.0, 1.0])
                squared = np.sum((points - flip * place) ** 2, axis=1)
                share = np.exp(-0.5 * squared / (0.7 * radius) ** 2)
                if lip:
                    share = share * _one_lip(head.side, points, almond, lip)
                shift += share[:, None] * (flip * pull)
        rows = np.flatnonzero(soft & (np.linalg.norm(shift, axis=1) > _LEAST_SHIFT_CM))
        fields[muscle] = (rows, shift[rows])
    return fields


def _one_lip(side: IntArray, points: Points, almond: FloatArray, lip: int) -> FloatArray:
    """Return 1 on that lip, 0 on the other, fading towards the corners where the two are one."""
    away = np.abs(points[:, 1] - anatomy.lip_line(points[:, 0]))
    return np.where(side == lip, np.maximum(almond, np.clip(away / 0.8, 0.0, 1.0)), 0.0)

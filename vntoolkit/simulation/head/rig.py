"""The head in motion: jaw and lids that rotate, muscles that shift the skin, a neck that turns."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.simulation.head import anatomy
from vntoolkit.simulation.head.anatomy import Head, lid_line, lip_line
from vntoolkit.simulation.head.expression import Expression, HeadPose
from vntoolkit.simulation.head.muscles import Muscle, muscle_fields
from vntoolkit.simulation.head.sculpture import EYE_CENTRE, EYE_RADIUS, MOUTH_HALF_WIDTH

_JAW_HINGE = np.array([0.0, -1.6, 0.8])
_JAW_DEG = 15.0
_UPPER_LID_DEG, _LOWER_LID_DEG = 34.0, 11.0
_LID_HALF_WIDTH = 1.25
_NECK_PIVOT = np.array([0.0, -9.0, -2.0])


class HeadRig:
    """Turns an expression and a pose into vertices, (n, 3) centimetres in the head frame."""

    def __init__(self, head: Head) -> None:
        self.head = head
        self._rest = np.array(head.vertices)
        on_rim = self._rest[head.owner]  # what hangs on a rim moves with it
        self._jaw = _jaw_share(head, on_rim)
        self._muscles = muscle_fields(head, on_rim)
        self._lids = [_lid_angles(head, on_rim, sign) for sign in (-1.0, 1.0)]
        self._eyes = [(head.part == anatomy.EYES) & (np.sign(self._rest[:, 0]) == s) for s in (-1.0, 1.0)]
        self._neck = _neck_share(self._rest)

    def vertices(self, expression: Expression, pose: HeadPose) -> Points:
        """Return all vertices; the shoulders' end of the neck stays where it is."""
        points = self._rest.copy()
        self._move_muscles(points, expression)
        self._open_jaw(points, expression.jaw)
        for eye, sign in enumerate((-1.0, 1.0)):
            self._turn_lids(points, eye, sign, expression.lids)
            self._turn_eye(points, eye, sign, expression.gaze_deg)
        return self._turn_head(points, pose)

    def _move_muscles(self, points: Points, expression: Expression) -> None:
        e = expression
        strengths = {
            Muscle.SMILE: e.smile, Muscle.GRIMACE: e.grimace, Muscle.PUCKER: e.pucker,
            Muscle.LIPS_APART: e.lips_apart,
            Muscle.BROWS_UP: max(e.brows, 0.0), Muscle.BROWS_KNIT: max(-e.brows, 0.0),
        }  # fmt: skip
        for muscle, strength in strengths.items():
            if strength != 0.0:
                rows, shift = self._muscles[muscle]
                points[rows] += strength * shift

    def _open_jaw(self, points: Points, jaw: float) -> None:
        rows = np.flatnonzero(self._jaw > 0)
        angle = np.radians(_JAW_DEG) * jaw * self._jaw[rows]
        points[rows] = _rotated_about_x(points[rows], _JAW_HINGE, angle)

    def _turn_lids(self, points: Points, eye: int, sign: float, lids: float) -> None:
        rows, angle = self._lids[eye]
        centre = np.array(EYE_CENTRE) * [sign, 1.0, 1.0]
        points[rows] = _rotated_about_x(points[rows], centre, lids * angle)

    def _turn_eye(self, points: Points, eye: int, sign: float, gaze_deg: tuple[float, float]) -> None:
        centre = np.array(EYE_CENTRE) * [sign, 1.0, 1.0]
        turn = Rotation.from_euler("yx", [gaze_deg[0], -gaze_deg[1]], degrees=True)
        points[self._eyes[eye]] = turn.apply(self._rest[self._eyes[eye]] - centre) + centre

    def _turn_head(self, points: Points, pose: HeadPose) -> Points:
        """Rotate about the neck's pivot; below it the rotation fades, the neck twists (slerp of one axis)."""
        whole = Rotation.from_euler("yxz", [pose.turn_deg, pose.nod_deg, -pose.tilt_deg], degrees=True)
        moved = whole.apply(points - _NECK_PIVOT) + _NECK_PIVOT
        rows = np.flatnonzero(self._neck < 1.0)
        part = Rotation.from_rotvec(self._neck[rows, None] * whole.as_rotvec())
        moved[rows] = part.apply(points[rows] - _NECK_PIVOT) + _NECK_PIVOT
        return moved


def _rotated_about_x(points: Points, centre: FloatArray, angle: FloatArray) -> Points:
    """Rotate each point about the x axis through `centre`; positive angles bring the front down."""
    y, z = points[:, 1] - centre[1], points[:, 2] - centre[2]
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([points[:, 0], centre[1] + c * y - s * z, centre[2] + s * y + c * z], axis=1)


def _smooth(x: FloatArray) -> FloatArray:
    x = np.clip(x, 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)


def _jaw_share(head: Head, points: Points) -> FloatArray:
    """Return (n,) how far each vertex follows the jaw: 1 chin and lower lip, 0 skull, less in the cheeks."""
    x, y, z = points.T
    level = y - lip_line(x)
    almond = np.sqrt(np.clip(1.0 - (x / MOUTH_HALF_WIDTH) ** 2, 0.0, 1.0))
    reach = 0.5 + 0.9 * np.clip(np.abs(x) - 1.6, 0.0, None)
    away = np.maximum(almond, _smooth(np.abs(level) / reach))
    share = 0.5 - 0.5 * np.where(head.side == 0, 0.0, head.side) * away
    share = np.where(z > 1.5, share, 0.5 - 0.5 * np.sign(level) * _smooth(np.abs(level) / reach))
    behind = _smooth((z + 0.5) / 4.0)  # the jaw's angle hardly moves
    throat = _smooth((y + 13.2 + 0.25 * np.clip(z, 0.0, 8.0)) / 2.2)
    share = np.clip(share, 0.0, 1.0) * behind * throat
    share = np.where((head.part == anatomy.LOWER_TEETH) | (head.part == anatomy.TONGUE), 1.0, share)
    return np.where((head.part == anatomy.UPPER_TEETH) | (head.part == anatomy.EYES), 0.0, share)


def _lid_angles(head: Head, points: Points, sign: float) -> tuple[IntArray, FloatArray]:
    """Return the vertices of one eye's lids and the angle that opens them, radians, negative upwards."""
    centre = np.array(EYE_CENTRE) * [sign, 1.0, 1.0]
    offset = points - centre
    distance = np.linalg.norm(offset, axis=1)
    near = (distance < 2.9) & (offset[:, 2] > -0.2) & (head.part != anatomy.EYES)
    rows = np.flatnonzero(near)
    o = offset[rows]
    radius = np.maximum(np.hypot(o[:, 1], o[:, 2]), 1e-6)
    elevation = np.degrees(np.arctan2(o[:, 1], o[:, 2]))
    seam = np.degrees(np.arcsin(np.clip((lid_line(points[rows, 0]) - centre[1]) / radius, -0.95, 0.95)))
    slit = head.eyes[0 if sign < 0 else 1]
    owner = head.owner[rows]
    above = np.where(
        np.isin(owner, slit.upper), True, np.where(np.isin(owner, slit.lower), False, elevation > seam)
    )
    almond = np.clip(1.0 - (o[:, 0] / _LID_HALF_WIDTH) ** 2, 0.0, 1.0) ** 0.65
    fade = 1.0 - _smooth((distance[rows] - 1.45 * EYE_RADIUS / 1.22) / 1.3)
    upper = 1.0 - _smooth((elevation - seam) / 75.0)
    lower = 1.0 - _smooth((seam - elevation) / 50.0)
    angle = np.where(above, -_UPPER_LID_DEG * np.clip(upper, 0, 1), _LOWER_LID_DEG * np.clip(lower, 0, 1))
    return rows, np.radians(angle) * almond * fade


def _neck_share(points: Points) -> FloatArray:
    """Return (n,) how far each vertex follows the head's rotation: 1 above the neck, 0 at its cut."""
    return np.where(points[:, 1] > -9.0, 1.0, _smooth((points[:, 1] + 16.5) / 7.5))

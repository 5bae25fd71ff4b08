"""The head in motion: jaw and lids that rotate, muscles that shift the skin, a neck that turns."""

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, IntArray, Points, Points2
from vntoolkit.simulation.head import anatomy
from vntoolkit.simulation.head.anatomy import Head, build_head, lid_line, lip_line
from vntoolkit.simulation.head.sculpture import EYE_CENTRE, EYE_RADIUS, MOUTH_HALF_WIDTH
from vntoolkit.simulation.scene import SCENES, Scene

_JAW_HINGE = np.array([0.0, -1.6, 0.8])
_JAW_DEG = 15.0
_UPPER_LID_DEG, _LOWER_LID_DEG = 34.0, 11.0
_LID_HALF_WIDTH = 1.25
_NECK_PIVOT = np.array([0.0, -9.0, -2.0])
# (place, radius, shift) on the side x > 0, mirrored to the other; side +1 or -1 moves that lip alone
_Pull = tuple[tuple[float, float, float], float, tuple[float, float, float], int]
_CORNER = (2.55, -6.8, 8.0)


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
        self._neck = np.where(self._rest[:, 1] > -9.0, 1.0, _smooth((self._rest[:, 1] + 16.5) / 7.5))

    def vertices(self, expression: "Expression", pose: "HeadPose") -> Points:
        """Return all vertices; the shoulders' end of the neck stays where it is."""
        points = self._rest.copy()
        self._move_muscles(points, expression)
        self._open_jaw(points, expression.jaw)
        for eye, sign in enumerate((-1.0, 1.0)):
            self._turn_lids(points, eye, sign, expression.lids)
            self._turn_eye(points, eye, sign, expression.gaze_deg)
        return self._turn_head(points, pose)

    def _move_muscles(self, points: Points, expression: "Expression") -> None:
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

    def _turn_head(self, points: Points, pose: "HeadPose") -> Points:
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


class Muscle(Enum):
    """What can be contracted."""

    SMILE = "smile"
    GRIMACE = "grimace"
    PUCKER = "pucker"
    LIPS_APART = "lips apart"
    BROWS_UP = "brows up"
    BROWS_KNIT = "brows knit"


# Muscles: each moves the skin around a few places smoothly, and separates the lips.


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


@dataclass(frozen=True, kw_only=True)
class Expression:
    """Strengths from 0 to 1, except where said.

    jaw: opening. smile, grimace, pucker: of the mouth. lips_apart: upper and lower lip part with the jaw at
    rest. brows: raised (+1) or knit (-1). lids: 1 open, 0 shut, a little above 1 staring.
    gaze_deg: (right in the image, up).
    """

    jaw: float = 0.0
    smile: float = 0.0
    grimace: float = 0.0
    pucker: float = 0.0
    lips_apart: float = 0.0
    brows: float = 0.0
    lids: float = 1.0
    gaze_deg: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, kw_only=True)
class HeadPose:
    """How the head is held, degrees about the neck's pivot: turned to the image's right, nodding, tilted."""

    turn_deg: float = 0.0
    nod_deg: float = 0.0
    tilt_deg: float = 0.0


# Expressions and poses over time, for the two head scenes.


# what happens when, in seconds of a 16.7 s performance; it repeats
_PERIOD_S = 1000 / 60
_SMILES = ((1.2, 3.0, 0.9), (12.6, 14.2, 0.6))
_GRIMACES = ((4.0, 5.4, 1.0), (15.0, 15.9, 0.7))
_SPEECH = (6.2, 11.8)
_BLINKS = (0.7, 3.4, 5.8, 8.3, 10.9, 14.6, 16.2)
_BROWS = ((2.0, 2.9, 0.6), (4.0, 5.4, -0.9), (7.0, 7.6, 0.7), (9.4, 10.0, 0.6), (13.0, 13.8, 0.9))
_SYLLABLE_HZ = 2.6


def performance_at(time_s: float, phases: FloatArray) -> Expression:
    """Return smiling, grimacing, speaking and blinking at a time; phases: (8,) radians vary the speech."""
    time = time_s % _PERIOD_S
    speaking = _window(time, *_SPEECH, ramp=0.35)
    beat = 2.0 * np.pi * _SYLLABLE_HZ * time
    syllable = 0.5 + 0.5 * np.sin(beat + 0.6 * np.sin(0.31 * beat + phases[0]))
    stress = 0.65 + 0.35 * np.sin(0.23 * beat + phases[1])
    rounding = np.clip(np.sin(0.47 * beat + phases[2]), 0.0, 1.0)
    blink = max(_bell((time - at) / 0.085) for at in _BLINKS)
    smile = sum(size * _window(time, a, b, ramp=0.5) for a, b, size in _SMILES)
    grimace = sum(size * _window(time, a, b, ramp=0.4) for a, b, size in _GRIMACES)
    return Expression(
        jaw=float(0.75 * speaking * syllable * stress + 0.10 * smile),
        smile=float(smile + 0.15 * speaking * (1.0 - rounding)),
        grimace=float(grimace),
        pucker=float(0.85 * speaking * rounding),
        lips_apart=float(0.35 * speaking + 0.5 * smile + 0.8 * grimace),
        brows=float(sum(size * _window(time, a, b, ramp=0.3) for a, b, size in _BROWS)),
        lids=float((1.0 - 0.22 * smile - 0.35 * grimace) * (1.0 - blink)),
        gaze_deg=(float(4.0 * np.sin(0.9 * time + phases[3])), float(2.0 * np.sin(0.7 * time + phases[4]))),
    )


def performance_pose(time_s: float, phases: FloatArray) -> HeadPose:
    """Return the small movements of a head that talks."""
    w = 2.0 * np.pi * time_s
    return HeadPose(
        turn_deg=float(6.0 * np.sin(0.21 * w + phases[5]) + 1.5 * np.sin(0.55 * w + phases[6])),
        nod_deg=float(2.5 * np.sin(0.33 * w + phases[7])),
        tilt_deg=float(2.5 * np.sin(0.17 * w + phases[6])),
    )


def turning_pose(share: float, widest_deg: float) -> HeadPose:
    """Return the pose at a share (0 to 1) of a turn from the left end to the right end, at rest at both."""
    return HeadPose(turn_deg=float(-widest_deg * np.cos(np.pi * share)))


def _window(time: float, start: float, end: float, ramp: float) -> float:
    """Return 1 between start and end, smoothly 0 outside, `ramp` seconds for each flank."""
    share = np.clip(min(time - start, end - time) / ramp, 0.0, 1.0)
    return float(share * share * (3.0 - 2.0 * share))


def _bell(x: float) -> float:
    return float(np.exp(-0.5 * x * x))


# True seams in the image: where lips and lids separate, for the seams file of `track`.


def seam_lines_px(scene: Scene, frame: int) -> tuple[Points2, ...]:
    """Return the upper and the lower edge of every loop, each (k, 2) in pixels; none without a head.

    As two lines, since shut lips and lids have both edges in one place, and are cut all the same.
    """
    if not SCENES.get(scene.name, "").startswith("vntoolkit.simulation.head."):
        return ()
    head, vertices = build_head(), scene.vertices(frame)
    slits = (head.mouth, *head.eyes)
    return tuple(scene.camera.project(vertices[edge]) for slit in slits for edge in (slit.upper, slit.lower))

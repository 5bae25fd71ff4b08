"""The head: its neutral shape, and how jaw, lids, muscles and neck move it.

Head frame: centimetres, x to the right in the image (the person's left), y up, z towards the viewer, origin
between the ears at the height of the pupils. `recipes/scene_shapes.py` sculpted it.
"""

from dataclasses import dataclass
from enum import Enum
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import Colours, Faces, FloatArray, IntArray, Points, Points2, read_only
from vntoolkit.simulation.scene import SCENES, Scene
from vntoolkit.simulation.shapes import read_shape, smooth_step

SKIN, CAVITY, LID_RIM, EYES, UPPER_TEETH, LOWER_TEETH, TONGUE = range(7)
EYE_CENTRE = (3.15, 0.0, 6.75)
_JAW_HINGE = np.array([0.0, -1.6, 0.8])
_JAW_DEG = 15.0
_NECK_PIVOT = np.array([0.0, -9.0, -2.0])


class Makeup(Enum):
    """Bare skin with freckles, or one uniform colour over the whole skin, lips and brows."""

    NONE = "none"
    UNIFORM = "uniform"


class Muscle(Enum):
    """What can be contracted."""

    SMILE = "smile"
    GRIMACE = "grimace"
    PUCKER = "pucker"
    LIPS_APART = "lips_apart"
    BROWS_UP = "brows_up"
    BROWS_KNIT = "brows_knit"


@dataclass(frozen=True, kw_only=True, eq=False)
class Slit:
    """The two sides of a cut, vertex numbers from its smallest to its largest x.

    upper and lower have the same length and share their first and last vertex, the corners.
    """

    upper: IntArray
    lower: IntArray

    @property
    def loop(self) -> IntArray:
        """Vertex numbers once round, from the corner of least x: along the upper side, back by the lower."""
        return np.concatenate([self.upper, self.lower[-2:0:-1]])


@dataclass(frozen=True, kw_only=True, eq=False)
class Head:
    """The neutral head, lids and lips closed.

    part: (n,) one of SKIN … TONGUE. hair: (n,) from 0 skin to 1 hair. mouth, eyes: the slits; eyes[0] lies at
    x < 0. colours: (n, 3) weights of the RGB pigments. jaw: (n,) how far a vertex follows the jaw, 0 to 1.
    lids: (n,) the angle that opens the lids, radians, negative upwards. muscles: (n, 3) centimetres by which
    each shifts the skin at full strength.
    """

    vertices: Points
    faces: Faces
    part: IntArray
    hair: FloatArray
    mouth: Slit
    eyes: tuple[Slit, Slit]
    colours: dict[Makeup, Colours]
    jaw: FloatArray
    lids: FloatArray
    muscles: dict[Muscle, Points]


@cache
def read_head() -> Head:
    """Read the head that the package ships, once per process."""
    shape = read_shape("head")
    slits = {
        name: Slit(upper=shape[f"{name}_upper"], lower=shape[f"{name}_lower"])
        for name in ("mouth", "left_eye", "right_eye")
    }
    white = np.iinfo(np.uint16).max
    return Head(
        vertices=read_only(shape["vertices"].astype(np.float64)),
        faces=read_only(shape["faces"]),
        part=shape["part"],
        hair=shape["hair"].astype(np.float64),
        mouth=slits["mouth"],
        eyes=(slits["left_eye"], slits["right_eye"]),
        colours={m: (shape[f"colours_{m.value}"] / white).astype(np.float32) for m in Makeup},
        jaw=shape["jaw"].astype(np.float64),
        lids=shape["lids"].astype(np.float64),
        muscles={m: shape[m.value].astype(np.float64) for m in Muscle},
    )


class HeadRig:
    """Turns an expression and a pose into vertices, (n, 3) centimetres in the head frame."""

    def __init__(self, head: Head) -> None:
        self.head = head
        x, y, _ = head.vertices.T
        self._jaw = np.flatnonzero(head.jaw > 0)
        self._lids = [np.flatnonzero((head.lids != 0) & (np.sign(x) == sign)) for sign in (-1.0, 1.0)]
        self._eyes = [(head.part == EYES) & (np.sign(x) == sign) for sign in (-1.0, 1.0)]
        self._neck = np.where(y > -9.0, 1.0, smooth_step((y + 16.5) / 7.5))

    def vertices(self, expression: "Expression", pose: "HeadPose") -> Points:
        """Return all vertices; the shoulders' end of the neck stays where it is."""
        points = np.array(self.head.vertices)
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
                points += strength * self.head.muscles[muscle]

    def _open_jaw(self, points: Points, jaw: float) -> None:
        angle = np.radians(_JAW_DEG) * jaw * self.head.jaw[self._jaw]
        points[self._jaw] = _rotated_about_x(points[self._jaw], _JAW_HINGE, angle)

    def _turn_lids(self, points: Points, eye: int, sign: float, lids: float) -> None:
        rows = self._lids[eye]
        centre = np.array(EYE_CENTRE) * [sign, 1.0, 1.0]
        points[rows] = _rotated_about_x(points[rows], centre, lids * self.head.lids[rows])

    def _turn_eye(self, points: Points, eye: int, sign: float, gaze_deg: tuple[float, float]) -> None:
        centre = np.array(EYE_CENTRE) * [sign, 1.0, 1.0]
        turn = Rotation.from_euler("yx", [gaze_deg[0], -gaze_deg[1]], degrees=True)
        points[self._eyes[eye]] = turn.apply(self.head.vertices[self._eyes[eye]] - centre) + centre

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
    return float(smooth_step(min(time - start, end - time) / ramp))


def _bell(x: float) -> float:
    return float(np.exp(-0.5 * x * x))


# True seams in the image: where lips and lids separate, for the seams file of `track`.


def seam_lines_px(scene: Scene, frame: int) -> tuple[Points2, ...]:
    """Return the upper and the lower edge of every loop, each (k, 2) in pixels; none without a head.

    As two lines, since shut lips and lids have both edges in one place, and are cut all the same.
    """
    if not SCENES.get(scene.name, "").startswith("vntoolkit.simulation.head."):
        return ()
    head, vertices = read_head(), scene.vertices(frame)
    slits = (head.mouth, *head.eyes)
    return tuple(scene.camera.project(vertices[edge]) for slit in slits for edge in (slit.upper, slit.lower))

"""A dancer's upper body: tapered capsules whose joints follow a smooth, seeded choreography.

Studio frame of the body: metres, x right in the image, y up, z towards the viewer; origin at the throat.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.simulation.body.capsules import Capsules

# height of a section below the throat, half its span, radius at its ends
_SEAT = (-0.85, 0.085, 0.100)
_HIPS = (-0.60, 0.085, 0.105)
_WAIST = (-0.40, 0.065, 0.088)
_CHEST = (-0.19, 0.080, 0.105)
_SHOULDERS = (-0.075, 0.110, 0.068)
_TORSO = (_SEAT, _HIPS, _WAIST, _CHEST, _SHOULDERS)
_UPPER_ARM_M, _FOREARM_M = 0.29, 0.25
_ARM_RADII = (0.056, 0.042, 0.030)
_REST_DROP_DEG = 25.0
_TEMPO = 0.85  # slows the whole dance; the frequencies below are those at 1


@dataclass(frozen=True, kw_only=True)
class Pose:
    """One posture; angles in radians, shifts in metres.

    shift: (x, y, z) of the hips. hip_turn, chest_turn: about the vertical. bend: of the chest to the side.
    arm_drop, arm_forward, elbow: (left in the image, right in the image) below the horizontal, towards the
    viewer, bend of the elbow.
    """

    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    hip_turn: float = 0.0
    chest_turn: float = 0.0
    bend: float = 0.0
    arm_drop: tuple[float, float] = (np.deg2rad(_REST_DROP_DEG), np.deg2rad(_REST_DROP_DEG))
    arm_forward: tuple[float, float] = (0.0, 0.0)
    elbow: tuple[float, float] = (0.0, 0.0)


def body_from_pose(pose: Pose) -> Capsules:
    """Return the body in that pose; the capsules keep their order and radii."""
    sections = [_section(pose, index) for index in range(len(_TORSO))]
    starts: list[FloatArray] = []
    ends: list[FloatArray] = []
    radii: list[tuple[float, float]] = []
    for centre, half, radius in sections:
        starts.append(centre - half)
        ends.append(centre + half)
        radii.append((radius, radius))
    for (low, low_half, low_r), (high, high_half, high_r) in pairwise(sections):
        for side in (-1.0, 0.0, 1.0):
            starts.append(low + side * low_half)
            ends.append(high + side * high_half)
            radii.append((low_r, high_r))
    for joints in (_arm(pose, 0, sections[-1]), _arm(pose, 1, sections[-1])):
        for i in range(2):
            starts.append(joints[i])
            ends.append(joints[i + 1])
            radii.append((_ARM_RADII[i], _ARM_RADII[i + 1]))
    throat = sections[-1][0]
    up = throat - sections[-2][0]
    starts.append(throat)
    ends.append(throat + up / np.linalg.norm(up) * 0.16)
    radii.append((0.055, 0.052))
    return Capsules(starts=np.array(starts), ends=np.array(ends), radii=np.array(radii))


def pose_at(time_s: float, phases: FloatArray, amount: float = 1.0) -> Pose:
    """Return the choreography at a time; `amount` fades from the rest pose (0) to the dance (1).

    phases: (8,) radians, the dancer's own.
    """
    swing = 2.0 * np.pi * _TEMPO * time_s

    def wave(hertz: float, index: int) -> float:
        return float(np.sin(swing * hertz + phases[index]))

    turn = 0.36 * wave(0.37, 0) + 0.07 * wave(0.92, 1)
    rest = np.deg2rad(_REST_DROP_DEG)
    drop = [0.74 + 0.24 * wave(0.46, 2 + side) + 0.06 * wave(0.92, 4 + side) for side in (0, 1)]
    forward = [0.12 + 0.22 * wave(0.53, 5 - side) for side in (0, 1)]
    elbow = [0.26 + 0.14 * wave(0.46, 6 + side) for side in (0, 1)]
    return Pose(
        shift=(
            amount * 0.055 * wave(0.46, 1),
            amount * (0.010 * wave(1.84, 1) - 0.005),
            amount * 0.03 * wave(0.31, 3),
        ),
        hip_turn=amount * (-0.16 * wave(0.37, 0) + 0.10 * wave(0.46, 4)),
        chest_turn=amount * turn,
        bend=amount * 0.13 * wave(0.46, 1),
        arm_drop=(rest + amount * (drop[0] - rest), rest + amount * (drop[1] - rest)),
        arm_forward=(amount * forward[0], amount * forward[1]),
        elbow=(amount * elbow[0], amount * elbow[1]),
    )


def _section(pose: Pose, index: int) -> tuple[FloatArray, FloatArray, float]:
    """Return centre, half span (3,) and radius of a torso section; turn and bend grow from hips to chest."""
    height, span, radius = _TORSO[index]
    share = (height - _HIPS[0]) / (_CHEST[0] - _HIPS[0])
    share = float(np.clip(share, 0.0, 1.0))
    turn = pose.hip_turn + share * (pose.chest_turn - pose.hip_turn)
    lean = pose.bend * share
    above = height - _HIPS[0]
    upwards = np.array([above * np.sin(lean), _HIPS[0] + above * np.cos(lean), 0.0])
    centre = np.array(pose.shift) + upwards
    level = np.array([np.cos(lean), -np.sin(lean), 0.0])
    half = span * (np.cos(turn) * level - np.sin(turn) * np.array([0.0, 0.0, 1.0]))
    return centre, half, radius


def _arm(pose: Pose, side: int, shoulders: tuple[FloatArray, FloatArray, float]) -> Points:
    """Return shoulder, elbow and wrist (3, 3)."""
    centre, half, _ = shoulders
    across = half / np.linalg.norm(half) * (1.0 if side else -1.0)
    front = np.cross(half, [0.0, 1.0, 0.0])
    front /= np.linalg.norm(front)
    drop, forward, elbow = pose.arm_drop[side], pose.arm_forward[side], pose.elbow[side]
    reach = np.cos(drop) * (np.cos(forward) * across + np.sin(forward) * front)
    upper = reach - np.sin(drop) * np.array([0.0, 1.0, 0.0])
    target = 0.5 * front + 0.7 * np.array([0.0, 1.0, 0.0]) + 0.2 * across
    bend = target - (target @ upper) * upper
    bend /= np.linalg.norm(bend)
    shoulder = centre + 1.45 * half * (1.0 if side else -1.0)
    joint = shoulder + _UPPER_ARM_M * upper
    return np.stack([shoulder, joint, joint + _FOREARM_M * (np.cos(elbow) * upper + np.sin(elbow) * bend)])

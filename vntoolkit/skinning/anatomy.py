"""Trunk, arms and legs of a skeleton, found by its branching, because names differ between files."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Vector3
from vntoolkit.geometry.motion import Skeleton

_LEG_DROP = 0.25  # of the height: what hangs this far below the root is a leg
_NECK_RISE = 0.05  # of the trunk: files put joints of no length between chest and neck
_UP = np.array([0.0, -1.0, 0.0])  # camera axes


@dataclass(frozen=True, kw_only=True)
class Anatomy:
    """Joints by role.

    trunk: from the root to the base of the neck. legs: every joint of either leg. arms: for each chain that
    leaves the trunk, its joints on the way to the farthest one.
    """

    trunk: tuple[int, ...]
    legs: tuple[int, ...]
    arms: tuple[tuple[int, ...], ...]


def anatomy_of(skeleton: Skeleton) -> Anatomy:
    """Find the trunk and the legs in the rest pose; a skeleton without legs is all trunk and arms.

    The trunk is the way from the root to the highest point, up to the first joint above the branching of
    the arms.
    """
    heights = skeleton.rest_positions @ _UP
    tips = skeleton.rest_tips @ _UP
    subtree = [_descendants(skeleton, joint) for joint in range(len(skeleton.names))]
    roots_children = np.flatnonzero(skeleton.parents == 0)
    legs: list[int] = []
    for child in roots_children:
        own_tips = tips[np.isin(skeleton.tip_joints, subtree[child])]
        if (
            min(np.concatenate([heights[subtree[child]], own_tips]))
            < heights[0] - _LEG_DROP * skeleton.height
        ):
            legs += subtree[child]
    torso = [joint for joint in range(len(skeleton.names)) if joint not in set(legs)]
    top = max(torso, key=lambda joint: max([heights[joint], *tips[skeleton.tip_joints == joint]]))
    path = [top]
    while skeleton.parents[path[-1]] >= 0:
        path.append(int(skeleton.parents[path[-1]]))
    path.reverse()
    branching = [
        place
        for place, joint in enumerate(path)
        if place and sum(int(skeleton.parents[other]) == joint for other in torso) > 1
    ]
    last = _neck_base(path, branching[-1], heights) if branching else len(path) - 1
    starts = [j for j in torso if skeleton.parents[j] in path[: last + 1] and j not in path]
    arms = tuple(_longest_chain(skeleton, start, subtree[start]) for start in starts)
    return Anatomy(trunk=tuple(path[: last + 1]), legs=tuple(legs), arms=arms)


def _longest_chain(skeleton: Skeleton, start: int, joints: list[int]) -> tuple[int, ...]:
    positions = skeleton.rest_positions
    farthest = max(joints, key=lambda joint: float(np.linalg.norm(positions[joint] - positions[start])))
    chain = [farthest]
    while chain[-1] != start:
        chain.append(int(skeleton.parents[chain[-1]]))
    return tuple(reversed(chain))


def _neck_base(path: list[int], place: int, heights: FloatArray) -> int:
    """Go on from where the arms branch off to the next joint that lies higher: the neck begins there."""
    for above in range(place + 1, len(path)):
        if heights[path[above]] > heights[path[place]] + _NECK_RISE * (heights[path[place]] - heights[0]):
            return above
    return place


def shoulders_of(skeleton: Skeleton, anatomy: Anatomy) -> tuple[int, ...]:
    """Return for each arm the joint that turns its longest bone: the upper arm, not the collar bone."""
    return tuple(_shoulder(skeleton, arm) for arm in anatomy.arms)


def _shoulder(skeleton: Skeleton, arm: tuple[int, ...]) -> int:
    lengths = np.linalg.norm(skeleton.offsets[list(arm[1:])], axis=1)
    return arm[int(np.argmax(lengths))] if len(lengths) else arm[0]


def facing_of(skeleton: Skeleton, legs: tuple[int, ...]) -> Vector3:
    """Return the horizontal unit vector in which the toes point, −z (towards the camera) where unknown."""
    feet = [tip for tip, joint in enumerate(skeleton.tip_joints) if joint in legs]
    toes = sum((skeleton.tip_offsets[tip] for tip in feet), np.zeros(3))
    for tip in feet:
        joint = skeleton.tip_joints[tip]
        toes = toes + skeleton.offsets[joint] * (skeleton.parents[joint] > 0)
    toes[1] = 0.0
    length = float(np.linalg.norm(toes))
    return toes / length if length > 0.02 * skeleton.height else np.array([0.0, 0.0, -1.0])


def _descendants(skeleton: Skeleton, joint: int) -> list[int]:
    found = [joint]
    for other in range(joint + 1, len(skeleton.names)):
        if skeleton.parents[other] in found:
            found.append(other)
    return found

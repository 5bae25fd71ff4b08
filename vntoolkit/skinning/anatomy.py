"""Trunk, arms and legs of a skeleton: by names that programs give joints, else by its branching."""

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import FloatArray, Points, Vector3
from vntoolkit.errors import BadInput
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


def legs_of(skeleton: Skeleton, anatomy: Anatomy) -> tuple[tuple[int, ...], ...]:
    """Return for each leg its joints on the way to the farthest one."""
    starts = [joint for joint in anatomy.legs if skeleton.parents[joint] not in anatomy.legs]
    return tuple(_longest_chain(skeleton, start, _descendants(skeleton, start)) for start in starts)


def shoulders_of(skeleton: Skeleton, anatomy: Anatomy) -> tuple[int, ...]:
    """Return for each arm the joint that turns its longest bone: the upper arm, not the collar bone."""
    return tuple(longest_bone_of(skeleton, arm) for arm in anatomy.arms)


def longest_bone_of(skeleton: Skeleton, chain: tuple[int, ...]) -> int:
    """Return the joint that turns the longest bone of an arm or a leg."""
    lengths = np.linalg.norm(skeleton.offsets[list(chain[1:])], axis=1)
    return chain[int(np.argmax(lengths))] if len(lengths) else chain[0]


def tip_of(skeleton: Skeleton, pose: FloatArray, joint: int) -> Vector3:
    """Return (3,), where the bone of a last joint ends in a pose (j, 4, 4)."""
    tips = np.flatnonzero(skeleton.tip_joints == joint)
    offset = skeleton.tip_offsets[tips[0]] if len(tips) else np.zeros(3)
    return np.asarray(pose[joint, :3, :3] @ offset + pose[joint, :3, 3])


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


# The joints of an arm, by name and else by the lengths of its bones.

# What programs call the joint that turns the upper arm, the forearm and the hand, without side and prefix.
# Mixamo, Rokoko, CMU's BVH and ASF, SMPL, Unreal, Rigify, Xsens, Biovision.
_NAMES = {
    "upper-arm": ("upperarm", "arm", "humerus", "uparm", "shldr", "bicep", "shoulder"),
    "forearm": ("forearm", "lowerarm", "radius", "loarm", "elbow", "ulna"),
    "hand": ("hand", "wrist"),
}
_PREFIX = re.compile(r"^.*[:|]|^(bip\d+|def|org|mch|character\d*|[mf]_avg)[ _.-]", re.IGNORECASE)
ARM_ROLES = tuple(f"{side}-{part}" for side in ("left", "right") for part in _NAMES)


@dataclass(frozen=True, kw_only=True)
class Arm:
    """An arm.

    joints: all that move with its collar bone. upper, fore, hand: the joints that turn those parts; hand is
    −1 where the forearm ends the chain. side: 1 for the arm at greater x of a figure that faces the camera,
    else −1.
    """

    joints: tuple[int, ...]
    upper: int
    fore: int
    hand: int
    side: int

    def moved_with(self, skeleton: Skeleton) -> tuple[list[int], list[int], list[int]]:
        """Return the joints that turn with the upper arm, the forearm and the hand."""
        hand = _descendants(skeleton, self.hand) if self.hand >= 0 else []
        fore = [joint for joint in _descendants(skeleton, self.fore) if joint not in hand]
        upper = [joint for joint in _descendants(skeleton, self.upper) if joint not in hand + fore]
        return upper, fore, hand

    def points(self, skeleton: Skeleton, pose: FloatArray) -> Points:
        """Return (3, 3): shoulder, elbow and wrist in a pose (j, 4, 4)."""
        wrist = pose[self.hand, :3, 3] if self.hand >= 0 else tip_of(skeleton, pose, self.fore)
        return np.stack([pose[self.upper, :3, 3], pose[self.fore, :3, 3], wrist])


def arms_of(skeleton: Skeleton, anatomy: Anatomy, named: Mapping[str, str] | None = None) -> tuple[Arm, ...]:
    """Return the arms, at most one a side: left and right by where they are, not by what they are called.

    named: joints by role (`left-upper-arm`, …), for those that have names of their own. Raises `BadInput`
    for a role or a joint that there is not.
    """
    given = _given(skeleton, named or {})
    across = np.cross(facing_of(skeleton, anatomy.legs), [0.0, 1.0, 0.0])
    positions = skeleton.rest_positions
    middle = positions[list(anatomy.trunk)].mean(axis=0)
    found: dict[int, Arm] = {}
    for chain in anatomy.arms:
        joints = _descendants(skeleton, chain[0])
        parts = _parts(skeleton, chain, joints, given)
        if parts is None:
            continue
        side = int(np.sign((positions[parts[0]] - middle) @ across))
        reach = float(np.linalg.norm(positions[parts[1]] - positions[parts[0]]))
        if side and reach > 0 and side not in found:
            upper, fore, hand = parts
            found[side] = Arm(joints=tuple(joints), upper=upper, fore=fore, hand=hand, side=side)
    return tuple(found[side] for side in sorted(found))


def _given(skeleton: Skeleton, named: Mapping[str, str]) -> dict[int, str]:
    for role in named:
        if role not in ARM_ROLES:
            raise BadInput(f"map: no role {role!r}; expected one of {', '.join(ARM_ROLES)}")
    return {skeleton.index_of(name): role.split("-", 1)[1] for role, name in named.items()}


def _parts(
    skeleton: Skeleton, chain: tuple[int, ...], joints: list[int], given: Mapping[int, str]
) -> tuple[int, int, int] | None:
    """Return upper arm, forearm and hand: as given, by name, or the two longest bones in a row; or None."""
    upper = _named(skeleton, joints, "upper-arm", given)
    fore = _named(skeleton, joints, "forearm", given)
    hand = _named(skeleton, joints, "hand", given)
    if upper < 0 or fore < 0 or upper == fore:
        lengths = np.linalg.norm(skeleton.offsets[list(chain[1:])], axis=1)
        if len(chain) < 2 or not lengths.max() > 0:
            return None
        place = int(np.argmax(lengths))
        upper, fore = chain[place], chain[place + 1]
        hand = chain[place + 2] if place + 2 < len(chain) else -1
    return upper, fore, hand


def _named(skeleton: Skeleton, joints: list[int], part: str, given: Mapping[int, str]) -> int:
    """Return the first joint of a part, −1 for none; where one is given, names do not count."""
    own = [joint for joint in joints if given.get(joint) == part]
    if own:
        return own[0]
    called = {joint: _plain(skeleton.names[joint]) for joint in joints}
    if part == "hand":  # the wrist comes before the hand where there are both
        return next((joint for joint in joints if called[joint] & set(_NAMES[part])), -1)
    for name in _NAMES[part]:  # a shoulder is the collar bone where there is an arm too
        matching = [joint for joint in joints if name in called[joint]]
        if matching:
            return matching[0]
    return -1


def _plain(name: str) -> set[str]:
    """Return what a joint may be called: small letters, without prefix, and without what may be a side."""
    letters = re.sub(r"[^a-z]", "", _PREFIX.sub("", name.strip()).lower())
    sides = (letters, letters[1:], letters[:-1], letters.removeprefix("left"), letters.removeprefix("right"))
    return {*sides, letters.removesuffix("left"), letters.removesuffix("right")}


def _descendants(skeleton: Skeleton, joint: int) -> list[int]:
    found = [joint]
    for other in range(joint + 1, len(skeleton.names)):
        if skeleton.parents[other] in found:
            found.append(other)
    return found

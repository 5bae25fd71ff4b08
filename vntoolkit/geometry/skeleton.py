"""An articulated skeleton: joints, their offsets, and the tips of the last bones."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadMotion

_UP_AXIS = 1  # y: down in the camera frame, up on disk


@dataclass(frozen=True, kw_only=True, eq=False)
class Skeleton:
    """A tree of joints in its rest pose, in which no joint is turned.

    names: one unique name a joint. parents: (j,) index of the parent, −1 for the root, which is joint 0;
    a parent comes before its children, so a cycle cannot be expressed. offsets: (j, 3) from the parent to
    the joint in the rest pose; the root's is its rest position. tip_joints, tip_offsets: (t,) and (t, 3),
    the ends of bones that carry no further joint. Axes are the camera frame's (y down); the length unit
    is the file's until `scaled`.
    """

    names: tuple[str, ...]
    parents: IntArray
    offsets: Points
    tip_joints: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    tip_offsets: Points = field(default_factory=lambda: np.zeros((0, 3)))

    def __post_init__(self) -> None:
        count = len(self.names)
        if len(set(self.names)) != count or not count:
            raise BadMotion("skeleton: expected at least one joint and every joint name once")
        for name, kind, shape in (
            ("parents", np.int64, (count,)),
            ("offsets", np.float64, (count, 3)),
            ("tip_joints", np.int64, (None,)),
            ("tip_offsets", np.float64, (len(self.tip_joints), 3)),
        ):
            values = np.array(getattr(self, name), dtype=kind)
            require_shape(values, shape, f"skeleton {name}", BadMotion)
            require_finite(values, f"skeleton {name}", BadMotion)
            object.__setattr__(self, name, read_only(values))
        if self.parents[0] != -1 or np.any(self.parents[1:] < 0):
            raise BadMotion("skeleton: expected one root, the first joint")
        if np.any(self.parents >= np.arange(count)):
            raise BadMotion("skeleton: a parent must come before its children (no cycles)")
        if self.tip_joints.size and not (self.tip_joints.min() >= 0 and self.tip_joints.max() < count):
            raise BadMotion("skeleton: a tip names a joint that does not exist")

    @property
    def rest_positions(self) -> Points:
        """(j, 3) joint positions in the rest pose."""
        positions = np.array(self.offsets)
        for joint in range(1, len(self.names)):
            positions[joint] += positions[self.parents[joint]]
        return positions

    @property
    def rest_tips(self) -> Points:
        """(t, 3) tip positions in the rest pose."""
        return self.rest_positions[self.tip_joints] + self.tip_offsets

    @property
    def height(self) -> float:
        """Vertical extent of the rest pose, tips included."""
        return float(np.ptp(np.concatenate([self.rest_positions, self.rest_tips])[:, _UP_AXIS]))

    def index_of(self, name: str) -> int:
        """Return the index of a joint by its name, or raise `BadMotion` with the names there are."""
        if name not in self.names:
            raise BadMotion(f"the skeleton has no joint {name!r}; it has {', '.join(self.names)}")
        return self.names.index(name)

    def scaled(self, factor: float) -> Skeleton:
        """Return the skeleton with every length multiplied by `factor`."""
        return replace(self, offsets=self.offsets * factor, tip_offsets=self.tip_offsets * factor)


def joint_paths(skeleton: Skeleton) -> list[str]:
    """Return each joint's path from the root, as `Hips/LeftHip/LeftKnee`."""
    paths: list[str] = []
    for name, parent in zip(skeleton.names, skeleton.parents, strict=True):
        paths.append(name if parent < 0 else f"{paths[parent]}/{name}")
    return paths


def rest_pose(skeleton: Skeleton) -> FloatArray:
    """Return rest_from_model, (j, 4, 4): in the rest pose joints are moved, not turned."""
    matrices = np.tile(np.eye(4), (len(skeleton.names), 1, 1))
    matrices[:, :3, 3] = skeleton.rest_positions
    return matrices

"""Motion capture in memory: a skeleton, the rotations of its joints in every frame, and their poses."""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, IntArray, Matrix3, Points
from vntoolkit.checks import set_arrays
from vntoolkit.errors import BadMotion

_UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class Motion:
    """A moving skeleton.

    rotations: (frames, j, 4) unit quaternions (x, y, z, w), each joint's turn against its parent.
    root_positions: (frames, 3) of the root joint. frame_rate_hz: frames per second. metres_per_unit: the
    length of 1 in metres, or None where the file does not say (BVH never does).
    """

    skeleton: "Skeleton"
    rotations: FloatArray
    root_positions: Points
    frame_rate_hz: float
    metres_per_unit: float | None = None

    def __post_init__(self) -> None:
        count = len(self.rotations)
        shapes = {"rotations": (count, len(self.skeleton.names), 4), "root_positions": (count, 3)}
        set_arrays(self, shapes, called="motion: {}", dtype=np.float64, error=BadMotion)
        if not count:
            raise BadMotion("motion: expected at least one frame")
        if np.abs(np.linalg.norm(self.rotations, axis=-1) - 1).max() > _UNIT_TOLERANCE:
            raise BadMotion("joint rotations: expected unit quaternions")
        if not 0 < self.frame_rate_hz < np.inf:
            raise BadMotion(f"frame rate: expected a positive number, got {self.frame_rate_hz}")
        if self.metres_per_unit is not None and not 0 < self.metres_per_unit < np.inf:
            raise BadMotion(f"metres per unit: expected a positive number, got {self.metres_per_unit}")

    def __len__(self) -> int:
        return int(self.rotations.shape[0])

    @property
    def duration_s(self) -> float:
        """Seconds from the first to the last frame."""
        return (len(self) - 1) / self.frame_rate_hz

    def turned(self, rotation: Matrix3) -> "Motion":
        """Return the motion in axes turned by `rotation` (3, 3): rest pose, positions and joint turns."""
        rotation = np.asarray(rotation, dtype=np.float64)
        skeleton = replace(
            self.skeleton,
            offsets=self.skeleton.offsets @ rotation.T,
            tip_offsets=self.skeleton.tip_offsets @ rotation.T,
        )
        axes, scalars = self.rotations[..., :3], self.rotations[..., 3:]
        return replace(
            self,
            skeleton=skeleton,
            rotations=np.concatenate([axes @ rotation.T, scalars], axis=-1),
            root_positions=self.root_positions @ rotation.T,
        )

    def in_metres(self, figure_height_m: float) -> "Motion":
        """Return the motion in metres; a file without unit is scaled to the figure's height in metres."""
        height = self.skeleton.height
        if self.metres_per_unit is None and not height > 0:
            raise BadMotion("motion: the skeleton has no height, so its scale cannot be guessed")
        factor = self.metres_per_unit if self.metres_per_unit is not None else figure_height_m / height
        return replace(
            self,
            skeleton=self.skeleton.scaled(factor),
            root_positions=self.root_positions * factor,
            metres_per_unit=1.0,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Skeleton:
    """A tree of joints in its rest pose, in which no joint is rotated.

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
        numbers = {"parents": (count,), "tip_joints": (None,)}
        lengths = {"offsets": (count, 3), "tip_offsets": (len(self.tip_joints), 3)}
        set_arrays(self, numbers, called="skeleton: {}", dtype=np.int64, error=BadMotion)
        set_arrays(self, lengths, called="skeleton: {}", dtype=np.float64, error=BadMotion)
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
        y = np.concatenate([self.rest_positions, self.rest_tips])[
            :, 1
        ]  # down in the camera frame, up on disk
        return float(np.ptp(y))

    def index_of(self, name: str) -> int:
        """Return the index of a joint by its name, or raise `BadMotion` with the names there are."""
        if name not in self.names:
            raise BadMotion(f"the skeleton has no joint {name!r}; it has {', '.join(self.names)}")
        return self.names.index(name)

    def scaled(self, factor: float) -> "Skeleton":
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


def forward_kinematics(skeleton: Skeleton, rotations: FloatArray, root_positions: Points) -> FloatArray:
    """Return posed_from_model S (equation 8), (frames, j, 4, 4), of rotations (frames, j, 4).

    S_i takes a point from joint i's own frame to where the pose puts it; the root's position replaces its
    offset.
    """
    frames, count = rotations.shape[:2]
    local = Rotation.from_quat(rotations.reshape(-1, 4)).as_matrix().reshape(frames, count, 3, 3)
    posed_from_model = np.zeros((frames, count, 4, 4))
    posed_from_model[..., 3, 3] = 1
    posed_from_model[:, 0, :3, :3] = local[:, 0]
    posed_from_model[:, 0, :3, 3] = root_positions
    for joint in range(1, count):
        above = posed_from_model[:, skeleton.parents[joint]]
        posed_from_model[:, joint, :3, :3] = above[:, :3, :3] @ local[:, joint]
        posed_from_model[:, joint, :3, 3] = above[:, :3, :3] @ skeleton.offsets[joint] + above[:, :3, 3]
    return posed_from_model


def pose_of_frame(motion: Motion, frame: int) -> FloatArray:
    """Return posed_from_model of one frame, (j, 4, 4)."""
    one = slice(frame, frame + 1)
    return forward_kinematics(motion.skeleton, motion.rotations[one], motion.root_positions[one])[0]


def bone_segments(skeleton: Skeleton, pose: FloatArray) -> tuple[IntArray, Points, Points]:
    """Return the bones in a pose (j, 4, 4): the joint that turns each one, (b,), and its ends, (b, 3) twice.

    A bone runs from a joint to each of its children and tips; bones without length are left out.
    """
    children = np.arange(1, len(skeleton.names))
    joints = np.concatenate([skeleton.parents[children], skeleton.tip_joints])
    positions = pose[:, :3, 3]
    tips = np.einsum("tij,tj->ti", pose[skeleton.tip_joints, :3, :3], skeleton.tip_offsets)
    ends = np.concatenate([positions[children], positions[skeleton.tip_joints] + tips])
    starts = positions[joints]
    has_length = np.linalg.norm(ends - starts, axis=1) > 1e-9 * max(skeleton.height, 1e-300)
    return joints[has_length], starts[has_length], ends[has_length]

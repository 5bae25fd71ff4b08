"""Forward kinematics: poses of all joints from their rotations."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.geometry.motion import Motion, Skeleton


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

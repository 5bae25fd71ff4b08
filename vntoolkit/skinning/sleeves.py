"""Turning the figure's arms into the garment's sleeves, since files rest with arms out, aslant or down."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, Points, Vector3
from vntoolkit.geometry.skeleton import Skeleton
from vntoolkit.skinning.anatomy import Anatomy, shoulders_of

_CUFF_SHARE = 0.02  # of the vertices on one side: the outermost ones are its cuff
_LEAST_REACH = 0.4  # of the arm: a garment that ends nearer to the shoulder has no sleeve to aim at


def arms_aimed_at_sleeves(
    vertices: Points, skeleton: Skeleton, pose: FloatArray, anatomy: Anatomy
) -> dict[int, FloatArray]:
    """Return joint → (3, 3): the turn, in the axes of the figure, that aims an arm at its cuff.

    vertices: (n, 3) of the garment, already on the figure in `pose` (j, 4, 4). A cuff is the middle of the
    outermost vertices on the arm's side of the trunk. Arms without a sleeve, or without length, stay.
    """
    turns = {}
    middle = float(pose[list(anatomy.trunk), 0, 3].mean())
    for arm, shoulder in zip(anatomy.arms, shoulders_of(skeleton, anatomy), strict=True):
        start = pose[shoulder, :3, 3]
        end = _hand(skeleton, pose, arm)
        reach = np.linalg.norm(end - start)
        side = np.sign(end[0] - middle)
        outward = side * (vertices[:, 0] - middle)
        if side == 0 or reach == 0 or not (outward > 0).any():
            continue
        threshold = np.quantile(outward[outward > 0], 1 - _CUFF_SHARE)
        cuff = vertices[outward >= threshold].mean(axis=0)
        if side * (cuff - start)[0] > 0 and np.linalg.norm(cuff - start) > _LEAST_REACH * reach:
            turns[shoulder] = _rotation_between(end - start, cuff - start)
    return turns


def _hand(skeleton: Skeleton, pose: FloatArray, arm: tuple[int, ...]) -> Vector3:
    tips = np.flatnonzero(skeleton.tip_joints == arm[-1])
    offset = skeleton.tip_offsets[tips[0]] if len(tips) else np.zeros(3)
    return pose[arm[-1], :3, :3] @ offset + pose[arm[-1], :3, 3]


def _rotation_between(start: Vector3, end: Vector3) -> FloatArray:
    """Return the smallest rotation (3, 3) from one direction to another."""
    a, b = start / np.linalg.norm(start), end / np.linalg.norm(end)
    axis = np.cross(a, b)
    sine = float(np.linalg.norm(axis))
    if sine < 1e-12:
        return np.eye(3)
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, float(a @ b))).as_matrix()

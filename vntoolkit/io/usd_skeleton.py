"""A moving skeleton as UsdSkel: what Blender imports as an armature and Houdini as a rig."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.geometry.motion import Motion
from vntoolkit.geometry.skeleton import Skeleton, joint_paths, rest_pose
from vntoolkit.io.motion_axes import motion_with_axes_turned
from vntoolkit.io.usd_stage import vec3f_from_camera


def add_skeleton(stage: Any, path: str, motion: Motion) -> None:
    """Define a SkelRoot at `path` with the skeleton, its rest pose and one time sample a frame."""
    from pxr import UsdSkel, Vt

    turned = motion_with_axes_turned(motion)
    named = replace(turned.skeleton, names=tuple(map(_usd_name, turned.skeleton.names)))
    paths = Vt.TokenArray(joint_paths(named))
    root = UsdSkel.Root.Define(stage, path)
    skeleton = UsdSkel.Skeleton.Define(stage, f"{path}/Skeleton")
    skeleton.CreateJointsAttr(paths)
    skeleton.CreateBindTransformsAttr(_matrices(rest_pose(turned.skeleton)))
    skeleton.CreateRestTransformsAttr(_matrices(_local_rest(turned.skeleton)))
    _author_extents(root, skeleton, turned)
    animation = UsdSkel.Animation.Define(stage, f"{path}/Skeleton/Motion")
    animation.CreateJointsAttr(paths)
    animation.CreateScalesAttr(Vt.Vec3hArray.FromNumpy(np.ones((len(paths), 3), dtype=np.float16)))
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    # Quatf.FromNumpy takes (x, y, z, w), the order in memory of USD's quaternions.
    quaternions = np.ascontiguousarray(turned.rotations, dtype=np.float32)
    for frame, root_position in enumerate(motion.root_positions):
        offsets = np.array(motion.skeleton.offsets)
        offsets[0] = root_position
        translations.Set(vec3f_from_camera(offsets), float(frame))
        rotations.Set(Vt.QuatfArray.FromNumpy(quaternions[frame]), float(frame))


def _author_extents(root: Any, skeleton: Any, turned: Motion) -> None:
    """Give both boxes that hold the figure in every frame: no joint is farther than the skeleton's reach."""
    from pxr import Vt

    reach = float(np.abs(turned.skeleton.offsets[1:]).sum() + np.abs(turned.skeleton.tip_offsets).sum())
    low, high = turned.root_positions.min(axis=0) - reach, turned.root_positions.max(axis=0) + reach
    box = Vt.Vec3fArray.FromNumpy(np.stack([low, high]).astype(np.float32))
    root.CreateExtentAttr(box)
    skeleton.CreateExtentAttr(box)


def _usd_name(name: str) -> str:
    """Turn a joint's name into one that USD accepts: a slash in it would make a joint of each half."""
    plain = re.sub(r"[^A-Za-z0-9_]", lambda m: f"_{ord(m.group()):x}_", name)
    return plain if not plain[0].isdigit() else f"_{plain}"


def _local_rest(skeleton: Skeleton) -> FloatArray:
    matrices = np.tile(np.eye(4), (len(skeleton.names), 1, 1))
    matrices[:, :3, 3] = skeleton.offsets
    return matrices


def _matrices(target_from_source: FloatArray) -> Any:
    """Return a USD array; USD multiplies row vectors, so every matrix is transposed."""
    from pxr import Vt

    return Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(target_from_source.transpose(0, 2, 1)))

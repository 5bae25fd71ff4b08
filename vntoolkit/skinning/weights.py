"""Skinning weights: options, and the published weights by inverse distance to the nearest bones."""

from collections.abc import Collection
from dataclasses import dataclass
from fnmatch import fnmatch

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points, Vector3, read_only
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.motion import Skeleton, bone_segments
from vntoolkit.options.dressing import Falloff, WeightOptions

_NEAREST = 1e-6  # of the skeleton's height: nearer counts as this near, so that 1/distance stays finite


@dataclass(frozen=True, kw_only=True, eq=False)
class SkinWeights:
    """w_ik of equation 8, sparse: each vertex's joints (n, k) int32 and weights (n, k), rows sum to 1."""

    joints: IntArray
    weights: FloatArray

    def __post_init__(self) -> None:
        require_shape(self.joints, self.weights.shape, "skin joints")
        sums = self.weights.sum(axis=1)
        if self.weights.size and not (self.weights.min() >= 0 and np.abs(sums - 1).max() < 1e-9):
            raise BadInput("skin weights: expected rows without negative values that sum to 1")
        object.__setattr__(self, "joints", read_only(self.joints))
        object.__setattr__(self, "weights", read_only(self.weights))


def weights_from_distances(
    vertices: Points, skeleton: Skeleton, pose: FloatArray, options: WeightOptions
) -> SkinWeights:
    """Weigh vertices (n, 3) by their distance to the bones of a skeleton in the pose (j, 4, 4).

    A joint is as far as the nearest of the bones it turns. Section VII-C of brostow2011.
    """
    if options.falloff is Falloff.HEAT:
        raise BadInput("skin weights: heat spreads along a garment's triangles: use `weights_of_garment`")
    bones = attracting_bones(skeleton, pose, options.exclude)
    count = min(options.bones, len(np.unique(bones[0])))
    floor = _NEAREST * max(skeleton.height, float(np.linalg.norm(np.ptp(bones[1], axis=0))))
    nearest, distances = nearest_joints(vertices, *bones, count=count)
    raw = 1.0 / np.maximum(distances, floor)
    return SkinWeights(joints=nearest, weights=raw / raw.sum(axis=1, keepdims=True))


def attracting_bones(
    skeleton: Skeleton, pose: FloatArray, exclude: tuple[str, ...], among: Collection[int] | None = None
) -> tuple[IntArray, Points, Points]:
    """Return `bone_segments` less those of excluded joints, the bones of one joint side by side.

    among: only the bones of these joints.
    """
    joints, starts, ends = bone_segments(skeleton, pose)
    allowed = attracting_joints(skeleton, exclude)
    kept = np.isin(joints, allowed if among is None else [joint for joint in among if joint in allowed])
    if not kept.any():
        raise BadInput("skin weights: no bone is left: the skeleton is a point, or `exclude` names them all")
    order = np.flatnonzero(kept)[np.argsort(joints[kept], kind="stable")]
    return joints[order], starts[order], ends[order]


def attracting_joints(skeleton: Skeleton, exclude: tuple[str, ...]) -> list[int]:
    """Return the joints that no pattern excludes."""
    return [
        joint
        for joint, name in enumerate(skeleton.names)
        if not any(fnmatch(name, pattern) for pattern in exclude)
    ]


def nearest_joints(
    vertices: Points, joints: IntArray, starts: Points, ends: Points, *, count: int
) -> tuple[IntArray, FloatArray]:
    """Return the `count` joints nearest to each vertex (n, count), nearest first, and their distances."""
    gaps = np.stack([_gaps(vertices, *bone) for bone in zip(starts, ends, strict=True)])
    used, first = np.unique(joints, return_index=True)  # the bones of a joint are side by side
    gaps = np.minimum.reduceat(gaps, first).T
    order = np.argsort(gaps, axis=1, kind="stable")[:, :count]
    return used[order].astype(np.int32), np.take_along_axis(gaps, order, axis=1)


def _gaps(vertices: Points, start: Vector3, end: Vector3) -> FloatArray:
    """Return (n,) the distance from each vertex to a bone."""
    bone = end - start
    along = np.clip((vertices - start) @ bone / (bone @ bone), 0.0, 1.0)
    return np.linalg.norm(vertices - start - along[:, None] * bone, axis=1)

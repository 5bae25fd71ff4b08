"""Skinning weights: options, and the published weights by inverse distance to the nearest bones."""

from collections.abc import Collection
from dataclasses import dataclass
from fnmatch import fnmatch

import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points, read_only
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.motion import Skeleton, bone_segments
from vntoolkit.native import njit
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
    continuous = options.falloff is Falloff.CONTINUOUS
    count = min(options.bones + continuous, len(np.unique(bones[0])))
    floor = _NEAREST * max(skeleton.height, float(np.linalg.norm(np.ptp(bones[1], axis=0))))
    nearest, distances = nearest_joints(vertices, *bones, count=count)
    # The nearest bone gets 1 before normalising, so no power can overflow.
    distances = np.maximum(distances, floor)
    raw = (distances[:, :1] / distances) ** options.distance_power
    if continuous and count > options.bones:
        nearest, raw = nearest[:, :-1], raw[:, :-1] - raw[:, -1:]
        raw[raw.sum(axis=1) <= 0] = 1.0  # all equally far: they share
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
    return _nearest_joints(np.ascontiguousarray(vertices, dtype=np.float64), joints, starts, ends, count)


@njit(cache=True)
def _nearest_joints(vertices, joints, starts, ends, count):  # type: ignore[no-untyped-def]
    """Insert each joint's distance into a vertex's sorted list of `count`; bones of a joint are adjacent."""
    n = len(vertices)
    nearest = np.zeros((n, count), np.int32)
    distances = np.full((n, count), np.inf)
    for v in range(n):
        b = 0
        while b < len(joints):
            joint, best = joints[b], np.inf
            while b < len(joints) and joints[b] == joint:
                along = 0.0
                squared = 0.0
                for axis in range(3):
                    along += (vertices[v, axis] - starts[b, axis]) * (ends[b, axis] - starts[b, axis])
                    squared += (ends[b, axis] - starts[b, axis]) ** 2
                t = min(max(along / squared, 0.0), 1.0)
                gap = 0.0
                for axis in range(3):
                    foot = starts[b, axis] + t * (ends[b, axis] - starts[b, axis])
                    gap += (vertices[v, axis] - foot) ** 2
                best = min(best, np.sqrt(gap))
                b += 1
            if best < distances[v, count - 1]:
                slot = count - 1
                while slot > 0 and distances[v, slot - 1] > best:
                    distances[v, slot] = distances[v, slot - 1]
                    nearest[v, slot] = nearest[v, slot - 1]
                    slot -= 1
                distances[v, slot] = best
                nearest[v, slot] = joint
    return nearest, distances

"""How much each vertex follows each bone: inverse distance to the nearest ones."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from fnmatch import fnmatch

import numba
import numpy as np

from vntoolkit.arrays import FloatArray, IntArray, Points, read_only
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.skeleton import Skeleton
from vntoolkit.skinning.kinematics import bone_segments

_NEAREST = 1e-6  # of the skeleton's height: nearer counts as this near, so that 1/distance stays finite


class Falloff(Enum):
    """How a vertex weighs its nearest bones.

    INVERSE: by 1/distance, as published; the cloth tears a little where the set of nearest bones changes.
    CONTINUOUS: by 1/distance less that of the next bone farther off, franke1980, so that a bone's weight is
    0 where it drops out and the cloth stays whole.
    """

    INVERSE = "inverse"
    CONTINUOUS = "continuous"


@dataclass(frozen=True, kw_only=True)
class WeightOptions:
    """How vertices are attached.

    neighbours: number of nearest bones a vertex follows. falloff: how a vertex weighs its nearest bones:
    inverse as published, continuous without tears. distance_power: weights fall with distance to this
    power; 1 is the published rule, higher ones let limbs go their own way. exclude: joints whose bones
    attract nothing, as names or patterns (`*Hand*`).
    """

    neighbours: int = 4
    falloff: Falloff = Falloff.INVERSE
    distance_power: float = 1.0
    exclude: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.neighbours < 1:
            raise BadInput(f"neighbours: expected at least 1, got {self.neighbours}")
        if not 0 < self.distance_power < np.inf:
            raise BadInput(f"distance power: expected a positive number, got {self.distance_power:g}")


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
    joints, starts, ends = bone_segments(skeleton, pose)
    kept = np.array(
        [not any(fnmatch(skeleton.names[j], pattern) for pattern in options.exclude) for j in joints], bool
    )
    if not kept.any():
        raise BadInput("skin weights: no bone is left: the skeleton is a point, or `exclude` names them all")
    order = np.argsort(joints[kept], kind="stable")
    joints, starts, ends = joints[kept][order], starts[kept][order], ends[kept][order]
    continuous = options.falloff is Falloff.CONTINUOUS
    count = min(options.neighbours + continuous, len(np.unique(joints)))
    floor = _NEAREST * max(skeleton.height, float(np.linalg.norm(np.ptp(starts, axis=0))))
    nearest, distances = _nearest_joints(
        np.ascontiguousarray(vertices, dtype=np.float64), joints, starts, ends, count
    )
    # The nearest bone gets 1 before normalising, so no power can overflow.
    distances = np.maximum(distances, floor)
    raw = (distances[:, :1] / distances) ** options.distance_power
    if continuous and count > options.neighbours:
        nearest, raw = nearest[:, :-1], raw[:, :-1] - raw[:, -1:]
        raw[raw.sum(axis=1) <= 0] = 1.0  # all equally far: they share
    return SkinWeights(joints=nearest, weights=raw / raw.sum(axis=1, keepdims=True))


@numba.njit(cache=True)
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

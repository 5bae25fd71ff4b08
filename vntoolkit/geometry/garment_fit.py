"""Corrections by hand to the automatic fit of a garment to a skeleton."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from vntoolkit.arrays import FloatArray, Points, Vector3, read_only
from vntoolkit.checks import require_finite, require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.rigid import RigidTransform, Similarity

_NO_TRIANGLE = "landmarks: the points lie on a line; choose three that span a triangle"


@dataclass(frozen=True, kw_only=True, eq=False)
class Landmark:
    """A vertex of the garment that belongs at a joint. offset: (3,) metres from the joint, camera axes."""

    vertex: int
    joint: str
    offset: Vector3 = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, kw_only=True, eq=False)
class GarmentFit:
    """Corrections to the automatic fit.

    scale, adjustment: applied after it, about the garment's centre; metres, camera axes. landmarks: three
    or more replace the automatic fit. pose: joint → (4,) quaternion, turns of the joints in the pose of
    attachment. bind_frame: the frame of the motion whose pose is the pose of attachment (None: the rest
    pose); the figure stands upright and unturned in it.
    """

    scale: float = 1.0
    adjustment: RigidTransform = field(default_factory=RigidTransform)
    landmarks: tuple[Landmark, ...] = ()
    pose: Mapping[str, FloatArray] = field(default_factory=dict)
    bind_frame: int | None = None

    def __post_init__(self) -> None:
        if not 0 < self.scale < np.inf:
            raise BadInput(f"fit: expected a positive scale, got {self.scale}")
        if len(self.landmarks) in (1, 2):
            raise BadInput(f"fit: expected no or at least three landmarks, got {len(self.landmarks)}")


def fit_similarity(source: Points, target: Points) -> Similarity:
    """Fit the least-squares similarity that takes points (n, 3) to points (n, 3), umeyama1991.

    Raises `BadInput` where the points lie on a line, which leaves a turn open.
    """
    source, target = np.asarray(source, np.float64), np.asarray(target, np.float64)
    require_shape(source, (None, 3), "source points")
    require_shape(target, source.shape, "target points")
    require_finite(source, "source points")
    require_finite(target, "target points")
    if len(source) < 3:
        raise BadInput(_NO_TRIANGLE)
    centre_s, centre_t = source.mean(axis=0), target.mean(axis=0)
    covariance = (target - centre_t).T @ (source - centre_s) / len(source)
    u, singular, vt = np.linalg.svd(covariance)
    if not singular[1] > 1e-9 * max(singular[0], 1e-300):
        raise BadInput(_NO_TRIANGLE)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * signs) @ vt
    scale = float((singular * signs).sum() / np.mean(np.sum((source - centre_s) ** 2, axis=1)))
    translation = centre_t - scale * rotation @ centre_s
    return Similarity(
        scale=scale, rigid=RigidTransform(rotation=read_only(rotation), translation=translation)
    )

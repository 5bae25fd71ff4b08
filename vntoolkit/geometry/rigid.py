"""Rigid transforms and similarities, named `target_from_source`."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import ArrayLike, FloatArray, Matrix3, Vector3
from vntoolkit.checks import set_arrays
from vntoolkit.errors import BadInput

_ORTHONORMALITY_TOLERANCE = 1e-6


@dataclass(frozen=True, kw_only=True, eq=False)
class RigidTransform:
    """x_in_target = rotation @ x_in_source + translation.

    rotation: (3, 3), orthonormal with determinant +1. translation: (3,), length unit of the points.
    """

    rotation: Matrix3 = field(default_factory=lambda: np.eye(3))
    translation: Vector3 = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        set_arrays(self, {"rotation": (3, 3), "translation": (3,)}, dtype=np.float64)
        error = np.abs(self.rotation @ self.rotation.T - np.eye(3)).max()
        if not (error < _ORTHONORMALITY_TOLERANCE and np.linalg.det(self.rotation) > 0):
            raise BadInput("rotation: expected an orthonormal matrix with determinant +1")

    @classmethod
    def from_rotation_vector(
        cls, rotation_vector: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)
    ) -> RigidTransform:
        """Build from an axis times angle (radians) and a translation, both (3,)."""
        rotation = Rotation.from_rotvec(np.asarray(rotation_vector, dtype=np.float64)).as_matrix()
        return cls(rotation=rotation, translation=np.asarray(translation, dtype=np.float64))

    @classmethod
    def from_matrix(cls, matrix: FloatArray) -> RigidTransform:
        """Build from a (4, 4) homogeneous or (3, 4) matrix."""
        matrix = np.asarray(matrix, dtype=np.float64)
        return cls(rotation=matrix[:3, :3], translation=matrix[:3, 3:].ravel())

    @property
    def matrix(self) -> FloatArray:
        """The (4, 4) homogeneous matrix."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation
        return matrix

    @property
    def rotation_vector(self) -> Vector3:
        """Axis times angle in radians, (3,)."""
        return Rotation.from_matrix(self.rotation).as_rotvec()

    def apply(self, points: FloatArray) -> FloatArray:
        """Move points (..., 3)."""
        return np.asarray(points) @ self.rotation.T + self.translation

    def rotate(self, vectors: FloatArray) -> FloatArray:
        """Turn directions (..., 3): rotation without translation."""
        return np.asarray(vectors) @ self.rotation.T

    def inverse(self) -> RigidTransform:
        """Return source_from_target."""
        return RigidTransform(rotation=self.rotation.T, translation=-self.rotation.T @ self.translation)

    def __matmul__(self, other: RigidTransform) -> RigidTransform:
        """Compose: (c_from_b @ b_from_a) is c_from_a."""
        return RigidTransform(
            rotation=self.rotation @ other.rotation,
            translation=self.rotation @ other.translation + self.translation,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Similarity:
    """x_in_target = rotation @ (scale · x_in_source) + translation."""

    scale: float
    rigid: RigidTransform

    def apply(self, points: FloatArray) -> FloatArray:
        """Move points (..., 3)."""
        return self.rigid.apply(self.scale * np.asarray(points, dtype=np.float64))

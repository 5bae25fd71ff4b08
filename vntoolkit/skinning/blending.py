"""A surface moved with the joints of a skeleton: Equation 8 of brostow2011, and dual quaternions.

Dual quaternion skinning does not collapse at twisted joints.
"""

import numba
import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.checks import require_shape
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.native import njit
from vntoolkit.options.dressing import Blend
from vntoolkit.skinning.weights import SkinWeights


def skinned_vertices(
    vertices: Points,
    weights: SkinWeights,
    posed_from_model: FloatArray,
    rest_from_model: FloatArray,
    blend: Blend = Blend.LINEAR,
) -> Points:
    """Equation 8: v' = Σ_i w_i S_i R_i⁻¹ v, captured vertices (n, 3) moved with the skeleton.

    Returns (n, 3) float64. Blend.DUAL_QUATERNION mixes the motions S_i R_i⁻¹ as rigid ones instead.
    posed_from_model S and rest_from_model R: (j, 4, 4) rigid, the pose now and the pose of attachment.
    """
    require_shape(vertices, (len(weights.weights), 3), "vertices to skin")
    posed_from_rest = posed_from_model @ _rigid_inverses(rest_from_model)
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    if blend is Blend.LINEAR:
        return _linear(points, weights.joints, weights.weights, np.ascontiguousarray(posed_from_rest[:, :3]))
    return _dual(points, weights.joints, weights.weights, dual_quaternions(posed_from_rest))


def blended_vertices(vertices: Points, weights: SkinWeights, transforms: FloatArray) -> Points:
    """Return (n, 3): each vertex moved by the weighted mean of its bones' transforms, (j, 4, 4) affine."""
    require_shape(vertices, (len(weights.weights), 3), "vertices to skin")
    points = np.ascontiguousarray(vertices, dtype=np.float64)
    return _linear(points, weights.joints, weights.weights, np.ascontiguousarray(transforms[:, :3]))


def _rigid_inverses(matrices: FloatArray) -> FloatArray:
    return np.stack([RigidTransform.from_matrix(matrix).inverse().matrix for matrix in matrices])


def dual_quaternions(transforms: FloatArray) -> FloatArray:
    """Return (j, 8) unit dual quaternions (x, y, z, w of the real, then of the dual part), kavan2007."""
    real = Rotation.from_matrix(transforms[:, :3, :3]).as_quat()
    t, axis, w = transforms[:, :3, 3], real[:, :3], real[:, 3:]
    dual_axis = 0.5 * (w * t + np.cross(t, axis))
    dual_w = -0.5 * np.sum(t * axis, axis=1, keepdims=True)
    return np.concatenate([real, dual_axis, dual_w], axis=1)


@njit(cache=True, parallel=True)
def _linear(vertices, joints, weights, transforms):  # type: ignore[no-untyped-def]
    skinned = np.empty_like(vertices)
    for v in numba.prange(len(vertices)):
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        for row in range(3):
            total = 0.0
            for k in range(joints.shape[1]):
                m = transforms[joints[v, k], row]
                total += weights[v, k] * (m[0] * x + m[1] * y + m[2] * z + m[3])
            skinned[v, row] = total
    return skinned


@njit(cache=True, parallel=True)
def _dual(vertices, joints, weights, quaternions):  # type: ignore[no-untyped-def]
    skinned = np.empty_like(vertices)
    for v in numba.prange(len(vertices)):
        q = np.zeros(8)
        first = quaternions[joints[v, 0]]  # the heaviest: the others are turned to its hemisphere
        for k in range(joints.shape[1]):
            other = quaternions[joints[v, k]]
            side = first[0] * other[0] + first[1] * other[1] + first[2] * other[2] + first[3] * other[3]
            weight = weights[v, k] if side >= 0.0 else -weights[v, k]
            for c in range(8):
                q[c] += weight * other[c]
        length = np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2 + q[3] ** 2)
        for c in range(8):
            q[c] /= length
        a, b, c, w = q[0], q[1], q[2], q[3]
        x, y, z = vertices[v, 0], vertices[v, 1], vertices[v, 2]
        # rotation: v + 2 r × (r × v + w v)
        ix, iy, iz = b * z - c * y + w * x, c * x - a * z + w * y, a * y - b * x + w * z
        # translation: 2 (w d − d_w r + r × d)
        tx = 2.0 * (w * q[4] - q[7] * a + b * q[6] - c * q[5])
        ty = 2.0 * (w * q[5] - q[7] * b + c * q[4] - a * q[6])
        tz = 2.0 * (w * q[6] - q[7] * c + a * q[5] - b * q[4])
        skinned[v, 0] = x + 2.0 * (b * iz - c * iy) + tx
        skinned[v, 1] = y + 2.0 * (c * ix - a * iz) + ty
        skinned[v, 2] = z + 2.0 * (a * iy - b * ix) + tz
    return skinned

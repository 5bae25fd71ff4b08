"""A surface moved with the joints of a skeleton: Equation 8 of brostow2011, and dual quaternions.

Dual quaternion skinning does not collapse at twisted joints.
"""

import numpy as np
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.checks import require_shape
from vntoolkit.geometry.rigid import RigidTransform
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
    posed_from_rest = posed_from_model @ _rigid_inverses(rest_from_model)
    if blend is Blend.LINEAR:
        return blended_vertices(vertices, weights, posed_from_rest)
    return _dual(vertices, weights, dual_quaternions(posed_from_rest))


def blended_vertices(vertices: Points, weights: SkinWeights, transforms: FloatArray) -> Points:
    """Return (n, 3): each vertex moved by the weighted mean of its bones' transforms, (j, 4, 4) affine."""
    require_shape(vertices, (len(weights.weights), 3), "vertices to skin")
    mean = _means(weights.joints, weights.weights, transforms[:, :3].reshape(-1, 12)).reshape(-1, 3, 4)
    return np.asarray(np.einsum("nij,nj->ni", mean[:, :, :3], vertices) + mean[:, :, 3], np.float64)


def _rigid_inverses(matrices: FloatArray) -> FloatArray:
    return np.stack([RigidTransform.from_matrix(matrix).inverse().matrix for matrix in matrices])


def dual_quaternions(transforms: FloatArray) -> FloatArray:
    """Return (j, 8) unit dual quaternions (x, y, z, w of the real, then of the dual part), kavan2007."""
    real = Rotation.from_matrix(transforms[:, :3, :3]).as_quat()
    t, axis, w = transforms[:, :3, 3], real[:, :3], real[:, 3:]
    dual_axis = 0.5 * (w * t + np.cross(t, axis))
    dual_w = -0.5 * np.sum(t * axis, axis=1, keepdims=True)
    return np.concatenate([real, dual_axis, dual_w], axis=1)


def _dual(vertices: Points, weights: SkinWeights, quaternions: FloatArray) -> Points:
    require_shape(vertices, (len(weights.weights), 3), "vertices to skin")
    joints = weights.joints
    alike = np.einsum("ni,nki->nk", quaternions[joints[:, 0], :4], quaternions[joints][:, :, :4])
    # the first joint is the heaviest: the others are turned to its hemisphere
    mean = _means(joints, np.where(alike >= 0, weights.weights, -weights.weights), quaternions)
    mean /= np.linalg.norm(mean[:, :4], axis=1, keepdims=True)
    r, w, d, d_w = mean[:, :3], mean[:, 3:4], mean[:, 4:7], mean[:, 7:]
    turned = vertices + 2.0 * np.cross(r, np.cross(r, vertices) + w * vertices)
    return np.asarray(turned + 2.0 * (w * d - d_w * r + np.cross(r, d)), np.float64)


def _means(joints: IntArray, weights: FloatArray, values: FloatArray) -> FloatArray:
    """(n, k) sums of the joints' values (j, k), by joints and weights (n, m) of each vertex."""
    n, m = joints.shape
    rows = sp.csr_array((weights.ravel(), joints.ravel(), m * np.arange(n + 1)), shape=(n, len(values)))
    return np.asarray(rows @ values)

"""How much each vertex follows each bone: by heat that spreads along the cloth, not through the air."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.geometry.laplacian import edge_cotangents, graph_laplacian
from vntoolkit.geometry.mesh import Mesh, face_normals, vertex_normals
from vntoolkit.geometry.skeleton import Skeleton
from vntoolkit.skinning.inside import covered_bones
from vntoolkit.skinning.weights import SkinWeights, WeightOptions, attracting_bones, nearest_joints

_HOLD = 2.0  # heat that a vertex takes from its bone: 1 blends wider, 4 stretches arms raised high
_LEAST_COTANGENT, _MOST_COTANGENT = 0.01, 100.0  # a negative one could make a weight negative
_GUESSED = 1e-3  # how a vertex that covers no bone holds the nearest, beside one that covers its own
_NEAREST = 1e-2  # of the skeleton's height: nearer counts as this near


def weights_from_heat(
    garment: Mesh, skeleton: Skeleton, pose: FloatArray, options: WeightOptions
) -> SkinWeights:
    """Weigh the garment's vertices by bone heat: −Δw + H w = H p, baran2007.

    garment: on the skeleton in the pose (j, 4, 4). p is 1 where a vertex covers the bone, H is 2 / d² of
    its distance. The bone is the one on the inner side of the cloth, which a sheet seen from the front has
    too; a test of visibility would need a closed garment. Few bones are kept as in `Falloff.CONTINUOUS`.
    """
    joints, distances, hold = _own_bones(garment, skeleton, pose, options)
    used, column = np.unique(joints, return_inverse=True)
    area = np.linalg.norm(face_normals(garment.vertices, garment.faces), axis=1) / 6
    shares = np.bincount(garment.faces.ravel(), np.repeat(area, 3), len(joints))
    least = 1e-9 * (shares.mean() or 1.0)  # of a vertex without area: it keeps to its bone
    heat = _HOLD * hold * np.maximum(shares, least) / distances**2
    matrix = sp.csc_array(_laplacian(garment) + sp.diags_array(heat))
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    sources = np.zeros((len(joints), len(used)))
    sources[np.arange(len(joints)), column] = heat
    return _heaviest(used, np.maximum(factor.solve(sources), 0.0), options.bones)


def _own_bones(
    garment: Mesh, skeleton: Skeleton, pose: FloatArray, options: WeightOptions
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return for every vertex its joint, the distance to it, and how sure that is, (n,) each."""
    bones = attracting_bones(skeleton, pose, options.exclude)
    normals = vertex_normals(garment.vertices, garment.faces)
    joints, distances = covered_bones(garment.vertices, normals, *bones)
    lost = joints < 0
    if lost.any():
        guessed, gaps = nearest_joints(garment.vertices[lost], *bones, count=1)
        joints[lost], distances[lost] = guessed[:, 0], gaps[:, 0]
    floor = _NEAREST * max(skeleton.height, float(np.linalg.norm(np.ptp(bones[1], axis=0))))
    return joints, np.maximum(distances, floor), np.where(lost, _GUESSED, 1.0)


def _laplacian(garment: Mesh) -> sp.csr_array:
    pairs, cosines, sines = edge_cotangents(garment.vertices, garment.faces)
    cotangents = cosines / np.maximum(sines, 1e-300)
    weights = 0.5 * np.clip(np.nan_to_num(cotangents), _LEAST_COTANGENT, _MOST_COTANGENT)
    return graph_laplacian(pairs, len(garment.vertices), weights)


def _heaviest(joints: IntArray, weights: FloatArray, count: int) -> SkinWeights:
    """Keep the `count` heaviest bones, less the weight of the next, so that none drops out with a jump."""
    order = np.argsort(-weights, axis=1, kind="stable")[:, : count + 1]
    kept: Points = np.take_along_axis(weights, order, axis=1)
    if order.shape[1] > count:
        order, kept = order[:, :-1], kept[:, :-1] - kept[:, -1:]
        kept[kept.sum(axis=1) <= 0] = 1.0
    return SkinWeights(joints=joints[order].astype(np.int32), weights=kept / kept.sum(axis=1, keepdims=True))

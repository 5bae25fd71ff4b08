"""Attaching a garment to a skeleton, and cutting the web where sleeve and trunk were captured as one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces, FloatArray
from vntoolkit.geometry.laplacian import edges_from_faces
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.skeleton import Skeleton
from vntoolkit.skinning.blending import skinned_vertices
from vntoolkit.skinning.heat import weights_from_heat
from vntoolkit.skinning.weights import Falloff, SkinWeights, WeightOptions, weights_from_distances

_ROUNDS = 4  # a cut lets both sides go their own way, which may show more web beside it


def weights_of_garment(
    garment: Mesh, skeleton: Skeleton, pose: FloatArray, options: WeightOptions
) -> SkinWeights:
    """Weigh a garment, on the skeleton in the pose (j, 4, 4), by the rule that the options name."""
    if options.falloff is Falloff.HEAT:
        return weights_from_heat(garment, skeleton, pose, options)
    return weights_from_distances(garment.vertices, skeleton, pose, options)


def weights_without_web(
    garment: Mesh,
    skeleton: Skeleton,
    pose: FloatArray,
    options: WeightOptions,
    *,
    poses: FloatArray,
    max_stretch: float,
) -> tuple[SkinWeights, Faces]:
    """Weigh a garment, cut where the poses (f, j, 4, 4) overstretch it, and weigh again; return what is left.

    A triangle is web where two parts of the garment meet, each mostly one bone's, and a pose stretches an
    edge of it beyond `max_stretch`: cloth never bears that, so the capture joined what only touched. Weights
    by distance know no triangles: they would stay, web and all, so nothing is cut for them, nor at 0.
    """
    weights, faces = weights_of_garment(garment, skeleton, pose, options), garment.faces
    if options.falloff is not Falloff.HEAT or not max_stretch:
        return weights, faces
    for _ in range(_ROUNDS):
        web = _web(Mesh(vertices=garment.vertices, faces=faces), weights, pose, poses, max_stretch)
        if not web.any():
            break
        faces = faces[~web]
        left = Mesh(vertices=garment.vertices, faces=faces)
        weights = weights_of_garment(left, skeleton, pose, options)
    return weights, faces


def _web(
    garment: Mesh, weights: SkinWeights, pose: FloatArray, poses: FloatArray, max_stretch: float
) -> npt.NDArray[np.bool_]:
    """Return (m,): which triangles bridge two bones' parts and are stretched too far in any pose."""
    heaviest = weights.joints[np.arange(len(weights.joints)), weights.weights.argmax(axis=1)]
    of_corner = heaviest[garment.faces]
    web = np.zeros(len(garment.faces), dtype=bool)
    bridges = np.flatnonzero(np.ptp(of_corner, axis=1) > 0)
    if not len(bridges):
        return web
    involved, local = np.unique(garment.faces[bridges], return_inverse=True)
    faces = local.reshape(-1, 3).astype(np.int32)
    edges = edges_from_faces(faces)
    rest = np.asarray(garment.vertices, dtype=np.float64)[involved]
    own = SkinWeights(joints=weights.joints[involved], weights=weights.weights[involved])
    limit = max_stretch * _lengths(rest, edges)
    torn = np.zeros(len(edges), dtype=bool)
    for now in poses:
        torn |= _lengths(skinned_vertices(rest, own, now, pose), edges) > limit
    web[bridges] = _has_torn_edge(faces, edges[torn], len(involved))
    return web


def _lengths(vertices: FloatArray, edges: Faces) -> FloatArray:
    return np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)


def _has_torn_edge(faces: Faces, torn: Faces, count: int) -> npt.NDArray[np.bool_]:
    codes = np.sort(torn.astype(np.int64), axis=1) @ [count, 1]
    sides = np.stack([np.sort(faces[:, pair], axis=1) for pair in ([0, 1], [1, 2], [2, 0])]).astype(np.int64)
    return np.asarray(np.isin(sides @ [count, 1], codes).any(axis=0))

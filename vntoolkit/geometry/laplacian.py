"""Laplacians and edges of triangle meshes."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.errors import BadMesh

_SMALLEST_SINE = 1e-9  # of a triangle's angle: below it the triangle has no area and its cotangent no value


def edges_from_faces(faces: Faces) -> npt.NDArray[np.int32]:
    """Return the (e, 2) undirected edges of the triangles, each once, lower index first, sorted."""
    corners = np.asarray(faces, dtype=np.int64)
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    pairs.sort(axis=1)
    width = int(pairs.max(initial=0)) + 1
    codes = np.unique(pairs[:, 0] * width + pairs[:, 1])
    return np.stack([codes // width, codes % width], axis=1).astype(np.int32)


def graph_laplacian(
    edges: npt.NDArray[np.integer], vertex_count: int, weights: FloatArray | None = None
) -> sp.csr_array:
    """Return the (n, n) symmetric Laplacian of weighted edges: (L x)_i = Σ_j w_ij (x_i − x_j).

    edges: (e, 2), each once. weights: (e,) or None for 1. Rows sum to 0. float64.
    """
    weight = np.ones(len(edges)) if weights is None else np.asarray(weights, dtype=np.float64)
    first, second = np.asarray(edges, dtype=np.int64).reshape(-1, 2).T
    degree = np.bincount(first, weight, vertex_count) + np.bincount(second, weight, vertex_count)
    diagonal = np.arange(vertex_count)
    rows = np.concatenate([first, second, diagonal])
    columns = np.concatenate([second, first, diagonal])
    values = np.concatenate([-weight, -weight, degree])
    return sp.csr_array((values, (rows, columns)), shape=(vertex_count, vertex_count))


def cotangent_laplacian(vertices: Points, faces: Faces) -> sp.csr_array:
    """Return the (n, n) cotangent Laplacian, w_ij = (cot a_ij + cot b_ij) / 2, symmetric.

    The stiffness matrix of linear elements, not divided by areas: it has no unit and keeps its value when
    the mesh is scaled. Zero in the interior of a plane, however it is triangulated. Raises BadMesh where a
    triangle has no area.
    """
    pairs, cosines, sines = edge_cotangents(vertices, faces)
    flat = sines <= _SMALLEST_SINE
    if flat.any():
        raise BadMesh(
            f"cotangent Laplacian: {int(flat.reshape(3, -1).any(axis=0).sum())} triangles have no area; use "
            "the uniform Laplacian"
        )
    return graph_laplacian(pairs, len(np.asarray(vertices)), 0.5 * cosines / sines)


def edge_cotangents(vertices: Points, faces: Faces) -> tuple[npt.NDArray[np.int64], FloatArray, FloatArray]:
    """Return every triangle's edges (3 m, 2), lower index first, and cosine and sine of the angles opposite.

    Cosines and sines, (3 m,), are those of the first, of the second, then of the third corners; both are 0
    where a side has no length.
    """
    points = np.asarray(vertices, dtype=np.float64)
    pairs, cosines, sines = [], [], []
    for apex, left, right in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        to_left = points[faces[:, left]] - points[faces[:, apex]]
        to_right = points[faces[:, right]] - points[faces[:, apex]]
        lengths = np.linalg.norm(to_left, axis=1) * np.linalg.norm(to_right, axis=1)
        per_length = np.divide(1.0, lengths, out=np.zeros_like(lengths), where=lengths > 0)
        pairs.append(np.sort(np.asarray(faces, dtype=np.int64)[:, [left, right]], axis=1))
        cosines.append(np.sum(to_left * to_right, axis=1) * per_length)
        sines.append(np.linalg.norm(np.cross(to_left, to_right), axis=1) * per_length)
    return np.concatenate(pairs), np.concatenate(cosines), np.concatenate(sines)

"""Loop subdivision (loop1987) as one sparse matrix, so that a frame is refined by one product."""

from __future__ import annotations

import numpy as np
from numba import njit
from scipy import sparse

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points


def loop_subdivision(faces: Faces, count: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix, Faces]:
    """Split every face in four.

    Returns S (n', n) with refined = S @ vertices, the plain mid-point matrix of the same shape (for texture
    coordinates), and the finer faces. Rims follow the cubic B-spline of their own points.
    """
    corners = faces.astype(np.int64)
    directed = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    opposite = np.concatenate([corners[:, 2], corners[:, 0], corners[:, 1]])
    edges, number, times = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    number = number.ravel()
    on_rim = times == 1
    midpoints = count + number.reshape(3, -1)
    a, b, c = corners.T
    ab, bc, ca = midpoints
    finer = np.concatenate(
        [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    ).astype(np.int32)
    smooth = sparse.vstack(
        [_old_points(edges, on_rim, count), _edge_points(edges, number, opposite, on_rim, count)]
    )
    rows = np.repeat(np.arange(len(edges)), 2)
    halves = sparse.csr_matrix(
        (np.full(2 * len(edges), 0.5), (rows, edges.ravel())), shape=(len(edges), count)
    )
    return smooth.tocsr(), sparse.vstack([sparse.eye(count), halves]).tocsr(), finer


def _old_points(edges: IntArray, on_rim: IntArray, count: int) -> sparse.csr_matrix:
    """Return (n, n) the weights of the moved old points."""
    rim = np.zeros(count, dtype=bool)
    rim[edges[on_rim]] = True
    ends = np.concatenate([edges, edges[:, ::-1]])
    along_rim = np.tile(on_rim, 2)
    degree = np.bincount(ends[:, 0], minlength=count)
    beta = np.where(degree == 3, 3.0 / 16.0, 3.0 / (8.0 * np.maximum(degree, 1)))
    weight = np.where(rim[ends[:, 0]], np.where(along_rim, 0.125, 0.0), beta[ends[:, 0]])
    matrix = sparse.csr_matrix((weight, (ends[:, 0], ends[:, 1])), shape=(count, count))
    matrix.eliminate_zeros()
    return matrix + sparse.diags(1.0 - np.asarray(matrix.sum(axis=1)).ravel())


def _edge_points(
    edges: IntArray, number: IntArray, opposite: IntArray, on_rim: IntArray, count: int
) -> sparse.csr_matrix:
    """Return (e, n) the weights of the new points on the edges."""
    row = np.arange(len(edges))
    near = np.where(on_rim, 0.5, 0.375)
    inner = ~on_rim[number]
    rows = np.concatenate([row, row, number[inner]])
    columns = np.concatenate([edges[:, 0], edges[:, 1], opposite[inner]])
    weights = np.concatenate([near, near, np.full(np.count_nonzero(inner), 0.125)])
    return sparse.csr_matrix((weights, (rows, columns)), shape=(len(edges), count))


@njit(cache=True)
def raise_along_normals(vertices: Points, faces: Faces, relief: FloatArray) -> None:
    """Move every vertex by its `relief` along its area-weighted normal, in place."""
    normals = np.zeros_like(vertices)
    for f in range(len(faces)):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        ax = vertices[j, 0] - vertices[i, 0]
        ay = vertices[j, 1] - vertices[i, 1]
        az = vertices[j, 2] - vertices[i, 2]
        bx = vertices[k, 0] - vertices[i, 0]
        by = vertices[k, 1] - vertices[i, 1]
        bz = vertices[k, 2] - vertices[i, 2]
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        for v in (i, j, k):
            normals[v, 0] += nx
            normals[v, 1] += ny
            normals[v, 2] += nz
    for v in range(len(vertices)):
        length = np.sqrt(normals[v, 0] ** 2 + normals[v, 1] ** 2 + normals[v, 2] ** 2)
        step = relief[v] / max(length, 1e-30)
        for c in range(3):
            vertices[v, c] += step * normals[v, c]

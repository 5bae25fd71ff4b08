"""Triangulated grids: faces and per-corner texture coordinates of surfaces with rows and columns."""

import numpy as np

from vntoolkit.arrays import Faces, FloatArray, IntArray


def grid_faces(indices: IntArray) -> Faces:
    """Return (m, 3) triangles of vertex indices (rows, columns), two a cell.

    Counter-clockwise seen from the side where columns run right and rows run down.
    """
    a, b = indices[:-1, :-1].ravel(), indices[:-1, 1:].ravel()
    c, d = indices[1:, :-1].ravel(), indices[1:, 1:].ravel()
    # Every other cell is cut along the other diagonal, so that no direction is favoured.
    rows, columns = np.indices((indices.shape[0] - 1, indices.shape[1] - 1))
    odd = ((rows + columns) % 2 == 1).ravel()
    first = np.where(odd[:, None], np.stack([a, c, d], 1), np.stack([a, c, b], 1))
    second = np.where(odd[:, None], np.stack([a, d, b], 1), np.stack([b, c, d], 1))
    return np.stack([first, second], axis=1).reshape(-1, 3).astype(np.int32)


def grid_uv(rows: int, columns: int) -> FloatArray:
    """Return (m, 3, 2) texture coordinates of the corners of `grid_faces`: u along columns, v along rows.

    They come from positions in the grid, not from vertices, so a grid may close on itself: its last column
    of indices repeats the first and u still reaches 1.
    """
    v, u = np.meshgrid(np.linspace(0.0, 1.0, rows), np.linspace(0.0, 1.0, columns), indexing="ij")
    uv = np.stack([u, v], axis=-1).reshape(-1, 2)
    return uv[grid_faces(np.arange(rows * columns).reshape(rows, columns))]


def closed_columns(rows: int, columns: int) -> IntArray:
    """Return (rows, columns + 1) indices of rows × columns vertices whose last column meets the first."""
    indices = np.arange(rows * columns).reshape(rows, columns)
    return np.concatenate([indices, indices[:, :1]], axis=1)

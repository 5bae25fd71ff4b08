"""Polygons to triangles, indices checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces
from vntoolkit.errors import BadMesh


def triangles_from_polygons(
    polygons: npt.NDArray[Any] | Sequence[npt.NDArray[Any]], vertex_count: int, name: str
) -> Faces:
    """Cut polygons into fans: an (m, k) array or a list of index arrays to (n, 3) int32.

    Raises `BadMesh` for fewer than three corners or an index outside the vertices.
    """
    if len(polygons) == 0:
        return np.empty((0, 3), dtype=np.int32)
    by_length: dict[int, list[npt.NDArray[Any]]] = {}
    if isinstance(polygons, np.ndarray):
        groups = {polygons.shape[1]: polygons}
    else:
        for polygon in polygons:
            by_length.setdefault(len(polygon), []).append(polygon)
        groups = {length: np.stack(group) for length, group in by_length.items()}
    triangles = []
    for length, group in groups.items():
        if length < 3:
            raise BadMesh(f"{name}: a face has {length} corners, expected at least 3")
        if not np.issubdtype(group.dtype, np.integer):
            raise BadMesh(f"{name}: a face's corners are numbers of vertices, got {group.dtype}")
        strange = group[(group < 0) | (group >= vertex_count)]
        if strange.size:
            raise BadMesh(f"{name}: a face names vertex {strange[0]}, there are {vertex_count}")
        fans = [group[:, [0, i, i + 1]] for i in range(1, length - 1)]
        triangles.append(np.stack(fans, axis=1).reshape(-1, 3))
    return np.concatenate(triangles).astype(np.int32)

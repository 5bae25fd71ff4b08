"""Cutting a mesh open along a curve, as a mouth and an eye are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces, FloatArray, IntArray, Points

BoolArray = npt.NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True, eq=False)
class Slit:
    """The two sides of a cut, vertex numbers from its smallest to its largest x.

    upper and lower have the same length and share their first and last vertex, the corners.
    """

    upper: IntArray
    lower: IntArray

    @property
    def loop(self) -> IntArray:
        """Vertex numbers once round, from the corner of least x: along the upper side, back by the lower."""
        return np.concatenate([self.upper, self.lower[-2:0:-1]])


def cut_slit(
    vertices: Points, faces: Faces, level: FloatArray, inside: BoolArray
) -> tuple[Points, Faces, Slit]:
    """Cut the mesh where `level` (n,) changes sign, on faces whose three corners are all `inside` (n,).

    New vertices are appended; those between the two ends are doubled, so that the sides above (level > 0)
    and below can part. The curve must run monotonically in x.
    """
    positive = level > 0
    mixed = positive[faces].any(axis=1) & ~positive[faces].all(axis=1)
    cut = np.flatnonzero(mixed & inside[faces].all(axis=1))
    alone = _turned_to_lone_corner(faces[cut], positive)
    a, b, c = alone.T
    keys, number = np.unique(
        np.sort(np.concatenate([np.stack([a, b], 1), np.stack([a, c], 1)]), axis=1),
        axis=0,
        return_inverse=True,
    )
    share = level[keys[:, 0]] / (level[keys[:, 0]] - level[keys[:, 1]])
    points = vertices[keys[:, 0]] + share[:, None] * (vertices[keys[:, 1]] - vertices[keys[:, 0]])
    order = np.argsort(points[:, 0])
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    number = rank[number.ravel()]
    keys, points = keys[order], points[order]
    upper = len(vertices) + np.arange(len(points))
    lower = np.concatenate([upper[:1], len(vertices) + len(points) + np.arange(len(points) - 2), upper[-1:]])
    new = _split_faces(alone, number.reshape(2, -1), positive, upper, lower)
    kept = np.ones(len(faces), dtype=bool)
    kept[cut] = False
    halved, halves = _halve_at_ends(faces, kept, keys[[0, -1]], upper[[0, -1]])
    kept[halved] = False
    all_vertices = np.concatenate([vertices, points, points[1:-1]])
    all_faces = np.concatenate([faces[kept], new, halves]).astype(np.int32)
    return all_vertices, all_faces, Slit(upper=upper, lower=lower)


def _split_faces(
    alone: IntArray, number: IntArray, positive: BoolArray, upper: IntArray, lower: IntArray
) -> IntArray:
    """Return three faces for each cut one: the lone corner's, and two of the other side.

    alone: (k, 3) faces turned to their lone corner. number: (2, k) new points on the edges that leave it.
    """
    a, b, c = alone.T
    above = positive[a][:, None]
    on_upper, on_lower = upper[number].T, lower[number].T
    lone, pair = np.where(above, on_upper, on_lower), np.where(above, on_lower, on_upper)
    return np.concatenate(
        [
            np.stack([a, lone[:, 0], lone[:, 1]], axis=1),
            np.stack([pair[:, 0], b, c], axis=1),
            np.stack([pair[:, 0], c, pair[:, 1]], axis=1),
        ]
    )


def _turned_to_lone_corner(faces: Faces, positive: BoolArray) -> IntArray:
    """Turn each face so that its first corner is alone on its side of the level."""
    signs = positive[faces]
    lone = np.where(signs.sum(axis=1) == 1, signs.argmax(axis=1), (~signs).argmax(axis=1))
    columns = (lone[:, None] + np.arange(3)) % 3
    return np.take_along_axis(faces.astype(np.int64), columns, axis=1)


def _halve_at_ends(
    faces: Faces, kept: BoolArray, edges: IntArray, tips: IntArray
) -> tuple[IntArray, IntArray]:
    """Split the uncut face beyond each end of the slit, so that no vertex lies on another face's edge."""
    halved, halves = [], []
    for (low, high), tip in zip(edges, tips, strict=True):
        holds = kept & (faces == low).any(axis=1) & (faces == high).any(axis=1)
        for f in np.flatnonzero(holds):
            face = faces[f]
            halved.append(f)
            halves += [np.where(face == low, tip, face), np.where(face == high, tip, face)]
    return np.array(halved, dtype=np.int64), np.array(halves, dtype=np.int64).reshape(-1, 3)

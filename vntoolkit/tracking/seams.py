"""Seams: where the user cuts the template, so that both sides move apart freely (lips, eyelids).

A seam is a polyline on the template image. Every mesh edge that it crosses is cut, and the triangles on
those edges are left out: the mesh keeps one vertex per pixel, and no regulariser couples across.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vntoolkit.arrays import Faces, IntArray, Mask, Points2
from vntoolkit.errors import BadInput


def require_seams_on_mask(seams: Sequence[Points2], mask: Mask) -> None:
    """Raise BadInput unless every seam has two points or more, all of them within the template's outline.

    A seam may pass over holes of the mask, as the dark between lips is one.
    """
    height, width = mask.shape
    outline = ndimage.binary_fill_holes(mask)
    for number, seam in enumerate(seams):
        points = np.asarray(seam, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise BadInput(f"seam {number}: expected two points (u, v) or more")
        u, v = np.rint(points).astype(np.int64).T
        inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        inside[inside] = outline[v[inside], u[inside]]
        if not inside.all():
            bad = points[~inside][0]
            raise BadInput(
                f"seam {number}: point ({bad[0]:g}, {bad[1]:g}) is off the template's mask; "
                f"give pixels of the template image, {width}×{height}, that show the surface"
            )


def cut_edges(edges: IntArray, positions_px: Points2, seams: Sequence[Points2]) -> npt.NDArray[np.bool_]:
    """Return (e,) True where a seam crosses the edge between two vertices at positions_px (n, 2).

    A vertex that lies exactly on a seam belongs to one side, the same for all of its edges. An edge that one
    seam crosses twice has both ends on the same side of it, and is not cut.
    """
    cut = np.zeros(len(edges), dtype=bool)
    for seam in seams:
        crossed = np.zeros(len(edges), dtype=bool)
        points = np.asarray(seam, dtype=np.float64)
        for start, end in itertools.pairwise(points):
            low, high = np.minimum(start, end) - 2.0, np.maximum(start, end) + 2.0
            near_vertex = np.all((positions_px >= low) & (positions_px <= high), axis=1)
            near = np.flatnonzero(near_vertex[edges[:, 0]] & near_vertex[edges[:, 1]])
            first, second = positions_px[edges[near, 0]], positions_px[edges[near, 1]]
            straddles = _side(start, end, first) != _side(start, end, second)
            crossed[near] ^= straddles & (_side(first, second, start) != _side(first, second, end))
        cut |= crossed
    return cut


def faces_without_cut_edges(faces: Faces, edges: IntArray, cut: npt.NDArray[np.bool_]) -> Faces:
    """Return the triangles none of whose edges is cut."""
    width = int(faces.max(initial=0)) + 1
    cut_codes = edges[cut, 0].astype(np.int64) * width + edges[cut, 1]
    keep = np.ones(len(faces), dtype=bool)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        low = np.minimum(faces[:, i], faces[:, j]).astype(np.int64)
        keep &= ~np.isin(low * width + np.maximum(faces[:, i], faces[:, j]), cut_codes)
    return faces[keep]


def _side(start: Points2, end: Points2, point: Points2) -> npt.NDArray[np.bool_]:
    along, across = end - start, point - start
    side: npt.NDArray[np.bool_] = along[..., 0] * across[..., 1] - along[..., 1] * across[..., 0] >= 0
    return side

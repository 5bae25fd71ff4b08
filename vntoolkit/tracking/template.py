"""The template: one vertex per valid pixel of the chosen frame, its triangles and its seams.

A seam is where the user cuts the template, so that both sides move apart freely (lips, eyelids): a polyline
on the template image. Every mesh edge that it crosses is cut, and the triangles on those edges are left out:
the mesh keeps one vertex per pixel, and no regulariser couples across.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from vntoolkit.arrays import Faces, IntArray, Mask, Points, Points2
from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import edges_from_faces


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackingTemplate:
    """The fixed topology that is followed.

    pixels: (n, 2) int32 (u, v), raster order. vertices_in_camera: (n, 3) float64. faces: (m, 3), outside
    towards the viewer, none across a seam. edges: (e, 2) horizontal and vertical pixel neighbours, none
    across a seam: what the graph of the regularisers and the windows of the registration follow.
    """

    pixels: npt.NDArray[np.int32]
    vertices_in_camera: Points
    faces: Faces
    edges: npt.NDArray[np.int32]

    @property
    def positions_px(self) -> Points2:
        """(n, 2) float64 pixel positions in the template frame."""
        return self.pixels.astype(np.float64)

    def points_px(self, camera: Camera) -> Points:
        """Return (n, 3) the vertices as seen from afar: u, v and the depth beside its median, in pixels."""
        depth = self.vertices_in_camera[:, 2]
        median = float(np.median(depth))
        pixels_per_length = float(camera.matrix[0, 0]) / (median if camera.is_perspective else 1.0)
        return np.column_stack([self.positions_px, pixels_per_length * (depth - median)])


def template_from_maps(
    normal_map: NormalMap, depth_map: DepthMap, camera: Camera, seams: Sequence[Points2] = ()
) -> TrackingTemplate:
    """Build the template of one frame, cut along the seams (polylines in its pixels).

    Pixels in no triangle are left out. Raises BadInput where no triangle is left, or a seam leaves the mask.
    """
    require_same_size(normal_map.mask, "normals", depth_map.mask, "depth")
    if normal_map.shape != (camera.height, camera.width):
        h, w = normal_map.shape
        raise BadInput(f"template is {w}×{h} but the camera is {camera.width}×{camera.height}")
    by_pixel = _grid_faces(normal_map.mask & depth_map.mask)
    mask = np.zeros(normal_map.shape, dtype=np.bool_)
    mask.ravel()[by_pixel] = True
    if not mask.any():
        raise BadInput("template: no valid pixel with normal and depth; choose another frame (--template N)")
    require_seams_on_mask(seams, mask)
    v, u = np.nonzero(mask)
    pixels = np.stack([u, v], axis=1).astype(np.int32)
    faces = (np.cumsum(mask, dtype=np.int32) - 1)[by_pixel]
    all_edges = edges_from_faces(faces)
    cut = cut_edges(all_edges, pixels.astype(np.float64), seams)
    straight = np.abs(pixels[all_edges[:, 0]] - pixels[all_edges[:, 1]]).sum(axis=1) == 1
    return TrackingTemplate(
        pixels=pixels,
        vertices_in_camera=camera.unproject(pixels.astype(np.float64), depth_map.depth[v, u]),
        faces=faces_without_cut_edges(faces, all_edges, cut) if cut.any() else faces,
        edges=all_edges[straight & ~cut],
    )


def _grid_faces(mask: Mask) -> IntArray:
    """Triangles (m, 3) of pixels by number, row after row: two of a quad, or one where a corner is missing.

    They are counter-clockwise seen from the camera, whose y points down.
    """
    index = np.arange(mask.size).reshape(mask.shape)
    (a, b, c, d), (p, q, r, s) = (
        (each[:-1, :-1], each[:-1, 1:], each[1:, :-1], each[1:, 1:]) for each in (mask, index)
    )
    corners = [
        (a & b & c, p, r, q),
        (b & c & d, q, r, s),
        (a & b & ~c & d, p, s, q),
        (a & ~b & c & d, p, r, s),
    ]
    return np.concatenate([np.stack([x[kept], y[kept], z[kept]], axis=1) for kept, x, y, z in corners])


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

"""The template: one vertex per valid pixel of the chosen frame, its triangles and its cuts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces, Mask, Points, Points2
from vntoolkit.checks import require_same_size
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.laplacian import edges_from_faces
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.seams import cut_edges, faces_without_cut_edges, require_seams_on_mask


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackingTemplate:
    """The fixed topology that is followed.

    pixels: (n, 2) int32 (u, v), raster order. vertices_in_camera: (n, 3) float64. faces: (m, 3), outside
    towards the viewer, none across a seam. edges: (e, 2) horizontal and vertical pixel neighbours, none
    across a seam: what the graph of the regularisers and the windows of the registration follow.
    index: (h, w) int32 vertex of a pixel or −1.
    """

    pixels: npt.NDArray[np.int32]
    vertices_in_camera: Points
    faces: Faces
    edges: npt.NDArray[np.int32]
    index: npt.NDArray[np.int32]

    @property
    def positions_px(self) -> Points2:
        """(n, 2) float64 pixel positions in the template frame."""
        return self.pixels.astype(np.float64)

    def pixels_per_length(self, camera: Camera) -> float:
        """Return how many pixels a length unit takes at the template's median depth."""
        depth = float(np.median(self.vertices_in_camera[:, 2])) if camera.is_perspective else 1.0
        return float(camera.matrix[0, 0]) / depth


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
    mask = _mask_with_triangles(normal_map.mask & depth_map.mask)
    if not mask.any():
        raise BadInput("template: no valid pixel with normal and depth; choose another frame (--template N)")
    require_seams_on_mask(seams, mask)
    index = np.full(mask.shape, -1, dtype=np.int32)
    v, u = np.nonzero(mask)
    index[v, u] = np.arange(len(u), dtype=np.int32)
    pixels = np.stack([u, v], axis=1).astype(np.int32)
    faces = _grid_faces(index)
    all_edges = edges_from_faces(faces)
    cut = cut_edges(all_edges, pixels.astype(np.float64), seams)
    straight = np.abs(pixels[all_edges[:, 0]] - pixels[all_edges[:, 1]]).sum(axis=1) == 1
    return TrackingTemplate(
        pixels=pixels,
        vertices_in_camera=camera.unproject(pixels.astype(np.float64), depth_map.depth[v, u]),
        faces=faces_without_cut_edges(faces, all_edges, cut) if cut.any() else faces,
        edges=all_edges[straight & ~cut],
        index=index,
    )


def _corner_masks(mask: Mask) -> list[Mask]:
    """Valid triangles of each quad: whole quads as two, quads with three corners as one."""
    a, b, c, d = mask[:-1, :-1], mask[:-1, 1:], mask[1:, :-1], mask[1:, 1:]
    return [a & b & c, b & c & d, a & b & ~c & d, a & ~b & c & d]


def _mask_with_triangles(mask: Mask) -> Mask:
    used = np.zeros_like(mask)
    abc, bcd, abd, acd = _corner_masks(mask)
    used[:-1, :-1] |= abc | abd | acd
    used[:-1, 1:] |= abc | bcd | abd
    used[1:, :-1] |= abc | bcd | acd
    used[1:, 1:] |= bcd | abd | acd
    return used


def _grid_faces(index: npt.NDArray[np.int32]) -> Faces:
    """Triangles of the pixel grid, counter-clockwise seen from the camera (whose y points down)."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]
    abc, bcd, abd, acd = _corner_masks(index >= 0)
    corners = [(abc, a, c, b), (bcd, b, c, d), (abd, a, d, b), (acd, a, c, d)]
    faces = np.concatenate([np.stack([p[keep], q[keep], r[keep]], axis=1) for keep, p, q, r in corners])
    return faces.astype(np.int32)

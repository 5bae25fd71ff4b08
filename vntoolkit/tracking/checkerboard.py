"""A checkerboard printed on the template and drawn in every frame: what slides is seen at a glance."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces, Points, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit
from vntoolkit.options.tracking import CheckerboardOptions

_LIGHT_IN_CAMERA = np.array([-0.35, -0.35, -0.87])  # towards the viewer, from above on the left
_LONGEST_EDGE_PX = 12.0  # a triangle stretched over more spans a fold or a gap and is not drawn


def checkerboard_frame(
    vertices_in_camera: Points,
    faces: Faces,
    template_pixels: Points2,
    camera: Camera,
    normal_map: NormalMap,
    options: CheckerboardOptions | None = None,
) -> npt.NDArray[np.uint8]:
    """Draw the frame, (h, w, 3) RGB: the shaded surface in grey, with the tracked checkerboard over it.

    template_pixels: (n, 2) where each vertex lies on the template, which its square follows from.
    """
    options = options or CheckerboardOptions()
    shade = np.clip(normal_map.normals_in_camera @ _LIGHT_IN_CAMERA.astype(np.float32), 0, 1)
    shade = np.where(normal_map.mask, 0.25 + 0.75 * shade, 0.0)
    square = (np.asarray(template_pixels) // options.square_px).astype(np.int64).sum(axis=1) % 2
    board = np.full(normal_map.shape, -1, dtype=np.int8)
    nearest = np.full(normal_map.shape, np.inf)
    _draw(
        camera.project(vertices_in_camera), np.asarray(vertices_in_camera, dtype=np.float64)[:, 2],
        np.asarray(faces, dtype=np.int32), square, _LONGEST_EDGE_PX, board, nearest,
    )  # fmt: skip
    colours = np.array([[0.85, 0.35, 0.2], [1.0, 0.97, 0.9], [0.6, 0.6, 0.6]])  # dark, light, none
    return np.rint(255 * shade[..., None] * colours[board]).astype(np.uint8)


@njit(cache=True)
def _draw(pixels, depth, faces, square, longest, board, nearest):  # type: ignore[no-untyped-def]
    h, w = board.shape
    for f in range(faces.shape[0]):
        i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
        low_u = min(pixels[i, 0], pixels[j, 0], pixels[k, 0])
        high_u = max(pixels[i, 0], pixels[j, 0], pixels[k, 0])
        low_v = min(pixels[i, 1], pixels[j, 1], pixels[k, 1])
        high_v = max(pixels[i, 1], pixels[j, 1], pixels[k, 1])
        if not (high_u - low_u < longest and high_v - low_v < longest):
            continue
        area = (pixels[j, 0] - pixels[i, 0]) * (pixels[k, 1] - pixels[i, 1]) - (
            pixels[k, 0] - pixels[i, 0]
        ) * (pixels[j, 1] - pixels[i, 1])
        if not abs(area) > 1e-12:
            continue
        z = (depth[i] + depth[j] + depth[k]) / 3.0
        for v in range(max(0, int(np.ceil(low_v))), min(h - 1, int(np.floor(high_v))) + 1):
            for u in range(max(0, int(np.ceil(low_u))), min(w - 1, int(np.floor(high_u))) + 1):
                b = ((u - pixels[i, 0]) * (pixels[k, 1] - pixels[i, 1]) - (pixels[k, 0] - pixels[i, 0]) * (v - pixels[i, 1])) / area  # fmt: skip  # noqa: E501
                c = ((pixels[j, 0] - pixels[i, 0]) * (v - pixels[i, 1]) - (u - pixels[i, 0]) * (pixels[j, 1] - pixels[i, 1])) / area  # fmt: skip  # noqa: E501
                if b >= -1e-6 and c >= -1e-6 and b + c <= 1 + 1e-6 and z < nearest[v, u]:
                    nearest[v, u] = z
                    corner = i if b + c < 0.5 else (j if b > c else k)
                    board[v, u] = square[corner]

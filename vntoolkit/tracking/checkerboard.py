"""A checkerboard printed on the template and drawn in every frame: what slides is seen at a glance."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces, Points, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.rays import RayScene, pixel_rays

_LIGHT_IN_CAMERA = np.array([-0.35, -0.35, -0.87])  # towards the viewer, from above on the left
_SQUARE_PX = 16  # side of a square on the template
_LONGEST_EDGE_PX = 12.0  # a triangle stretched over more spans a fold or a gap and is not drawn


def checkerboard_frame(
    vertices_in_camera: Points,
    faces: Faces,
    template_pixels: Points2,
    camera: Camera,
    normal_map: NormalMap,
) -> npt.NDArray[np.uint8]:
    """Draw the frame, (h, w, 3) RGB: the shaded surface in grey, with the tracked checkerboard over it.

    template_pixels: (n, 2) where each vertex lies on the template, which its square follows from.
    """
    shade = np.clip(normal_map.normals_in_camera @ _LIGHT_IN_CAMERA.astype(np.float32), 0, 1)
    shade = np.where(normal_map.mask, 0.25 + 0.75 * shade, 0.0)
    square = (np.asarray(template_pixels) // _SQUARE_PX).astype(np.int64).sum(axis=1) % 2
    vertices, pixels = np.asarray(vertices_in_camera, dtype=np.float64), camera.project(vertices_in_camera)
    whole = faces[(np.ptp(pixels[faces], axis=1) < _LONGEST_EDGE_PX).all(axis=1)]
    origins, rays = (each.reshape(-1, 3) for each in pixel_rays(camera, camera.pixel_grid()))
    if not camera.is_perspective:
        origins = origins + np.array([0.0, 0.0, vertices[:, 2].min() - 1.0])
    hits = RayScene((vertices, whole)).first_hits(np.hstack([origins, rays]))
    b, c = hits.barycentric.T
    corner = np.where(b + c < 0.5, 0, np.where(b > c, 1, 2))
    board = hits.image(square[whole[hits.faces, corner]], normal_map.shape, -1)
    colours = np.array([[0.85, 0.35, 0.2], [1.0, 0.97, 0.9], [0.6, 0.6, 0.6]])  # dark, light, none
    return np.rint(255 * shade[..., None] * colours[board]).astype(np.uint8)

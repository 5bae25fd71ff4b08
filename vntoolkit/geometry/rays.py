"""Ray casting on triangle meshes by Open3D: first hits, occlusion, nearest distances.

Embree (wald2014) does the work, through Open3D; it is told float32. Answers do not depend on the threads.
"""

from dataclasses import dataclass

import numpy as np

from vntoolkit.arrays import BoolArray, Faces, FloatArray, Int64Array, Points, Vectors
from vntoolkit.checks import require_finite
from vntoolkit.errors import BadMesh
from vntoolkit.geometry.camera import Camera
from vntoolkit.libraries import import_open3d


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """The p rays that met a surface.

    rays: (p,) int64 indices of the rays. surfaces, faces: (p,) int64, which surface and which of its faces.
    barycentric: (p, 2) float32 weights of the face's second and third corner. distances: (p,) float32 in
    lengths of the ray's direction. normals: (p, 3) float32 unit normals of the faces, as their corners turn.
    """

    rays: Int64Array
    surfaces: Int64Array
    faces: Int64Array
    barycentric: FloatArray
    distances: FloatArray
    normals: FloatArray

    def image(self, values: FloatArray, shape: tuple[int, int], elsewhere: float) -> FloatArray:
        """Return (h, w) with one value (p,) a hit, where one ray was cast a pixel, row by row."""
        image = np.full(shape, elsewhere, dtype=values.dtype)
        image.ravel()[self.rays] = values
        return image


class RayScene:
    """Surfaces, each its vertices (n, 3) and faces (m, 3), ready for rays. threads: 0 = all cores."""

    def __init__(self, *surfaces: tuple[Points, Faces], threads: int = 0) -> None:
        o3d = import_open3d()
        self._tensor = o3d.core.Tensor.from_numpy
        self._threads = threads
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=threads)
        for vertices, faces in surfaces:
            require_finite(vertices, "vertices to cast rays at", BadMesh)  # Embree never ends on NaN
            self._scene.add_triangles(
                np.ascontiguousarray(vertices, dtype=np.float32), np.ascontiguousarray(faces, dtype=np.uint32)
            )

    def first_hits(self, rays: FloatArray, which: Int64Array | None = None) -> Hits:
        """Return what rays (r, 6) = (origin, direction) meet first. which: indices of those to cast."""
        chosen = rays if which is None else rays[which]
        answer = self._scene.cast_rays(self._rays(chosen), nthreads=self._threads)
        faces = answer["primitive_ids"].numpy()
        met = np.flatnonzero(faces != self._scene.INVALID_ID)
        return Hits(
            rays=met if which is None else which[met],
            surfaces=answer["geometry_ids"].numpy()[met].astype(np.int64),
            faces=faces[met].astype(np.int64),
            barycentric=answer["primitive_uvs"].numpy()[met],
            distances=answer["t_hit"].numpy()[met],
            normals=answer["primitive_normals"].numpy()[met],
        )

    def blocked(
        self, origins: Points, *, directions: Vectors | None = None, targets: Points | None = None
    ) -> BoolArray:
        """Return (p,) True where a surface lies in the direction of origins (p, 3), or before their targets.

        Origins must lie off the surface (a little before it), or it blocks itself.
        """
        rays = np.empty((len(origins), 6), dtype=np.float32)
        rays[:, :3] = origins
        rays[:, 3:] = directions if targets is None else targets - rays[:, :3]
        farthest = np.inf if targets is None else 1.0
        answer: BoolArray = self._scene.test_occlusions(
            self._rays(rays), tnear=0.0, tfar=farthest, nthreads=self._threads
        ).numpy()
        return answer

    def distances(self, points: Points) -> FloatArray:
        """Return (p,) float32 distances from points (p, 3) to the nearest surface."""
        answer: FloatArray = self._scene.compute_distance(self._rays(points), nthreads=self._threads).numpy()
        return answer

    def closest(self, points: Points) -> Points:
        """Return (p, 3) the points of the surfaces that are nearest to points (p, 3)."""
        answer = self._scene.compute_closest_points(self._rays(points), nthreads=self._threads)
        return np.asarray(answer["points"].numpy(), dtype=np.float64)

    def _rays(self, values: FloatArray) -> object:
        return self._tensor(np.ascontiguousarray(values, dtype=np.float32))


def pixel_rays(camera: Camera, pixels: FloatArray) -> tuple[Points, Vectors]:
    """Return origins and directions (..., 3) of the rays of pixels (..., 2) in the camera frame.

    A perspective camera's directions reach depth 1; an orthographic camera's rays start at depth 0.
    """
    points = camera.unproject(pixels, np.ones(pixels.shape[:-1]))
    if camera.is_perspective:
        return np.zeros_like(points), points
    return points * [1.0, 1.0, 0.0], np.broadcast_to([0.0, 0.0, 1.0], points.shape)

"""Rays against a triangle mesh: what a pixel sees, and whether a lamp sees it (Embree through Open3D)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Faces, FloatArray, Points
from vntoolkit.checks import require_finite
from vntoolkit.errors import BadMesh
from vntoolkit.native import import_open3d


@dataclass(frozen=True, kw_only=True, eq=False)
class Hits:
    """The rays that met the mesh.

    rays: (p,) int64 indices of the rays. faces: (p,) int64. barycentric: (p, 2) float32 weights of the
    face's second and third corner.
    """

    rays: npt.NDArray[np.int64]
    faces: npt.NDArray[np.int64]
    barycentric: FloatArray


class RayCaster:
    """One frame's mesh, ready for rays. threads: 0 = all cores; the answers do not depend on it."""

    def __init__(self, vertices: Points, faces: Faces, threads: int = 0) -> None:
        require_finite(vertices, "vertices to cast rays at", BadMesh)  # Embree never ends on NaN
        self._open3d = import_open3d()
        self._threads = threads
        self._scene = self._open3d.t.geometry.RaycastingScene(nthreads=threads)
        self._scene.add_triangles(
            np.ascontiguousarray(vertices, dtype=np.float32), np.ascontiguousarray(faces, dtype=np.uint32)
        )

    def first_hits(self, rays: npt.NDArray[np.float32], which: npt.NDArray[np.int64]) -> Hits:
        """Return what those rays, of (p, 6) = (origin, direction), meet first. which: ray indices."""
        tensor = self._open3d.core.Tensor.from_numpy(rays[which])
        answer = self._scene.cast_rays(tensor, nthreads=self._threads)
        faces = answer["primitive_ids"].numpy()
        met = np.flatnonzero(faces != self._scene.INVALID_ID)
        return Hits(
            rays=which[met],
            faces=faces[met].astype(np.int64),
            barycentric=answer["primitive_uvs"].numpy()[met],
        )

    def blocked(self, origins: Points, targets: Points) -> npt.NDArray[np.bool_]:
        """Return (p,) True where the straight line from origin to target (p, 3) meets the mesh.

        Origins must lie off the surface (see `Samples.shadow_origins`), or it blocks itself.
        """
        rays = np.empty((len(origins), 6), dtype=np.float32)
        rays[:, :3] = origins
        rays[:, 3:] = targets - rays[:, :3]
        tensor = self._open3d.core.Tensor.from_numpy(rays)
        answer: npt.NDArray[np.bool_] = self._scene.test_occlusions(
            tensor, tnear=0.0, tfar=1.0, nthreads=self._threads
        ).numpy()
        return answer

"""As-rigid-as-possible deformation by Open3D: a comparison, seconds a frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Points
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_open3d
from vntoolkit.tracking.template import TrackingTemplate

_ITERATIONS = 5


class ArapRegulariser:
    """`sorkine2007`, with every k-th pixel as a handle whose target is met exactly."""

    def __init__(self, template: TrackingTemplate, handle_spacing_px: int) -> None:
        """Choose the handles: pixels on a lattice of that spacing."""
        self._faces = template.faces
        self._handles = np.flatnonzero(np.all(template.pixels % handle_spacing_px == 0, axis=1))

    def solve(self, vertices: Points, targets: Points) -> npt.NDArray[np.float64]:
        """Return the vertices (n, 3) deformed so that the handles lie at their targets (n, 3)."""
        if not self._handles.size:
            return np.asarray(targets, dtype=np.float64)
        o3d = import_open3d()
        mesh = Mesh(vertices=vertices, faces=self._faces).to_open3d()
        deformed = mesh.deform_as_rigid_as_possible(
            o3d.utility.IntVector(self._handles.astype(np.int32)),
            o3d.utility.Vector3dVector(np.asarray(targets, dtype=np.float64)[self._handles]),
            max_iter=_ITERATIONS,
        )
        return np.asarray(deformed.vertices)

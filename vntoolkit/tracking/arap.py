"""As-rigid-as-possible deformation by Open3D, for comparison; it takes seconds per frame."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from vntoolkit.arrays import Points
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.native import import_open3d
from vntoolkit.tracking.template import TrackingTemplate

_ITERATIONS = 5


class ArapRegulariser:
    """`sorkine2007`, with every k-th pixel as a handle whose target is met exactly."""

    def __init__(self, template: TrackingTemplate, handle_spacing_px: int) -> None:
        """Choose the handles: pixels on a lattice of that spacing, and all of a piece that it passes by."""
        self._faces = template.faces
        on_lattice = np.all(template.pixels % handle_spacing_px == 0, axis=1)
        pieces, piece = _pieces(template)
        is_held = np.bincount(piece, on_lattice, minlength=pieces) > 0
        self._handles = np.flatnonzero(on_lattice | ~is_held[piece])

    def solve(self, vertices: Points, targets: Points) -> npt.NDArray[np.float64]:
        """Return the vertices (n, 3) deformed so that the handles lie at their targets (n, 3)."""
        o3d = import_open3d()
        mesh = Mesh(vertices=vertices, faces=self._faces).to_open3d()
        deformed = mesh.deform_as_rigid_as_possible(
            o3d.utility.IntVector(self._handles.astype(np.int32)),
            o3d.utility.Vector3dVector(np.asarray(targets, dtype=np.float64)[self._handles]),
            max_iter=_ITERATIONS,
        )
        return np.asarray(deformed.vertices)


def _pieces(template: TrackingTemplate) -> tuple[int, npt.NDArray[np.int32]]:
    """Return how many pieces the triangles make, and the piece of each vertex (n,)."""
    count = len(template.pixels)
    corners = template.faces[:, [0, 1, 2]].ravel(), template.faces[:, [1, 2, 0]].ravel()
    links = sp.coo_array((np.ones(len(corners[0]), dtype=np.int8), corners), shape=(count, count))
    pieces, piece = connected_components(links, directed=False)
    return int(pieces), piece

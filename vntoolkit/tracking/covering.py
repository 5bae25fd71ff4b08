"""Where one part of the surface lies in front of another.

What does not match is hidden, or not where it is believed to be. It is hidden where another part, which
matches better, is believed to be in the same place of the picture.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.native import njit
from vntoolkit.tracking.lattice import TemplateLattice

_SQUARE_PX = 4  # side of the squares of the picture that count as one place: stretched, the mesh leaves gaps
_SAME_PART = 3  # edges: nodes so near on the surface do not hide each other, however steeply they are seen


class Covering:
    """Finds what is covered in any frame of one template."""

    def __init__(self, lattice: TemplateLattice, camera: Camera) -> None:
        """Find which nodes are near one another on the surface; camera: of the frames."""
        self._node = lattice.node_of_vertex
        self._vertices = np.bincount(self._node, minlength=lattice.count)
        self._shape = (camera.height // _SQUARE_PX + 1, camera.width // _SQUARE_PX + 1)
        self._near = sp.csr_array(sp.eye_array(lattice.count))  # which nodes are of the same part as each
        for _ in range(_SAME_PART):
            self._near = sp.csr_array(self._near + self._near @ lattice.adjacency)
        self._near.sort_indices()

    def of(self, positions_px: Points2, match: FloatArray) -> npt.NDArray[np.float64]:
        """Return (nodes,) the share of each that is covered, or out of the picture.

        positions_px: (n, 2). match: (nodes,) how well each matches there.
        """
        positions = np.asarray(positions_px, dtype=np.float64)
        in_front = np.full(self._shape, -1, dtype=np.int64)
        covered = _covered(positions, self._node, match, in_front, self._near.indptr, self._near.indices)
        return np.asarray(covered / self._vertices)


@njit(cache=True)
def _covered(positions, node, match, in_front, starts, near):  # type: ignore[no-untyped-def]
    """Vertices (nodes,) that are covered; in_front: (h, w), all −1, is overwritten."""
    h, w = in_front.shape
    for i in range(len(positions)):
        u, v = np.floor(positions[i, 0] / _SQUARE_PX), np.floor(positions[i, 1] / _SQUARE_PX)
        if 0 <= u < w and 0 <= v < h:
            best = in_front[int(v), int(u)]
            if best < 0 or match[node[i]] > match[best]:
                in_front[int(v), int(u)] = node[i]
    covered = np.zeros(len(match))
    for i in range(len(positions)):
        u, v = np.floor(positions[i, 0] / _SQUARE_PX), np.floor(positions[i, 1] / _SQUARE_PX)
        own, before = node[i], -1
        if 0 <= u < w and 0 <= v < h:
            before = in_front[int(v), int(u)]
        at = starts[own] + np.searchsorted(near[starts[own] : starts[own + 1]], before)
        if at >= starts[own + 1] or near[at] != before:
            covered[own] += 1.0
    return covered

"""What lies still while the rest moves: a neck under a head that turns, shoulders beside an arm.

Where texture shows no match, what is not seen is carried by what is, and the neck would go with the chin. Yet
the shape that is seen tells: at the same pixels the template's normals are still there, and where the neck
was thought to be they are not, or there is no surface at all. Both are asked for, of the normals themselves
(smoothed, not high-passed): a part that is flat, or turns, or is hidden, is not said to lie still.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Points2
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.native import njit
from vntoolkit.tracking.flow_slopes import smooth_normals
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.template import TrackingTemplate

_SMOOTHING_PX = 2.0
_SAME_DEG, _LIKE_DEG = 3.0, 25.0  # normals at rest agree; normals of a part that has moved and turned may
_PASSES = 1  # of lattice smoothing
_LEAST, _MOST = 0.2, 0.6  # share of the pixels by which rest must win: from not at all to fully


class RestingParts:
    """Tells which cells of one template lie still."""

    def __init__(self, lattice: TemplateLattice, template: TrackingTemplate, normal_map: NormalMap) -> None:
        """Remember the template's normals; normal_map: of its frame."""
        self._lattice, self._pixels = lattice, template.pixels
        self._template = smooth_normals(normal_map, _SMOOTHING_PX)

    def shares(self, normal_map: NormalMap, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (nodes,) from 0 to 1 how surely a cell lies where it does in the template.

        normal_map: of the current frame. positions_px: (n, 2) where the vertices are thought to be in it.
        """
        limits = np.cos(np.radians([_SAME_DEG, _LIKE_DEG]))
        votes = _votes(
            self._template, smooth_normals(normal_map, _SMOOTHING_PX), self._pixels, positions_px, limits,
            self._lattice.node_of_vertex, self._lattice.count,
        )  # fmt: skip
        votes = self._lattice.smoothed(votes, _PASSES)
        margin = (votes[:, 0] - votes[:, 1]) / votes[:, 2]
        return np.clip((margin - _LEAST) / (_MOST - _LEAST), 0.0, 1.0)


@njit(cache=True)
def _votes(template, frame, pixels, positions, limits, node, count):  # type: ignore[no-untyped-def]
    """(nodes, 3): vertices for rest, for where they are thought to be, and all."""
    h, w = frame.shape[:2]
    out = np.zeros((count, 3))
    for i in range(len(node)):
        u, v = pixels[i, 0], pixels[i, 1]
        x, y = positions[i, 0], positions[i, 1]
        own = template[v, u]
        out[node[i], 0] += _agrees(own, frame[v, u], limits[0])
        if x > -0.5 and y > -0.5 and x < w - 0.5 and y < h - 0.5:
            out[node[i], 1] += _agrees(own, frame[int(y + 0.5), int(x + 0.5)], limits[1])
        out[node[i], 2] += 1.0
    return out


@njit(cache=True)
def _agrees(first, second, limit):  # type: ignore[no-untyped-def]
    product = first[0] * second[0] + first[1] * second[1] + first[2] * second[2]
    lengths = np.sqrt(
        (first[0] ** 2 + first[1] ** 2 + first[2] ** 2) * (second[0] ** 2 + second[1] ** 2 + second[2] ** 2)
    )
    return 1.0 if product > limit * lengths else 0.0

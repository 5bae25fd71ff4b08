"""What a frame shows, laid on the template's raster band by band: what registration compares.

The frame's slopes are sampled at the vertices and pulled back into the template by the transposed Jacobian:
they are the gradient of log Z. Paint is a scalar, and is sampled as it is. A band is what is left after a
Gaussian is taken off, at full resolution and at halvings (`slopes.gradient_bands`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points2
from vntoolkit.native import njit
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.paint import PaintImage
from vntoolkit.tracking.slopes import LEAST_WEIGHT, Relief, gradient_bands
from vntoolkit.tracking.template import TrackingTemplate

RIM_PX = 12.0  # of the band: nearer to an occluding contour, slopes belong to the contour
LEAST_NOISE = 1e-3  # slope: what interpolation leaves
_NOT_PULLED_BACK = np.empty((0, 4))  # no Jacobians


@dataclass(frozen=True, kw_only=True, eq=False)
class Band:
    """One band of the template, on its raster.

    node: (h, w) int32, −1 outside. features: (h, w, k), two slopes or paint. gradients: (h, w, 2 k) ∂f/∂u of
    all, ∂f/∂v of all. weight: (h, w). beside: (h, w) True within reach of an occluding contour.
    """

    node: npt.NDArray[np.int32]
    features: npt.NDArray[np.float32]
    gradients: npt.NDArray[np.float32]
    weight: npt.NDArray[np.float32]
    beside: Mask


class TemplateRaster:
    """The pixels around one template: node (h, w) int32, −1 outside."""

    def __init__(self, template: TrackingTemplate, lattice: TemplateLattice) -> None:
        pixels = template.pixels
        origin = pixels.min(axis=0)
        width, height = pixels.max(axis=0) + 1 - origin
        self._lattice = lattice
        self._at = (pixels[:, 1] - origin[1], pixels[:, 0] - origin[0])
        self.node = np.full((int(height), int(width)), -1, dtype=np.int32)
        self.node[self._at] = lattice.node_of_vertex

    def relief(self, positions_px: Points2, jacobians: FloatArray, relief: Relief) -> list[Band]:
        """Return the bands of a frame's slopes; jacobians: (nodes, 4) of positions (n, 2)."""
        return self._banded(relief[..., :3], positions_px, jacobians, relief)

    def paint(self, positions_px: Points2, paint: PaintImage | None, relief: Relief) -> list[Band]:
        """Return the bands of a frame's paint, empty ones for None; relief: of the same frame."""
        nothing = np.zeros((*relief.shape[:2], 2), np.float32)
        return self._banded(nothing if paint is None else paint, positions_px, _NOT_PULLED_BACK, relief)

    def _banded(
        self, image: npt.NDArray[np.float32], positions_px: Points2, jacobians: FloatArray, relief: Relief
    ) -> list[Band]:
        values, weight, from_contour_px = self._read(image, positions_px, jacobians, relief)
        node, out = self.node, []
        for halvings, (features, gradients, kept) in enumerate(gradient_bands(values, weight)):
            beside = from_contour_px[:: 2**halvings, :: 2**halvings] < RIM_PX * 2.0**halvings
            if halvings == 0:
                kept[beside] = 0.0
            out.append(Band(node=node, features=features, gradients=gradients, weight=kept, beside=beside))
            node = np.ascontiguousarray(node[::2, ::2])
        return out

    def _read(
        self, image: npt.NDArray[np.float32], positions_px: Points2, jacobians: FloatArray, relief: Relief
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Values (h, w, k) times weight (h, w), the weight, and distance from an occluding contour (h, w)."""
        shape, lattice = self.node.shape, self._lattice
        values = np.zeros((*shape, image.shape[2] - 1), dtype=np.float32)
        weight, from_contour_px = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        at = (lattice.taps, lattice.shares, *self._at)
        _pull_back(image, relief, positions_px, jacobians, *at, values, weight, from_contour_px)
        return values, weight, from_contour_px


def curl_of(band: Band) -> npt.NDArray[np.float32]:
    """Return (h, w) the curl of a band's slopes."""
    return np.asarray(band.gradients[..., 2] - band.gradients[..., 1])


@njit
def _pull_back(image, relief, positions, jacobians, taps, shares, rows, columns, values, total, from_contour):  # type: ignore[no-untyped-def]
    """Write image (h, w, k + 1), its weight last, at the positions into the vertices' rows and columns.

    Slopes w a, where there are Jacobians, become w Jᵀ a. Within half a pixel beyond the outermost centres,
    which is still the picture, the outermost pixels count.
    """
    h, w = image.shape[:2]
    k = image.shape[2] - 1
    jacobian, value = np.empty(4), np.empty(2)
    for i in range(positions.shape[0]):
        x, y = positions[i, 0], positions[i, 1]
        if not (x > -0.5 and y > -0.5 and x < w - 0.5 and y < h - 0.5):
            continue
        x, y = min(max(x, 0.0), w - 1.0), min(max(y, 0.0), h - 1.0)
        u, v = min(int(x), w - 2), min(int(y), h - 2)
        a, b = x - u, y - v
        weight = 0.0
        value[:] = 0.0
        for dv in range(2):
            for du in range(2):
                share = (a if du else 1 - a) * (b if dv else 1 - b)
                for c in range(k):
                    value[c] += share * image[v + dv, u + du, c]
                weight += share * image[v + dv, u + du, k]
        if weight > LEAST_WEIGHT:
            row, column = rows[i], columns[i]
            if len(jacobians) > 0:
                jacobian[:] = 0.0
                for corner in range(4):
                    for c in range(4):
                        jacobian[c] += shares[i, corner] * jacobians[taps[i, corner], c]
                p, q = value[0], value[1]
                value[0], value[1] = jacobian[0] * p + jacobian[2] * q, jacobian[1] * p + jacobian[3] * q
            for c in range(k):
                values[row, column, c] = value[c]
            total[row, column] = weight
            from_contour[row, column] = relief[int(y + 0.5), int(x + 0.5), 3]

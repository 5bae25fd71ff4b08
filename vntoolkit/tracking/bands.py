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
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.paint import PaintImage
from vntoolkit.tracking.slopes import LEAST_WEIGHT, Relief, gradient_bands, sample_image
from vntoolkit.tracking.template import TrackingTemplate

RIM_PX = 12.0  # of the band: nearer to an occluding contour, slopes belong to the contour
LEAST_NOISE = 1e-3  # slope: what interpolation leaves


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
        return self._banded(nothing if paint is None else paint, positions_px, None, relief)

    def _banded(
        self,
        image: npt.NDArray[np.float32],
        positions_px: Points2,
        jacobians: FloatArray | None,
        relief: Relief,
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
        self,
        image: npt.NDArray[np.float32],
        positions_px: Points2,
        jacobians: FloatArray | None,
        relief: Relief,
    ) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.float32], npt.NDArray[np.float32]]:
        """Values (h, w, k) times weight (h, w), the weight, and distance from an occluding contour (h, w).

        Slopes w a, where there are Jacobians J, become w Jᵀ a. Within half a pixel beyond the outermost
        centres, which is still the picture, the outermost pixels count.
        """
        h, w = image.shape[:2]
        sampled = sample_image(image, positions_px)
        inside = np.all((positions_px > -0.5) & (positions_px < [w - 0.5, h - 0.5]), axis=1)
        read = np.flatnonzero(inside & (sampled[:, -1] > LEAST_WEIGHT))
        sampled = sampled[read]
        if jacobians is not None:
            along = self._lattice.at_vertices(jacobians)[read].reshape(-1, 2, 2)
            sampled[:, :2] = np.einsum("nij,ni->nj", along, sampled[:, :2])
        shape, at = self.node.shape, tuple(each[read] for each in self._at)
        values = np.zeros((*shape, image.shape[2] - 1), dtype=np.float32)
        weight, from_contour_px = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
        values[at], weight[at] = sampled[:, :-1], sampled[:, -1]
        u, v = np.clip(positions_px[read] + 0.5, 0.0, (w - 1, h - 1)).astype(np.int64).T
        from_contour_px[at] = relief[v, u, 3]
        return values, weight, from_contour_px


def curl_of(band: Band) -> npt.NDArray[np.float32]:
    """Return (h, w) the curl of a band's slopes."""
    return np.asarray(band.gradients[..., 2] - band.gradients[..., 1])

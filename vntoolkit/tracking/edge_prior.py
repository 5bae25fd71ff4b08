"""The prior of the edges of a lattice: how far apart neighbouring nodes lie in a frame, and how surely.

Two of them make it, each by how well it does where the nodes around are measured:

- Lengths on the surface stay. A step dx on the template is dxᵀ G_t dx long, squared, and dxᵀ Jᵀ G_c J dx in
  the frame, G the metrics that the normals give, so Jᵀ G_c J = G_t. That leaves a turn R open, which is
  that of the surroundings: J = G_c^(−1/2) R G_t^(1/2). At grazing angles, and where the surface is hidden,
  it says little. What the whole stretches by is left open too: `uniform_strains`.
- The whole moves as one body (`body_motion`). It is right for an ear behind the cheek's rim.

Lengths are read where a node is believed to be, from what lies between the two nodes (`surface_metric`).
Where another part lies in front, or the node has slipped, they are another surface's. So they are right with
some probability only: the less, the worse they agree with the body, by what either may err.

Where the two differ, which of them holds is an error that all edges share.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points2
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import HALF_WEIGHT_DEG, DepthMap
from vntoolkit.tracking.body_motion import BodyMotion
from vntoolkit.tracking.lattice import TemplateLattice
from vntoolkit.tracking.modes import STRAIN
from vntoolkit.tracking.slopes import Slopes, sample_depth
from vntoolkit.tracking.surface_metric import MeanMetric, SurfaceMetric
from vntoolkit.tracking.template import TrackingTemplate

STRAIN_PASSES = 4  # of lattice smoothing: strain that is not foreseen goes on over some cells
_CONTOUR_STEEPNESS = 3.0  # squared slope, 60°, by which a surface recedes, and then no longer: a contour
_BODY = 0.3  # the same beside the whole's motion: of a face that talks, a cloth that swings
_PRIOR_EDGES = 0.2  # measured edges nearby that the two count for
NEAR_PASSES = 8  # of lattice smoothing: how far around residuals of edges tell of a place
_NORMAL_ERROR = 0.05  # radians: shading that departs from the model turns normals by 3°
_INDEPENDENT = 3.0  # errors by weight in a cell: light that is not foreseen turns most of its normals alike
_MISTAKEN = 0.05  # share of lengths that are another surface's
_TURN_PASSES = 2  # of lattice smoothing: the turn in the image is that of the surroundings
_LEAST_WEIGHT = 1e-3  # mean of the slopes' in a cell that is divided by
_LEAST_RELIABLE = 1e-4  # of a node that is not measured, in the fit of one body


class Prior(NamedTuple):
    """steps: (edges, 2) from node to node. variance: (edges,) by direction, px².

    shared: (edges, 2) deviation of all steps together, by which of the two holds.
    """

    steps: npt.NDArray[np.float64]
    variance: npt.NDArray[np.float64]
    shared: npt.NDArray[np.float64]


class EdgePrior:
    """Foresees the edges of one template's lattice in any frame."""

    def __init__(
        self, lattice: TemplateLattice, template: TrackingTemplate, camera: Camera, slopes: Slopes
    ) -> None:
        """Measure the template; slopes: of its frame."""
        self._lattice, self._camera = lattice, camera
        self._counts = np.bincount(lattice.node_of_vertex, minlength=lattice.count)
        self.centres = lattice.sums(template.positions_px) / self._counts[:, None]
        self.edges = lattice.edges
        self.along = self.centres[self.edges[:, 1]] - self.centres[self.edges[:, 0]]
        self._square = np.sum(self.along**2, axis=1)
        self.middles = self.centres[self.edges].mean(axis=1)
        self._depth = template.vertices_in_camera[:, 2]
        self._metric = SurfaceMetric(
            lattice, camera, template.positions_px, self.centres, self.edges, self.along
        )
        nodes, self._template_metric = self._metric.read(
            slopes, template.positions_px, np.ones(len(template.pixels))
        )
        self._contour = self._at_contours(nodes, self.along)
        self._root = self._template_metric.root
        self._inverse_root = np.linalg.inv(self._root)
        self._motion = BodyMotion(lattice, template, camera)

    def nodes(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (nodes, 2) the means of positions (n, 2)."""
        return self._lattice.sums(positions_px) / self._counts[:, None]

    def steps(self, positions_px: Points2) -> npt.NDArray[np.float64]:
        """Return (edges, 2) the steps from node to node of positions (n, 2)."""
        nodes = self.nodes(positions_px)
        return np.asarray(nodes[self.edges[:, 1]] - nodes[self.edges[:, 0]])

    def observable(self, measured: FloatArray) -> npt.NDArray[np.float64]:
        """Return (edges,) how far each is measured, by how far its ends are, (nodes,)."""
        return np.minimum(*measured[self.edges.T])

    def at(
        self,
        positions_px: Points2,
        around: FloatArray,
        slopes: Slopes,
        depth_map: DepthMap,
        measured: FloatArray,
    ) -> Prior:
        """Return the steps from node to node.

        around: (nodes, 4) Jacobians of positions (n, 2). measured: (nodes,) from 0 to 1, how far a node's
        place is known.
        """
        a, b = self.edges.T
        by_lengths, of_normals, contour = self._by_lengths(positions_px, around, slopes, depth_map)
        now = self.nodes(positions_px)
        observable = self.observable(measured) + _LEAST_RELIABLE
        whole = self._motion.fitted(now - self.centres, measured + _LEAST_RELIABLE)
        by_body = self.along + whole[b] - whole[a]
        steps, square = now[b] - now[a], self._square
        of_lengths = self._near_mean(_strain(steps - by_lengths, square), observable, STRAIN**2) + of_normals
        of_body = self._near_mean(_strain(steps - by_body, square), observable, _BODY**2)
        apart = np.sum((by_lengths - by_body) ** 2, axis=1) / square
        right = share_right(1.0 - _MISTAKEN, apart, of_lengths + of_body)
        share = right * of_body / (of_lengths + of_body)
        likely = np.minimum((contour + self._contour) / _CONTOUR_STEEPNESS, 1.0)
        variance = square * np.minimum(of_lengths, of_body)
        slip = square * likely**2  # across a contour as much as an edge is long may be hidden
        return Prior(
            steps=share[:, None] * by_lengths + (1.0 - share)[:, None] * by_body,
            variance=variance + slip,
            shared=np.sqrt(share * (1.0 - share))[:, None] * (by_lengths - by_body),
        )

    def _by_lengths(
        self, positions_px: Points2, around: FloatArray, slopes: Slopes, depth_map: DepthMap
    ) -> tuple[npt.NDArray[np.float64], ...]:
        """(edges, 2) steps, (edges,) squared strain by errors of the normals, and `_at_contours`."""
        scale = np.ones(len(positions_px))
        if self._camera.is_perspective:
            depth, found = sample_depth(depth_map.depth, depth_map.mask, positions_px)
            scale = np.where(found, depth / self._depth, 1.0)
        of_nodes, of_edges = self._metric.read(slopes, positions_px, scale)
        root = of_edges.root
        a, b = self.edges.T
        sums = self._lattice.smoothed(np.hstack([around, np.ones((len(around), 1))]), _TURN_PASSES)
        sums = sums[a] + sums[b]
        mean = (sums[:, :4] / sums[:, 4:]).reshape(-1, 2, 2)
        wanted = np.linalg.inv(root) @ _nearest_turn(root @ mean @ self._inverse_root) @ self._root
        steps = np.einsum("eab,eb->ea", wanted, self.along)
        nodes = self.nodes(positions_px)
        now = nodes[b] - nodes[a]
        weight = np.clip(np.minimum(of_edges.weight, self._template_metric.weight), _LEAST_WEIGHT, 1.0)
        turned = _NORMAL_ERROR**2 + np.radians(HALF_WEIGHT_DEG) ** 2 / _INDEPENDENT * (1.0 / weight - 1.0)
        # By its own length: an edge that is foreshortened to a third errs by a third as many pixels.
        errs = turned * (of_edges.steepness + self._template_metric.steepness + turned)
        strain = errs * np.sum(steps**2, axis=1) / self._square
        return steps, strain, self._at_contours(of_nodes, now)

    def _at_contours(self, nodes: MeanMetric, steps: FloatArray) -> npt.NDArray[np.float64]:
        """(edges,) squared slope by which the surface recedes and then no longer, as at an occluding contour.

        A crease that is as steep on either side hides nothing.
        """
        unit = steps / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 1e-9)
        first, second = (
            np.sign(np.sum(nodes.slope[end] * unit, axis=1))
            * np.sqrt(np.maximum(np.einsum("ei,eij,ej->e", unit, nodes.metric[end], unit) - 1.0, 0.0))
            for end in self.edges.T
        )
        onward, back = first - np.abs(second), -second - np.abs(first)
        return np.asarray(np.square(np.maximum(np.maximum(onward, back), 0.0)))

    def _near_mean(self, value: FloatArray, weight: FloatArray, prior: float) -> npt.NDArray[np.float64]:
        """(edges,) weighted mean of a value of the edges around each, beside the prior's few."""
        count = self._lattice.count
        sums = np.zeros((count, 2))
        for end in self.edges.T:
            sums[:, 0] += np.bincount(end, weight * value, minlength=count)
            sums[:, 1] += np.bincount(end, weight, minlength=count)
        sums = self._lattice.smoothed(sums, NEAR_PASSES) / 3.0**NEAR_PASSES
        means = [
            (sums[end, 0] + _PRIOR_EDGES * prior) / (sums[end, 1] + _PRIOR_EDGES) for end in self.edges.T
        ]
        return np.asarray(0.5 * (means[0] + means[1]))


def share_right(before: float, apart: FloatArray, variance: FloatArray) -> npt.NDArray[np.float64]:
    """Return (edges,) how likely lengths are right that differ from the body by so much, squared strain.

    before: how likely that is by itself. variance: of the difference where they are right, by direction.
    Where they are wrong they err by as much as the edge is long.
    """
    right = before / variance * np.exp(-0.5 * apart / variance)
    wrong = (1.0 - before) / (1.0 + variance) * np.exp(-0.5 * apart / (1.0 + variance))
    return np.asarray(right / (right + wrong))


def _strain(difference: FloatArray, square: FloatArray) -> npt.NDArray[np.float64]:
    """Squared departure of an edge by its squared length, by direction, bounded: beyond, it is just wrong."""
    u, v = difference.T
    return np.asarray(np.minimum((u * u + v * v) / square, 1.0))


def _nearest_turn(matrix: FloatArray) -> npt.NDArray[np.float64]:
    """Return the rotation (m, 2, 2) nearest to each matrix."""
    cosine, sine = matrix[:, 0, 0] + matrix[:, 1, 1], matrix[:, 1, 0] - matrix[:, 0, 1]
    length = np.maximum(np.hypot(cosine, sine), 1e-9)
    cosine, sine = cosine / length, sine / length
    return np.stack([cosine, -sine, sine, cosine], axis=1).reshape(-1, 2, 2)

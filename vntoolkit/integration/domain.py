"""What the solvers of one domain share and keep while the mask does not change."""

from __future__ import annotations

from functools import cached_property

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Normals, Weight
from vntoolkit.integration.chords import chords_from_normals
from vntoolkit.integration.components import Components
from vntoolkit.integration.discontinuity import (
    confidence_of_edges,
    evidence_from_chords,
    solve_discontinuous,
)
from vntoolkit.integration.edges import edges_from_slopes
from vntoolkit.integration.graph import PixelGraph, divergence_on_graph, graph_from_domain
from vntoolkit.integration.masked import MaskedSolver
from vntoolkit.integration.multigrid import hierarchy_from_graph, solve_laplacian
from vntoolkit.integration.options import IntegrationOptions
from vntoolkit.integration.slopes import RayField, slopes_from_normals

Float64 = npt.NDArray[np.float64]


class DomainSolver:
    """Solvers inside one domain, (h, w) bool; each keeps its operator and starts from the depth before.

    Solutions are depth (orthographic) or log depth (perspective), (h, w) float64, of mean 0 over each
    connected component and 0 outside.
    """

    def __init__(self, domain: Mask, rays: RayField, options: IntegrationOptions) -> None:
        self.domain = domain
        self.components = Components(domain)
        self.iterations = 0
        self._rays = rays
        self._options = options
        self._last: Float64 | None = None

    @cached_property
    def _masked(self) -> MaskedSolver:
        return MaskedSolver(
            self.domain, tolerance=self._options.tolerance, most_iterations=self._options.most_iterations
        )

    @cached_property
    def _graph(self) -> PixelGraph:
        return graph_from_domain(self.domain)

    @cached_property
    def _points(self) -> FloatArray:
        return self._rays.image_plane_points(*self.domain.shape)[self.domain]

    def poisson(self, normals: Normals, weight: Weight | None) -> Float64:
        """Least squares over all edges of the domain.

        Without weights by the cosine transform as preconditioner, with weights by algebraic multigrid.
        """
        p, q = slopes_from_normals(normals, self._rays, self._options.steepest_slope_deg)
        edges = edges_from_slopes(p, q, self.domain, weight)
        if weight is None:
            solution = self._masked.solve(edges, self._last)
            self.iterations = self._masked.iterations
            return self._keep(solution)
        graph = self._graph
        tail = graph.pixels[graph.tail]
        across, down = tail[: graph.across], tail[graph.across :]
        difference = np.concatenate([edges.right.ravel()[across], edges.down.ravel()[down]])
        trust = np.concatenate([edges.right_weight.ravel()[across], edges.down_weight.ravel()[down]])
        trust = trust.astype(np.float64)
        nodes, self.iterations = solve_laplacian(
            hierarchy_from_graph(graph.row_start, graph.neighbour, trust[graph.edge]),
            divergence_on_graph(graph, trust, difference),
            self._start(),
            tolerance=self._options.tolerance,
            most_iterations=self._options.most_iterations,
        )
        return self._keep(self._image(nodes))

    def discontinuity(self, normals: Normals, weight: Weight | None) -> Float64:
        """Robust least squares that cuts edges across depth discontinuities."""
        graph, scale = self._graph, self._rays.pixels_per_unit
        chords = chords_from_normals(
            normals[self.domain],
            self._points,
            graph,
            perspective=self._rays.depth_scales_ray > 0.0,
            pixels_per_unit=scale,
            steepest_slope_deg=self._options.steepest_slope_deg,
        )
        nodes = solve_discontinuous(
            graph,
            chords.difference,
            evidence_from_chords(graph, chords, self.domain, self._options.discontinuity),
            confidence_of_edges(graph, weight),
            self._options.discontinuity,
            start=self._start() * scale,
            most_iterations=self._options.most_iterations,
        )
        return self._keep(self._image(nodes) / scale)

    def _start(self) -> Float64:
        return np.zeros(len(self._graph.pixels)) if self._last is None else self._last[self.domain]

    def _image(self, nodes: Float64) -> Float64:
        image = np.zeros(self.domain.shape)
        image[self.domain] = nodes
        return image

    def _keep(self, solution: Float64) -> Float64:
        self._last = self.components.remove_means(solution)
        return self._last

"""The tracker: it registers one template to every frame, one step per frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy.sparse as sp

from vntoolkit.arrays import Flow, Points, Points2
from vntoolkit.checks import checks_kinds, require_same_size
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.laplacian import cotangent_laplacian, graph_laplacian
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.tracking.advection import advected_positions, targets_on_surface
from vntoolkit.tracking.arap import ArapRegulariser
from vntoolkit.tracking.drift import TemplateRegistration
from vntoolkit.tracking.extrapolation import Extrapolation
from vntoolkit.tracking.flow import flow_between, flow_from_tracks
from vntoolkit.tracking.flow_slopes import Relief, bytes_from_normals, slope_pyramid
from vntoolkit.tracking.isometry import Isometry
from vntoolkit.tracking.laplacian_coordinates import LaplacianRegulariser, beta_from_smoothing_length
from vntoolkit.tracking.lattice import lattice_on_template
from vntoolkit.tracking.options import (
    Confidence,
    DriftCorrection,
    FlowMethod,
    LaplacianKind,
    Regulariser,
    RestShape,
    Tears,
    TrackingOptions,
)
from vntoolkit.tracking.resting import RestingParts
from vntoolkit.tracking.tears import tear_pixels
from vntoolkit.tracking.template import TrackingTemplate, template_from_maps
from vntoolkit.tracking.tracked_frame import TrackedFrame, tracked_frame
from vntoolkit.tracking.translation import TranslationRegulariser

_CARRIES = 2  # the second reads lengths and normals where the first has put what is not seen


class SurfaceTracker:
    """Follows one template, frame by frame, forwards or backwards: `step` takes the next frame."""

    @checks_kinds
    def __init__(
        self,
        template: NormalMap,
        depth: DepthMap,
        camera: Camera,
        options: TrackingOptions | None = None,
        seams: Sequence[Points2] = (),
    ) -> None:
        """Cut the template along the seams and factor what every frame solves.

        template, depth: maps of the template frame. seams: polylines (k, 2) in its pixels. Raises BadInput
        where no pixel is valid or a seam leaves the mask.
        """
        self.options = options or TrackingOptions()
        self.camera = camera
        whole = template
        if self.options.tears is Tears.NORMALS:
            whole = replace(template, mask=template.mask & ~tear_pixels(template))
        self.template = template_from_maps(whole, depth, camera, seams)
        self.state = tracked_frame(
            self.template.vertices_in_camera, np.ones(len(self.template.pixels)), camera
        )
        self._steps = 0
        self._previous = template
        self._relief: Relief | None = None
        self._positions_before = self.state.positions_px
        self._registration: TemplateRegistration | None = None
        self._extrapolation: Extrapolation | None = None
        self._isometry: Isometry | None = None
        self._resting: RestingParts | None = None
        self._prepare_registration(template)
        self._regularise_pixels = self._registration is not None
        self._solver = self._new_solver()

    @property
    def mesh(self) -> Mesh:
        """The template as a mesh."""
        return Mesh(vertices=self.template.vertices_in_camera, faces=self.template.faces)

    @checks_kinds
    def step(self, normal_map: NormalMap, depth_map: DepthMap) -> TrackedFrame:
        """Follow the surface into the next frame."""
        require_same_size(normal_map.mask, "normals", self._previous.mask, "the frame before")
        require_same_size(depth_map.mask, "depth", normal_map.mask, "normals")
        self._steps += 1
        positions = self.state.positions_px
        moved: Points2 = advected_positions(positions, self._flow(normal_map))
        confidence = self.state.confidence
        if self._registration is not None:
            pyramid = slope_pyramid(normal_map, self.options.drift.levels)
            if self._steps % self.options.drift.every == 0:
                corrected = self._registration.register(moved, pyramid)
                moved, confidence = corrected.positions_px, corrected.confidence
            moved, reliable = self._carried(moved, confidence, normal_map, pyramid[0])
            if self._steps % self.options.drift.every == 0:  # else it is lowered already
                confidence = confidence * reliable
        self.state = self._regularised(moved, confidence, depth_map)
        self._previous, self._positions_before = normal_map, positions
        return self.state

    def resume(self, before: TrackedFrame, state: TrackedFrame, previous: NormalMap, steps: int) -> None:
        """Continue from the results of the last two frames, the last one's normals and the steps taken."""
        self.state, self._previous, self._steps = state, previous, steps
        self._positions_before, self._relief = before.positions_px, None

    def _flow(self, normal_map: NormalMap) -> Flow:
        """From the frame before, whose relief is still there."""
        options, relief = self.options.flow, None
        expected = flow_from_tracks(
            self._positions_before, self.state.positions_px, normal_map.shape, options
        )
        if options.method is not FlowMethod.NONE:
            before = bytes_from_normals(self._previous) if self._relief is None else self._relief
            self._relief = bytes_from_normals(normal_map)
            relief = before, self._relief
        return flow_between(self._previous, normal_map, options, expected, relief)

    def _regularised(
        self, moved: Points2, confidence: npt.NDArray[np.floating], depth_map: DepthMap
    ) -> TrackedFrame:
        before = self.state
        if self._regularise_pixels:
            moved = self._regularised_pixels(moved, confidence)
        depth = before.vertices_in_camera[:, 2]
        targets, found = targets_on_surface(moved, depth_map, self.camera, depth)
        confidence = np.clip(confidence * found, 0.0, 1.0)
        if self._extrapolation is not None:
            # what is not seen may lie before another surface: its depth is not that of the pixel it is in
            targets = self.camera.unproject(
                moved, self._extrapolation.carried_depth(targets[:, 2], confidence)
            )
        vertices = targets if self._regularise_pixels else self._regularised_vertices(targets)
        return tracked_frame(vertices, confidence, self.camera)

    def _carried(
        self,
        moved: Points2,
        confidence: npt.NDArray[np.floating],
        normal_map: NormalMap,
        slopes: npt.NDArray[np.float32],
    ) -> tuple[Points2, npt.NDArray[np.floating]]:
        """Move what is not seen to where what is seen, and the lengths on the surface, carry it.

        Returns also how far the result may be relied on: not where lengths have changed.
        """
        registration = self._registration
        if not (registration and self._extrapolation and self._isometry and self._resting):
            return moved, np.ones_like(confidence)
        around = registration.jacobians(moved)
        surely, reliably = self._isometry.plausibility(slopes, moved, around)
        seen = confidence * surely
        template, carried, rest = self.template.positions_px, moved, None
        for number in range(_CARRIES):
            if number > 0:
                rest = self._resting.shares(normal_map, carried)
            stretch = self._isometry.jacobians(slopes, carried, registration.jacobians(carried))
            carried = template + self._extrapolation.carried(moved - template, seen, stretch, rest)
        return carried, reliably

    def _regularised_pixels(self, moved: Points2, confidence: npt.NDArray[np.floating]) -> Points2:
        """The default: smooth the step in the image; depth is then read, not smoothed."""
        solver, before = self._solver, self.state.positions_px
        rest = self.template.positions_px if self.options.rest is RestShape.TEMPLATE else before
        if isinstance(solver, TranslationRegulariser):
            return np.asarray(before + solver.solve(moved - before))
        if not isinstance(solver, LaplacianRegulariser):
            return moved
        if self.options.confidence is Confidence.TEMPLATE:
            return np.asarray(rest + solver.solve_weighted(moved - rest, confidence))
        return np.asarray(rest + solver.solve(moved - rest))

    def _regularised_vertices(self, targets: Points) -> Points:
        """As published: smooth the vertices in space, depth included."""
        solver, before = self._solver, self.state.vertices_in_camera
        if isinstance(solver, TranslationRegulariser):
            return np.asarray(before + solver.solve(targets - before))
        if isinstance(solver, LaplacianRegulariser):
            template = self.template.vertices_in_camera
            rest = template if self.options.rest is RestShape.TEMPLATE else before
            return np.asarray(rest + solver.solve(targets - rest))
        if isinstance(solver, ArapRegulariser):
            return solver.solve(before, targets)
        return targets

    def _prepare_registration(self, normal_map: NormalMap) -> None:
        drift = self.options.drift
        if drift.correction is DriftCorrection.NONE or self.options.flow.method is FlowMethod.NONE:
            return
        lattice = lattice_on_template(self.template, drift.cell_px)
        pyramid = slope_pyramid(normal_map, drift.levels)
        self._registration = TemplateRegistration(self.template, lattice, pyramid, drift)
        if self.options.confidence is Confidence.CARRIED:
            self._extrapolation = Extrapolation(lattice, self.template, self.camera)
            self._isometry = Isometry(lattice, self.template, pyramid[0])
            self._resting = RestingParts(lattice, self.template, normal_map)

    def _new_solver(self) -> TranslationRegulariser | LaplacianRegulariser | ArapRegulariser | None:
        options, template = self.options, self.template
        count = len(template.pixels)
        if options.regulariser is Regulariser.TRANSLATION:
            return TranslationRegulariser(template.edges, count, options.data_share)
        if options.regulariser is Regulariser.ARAP:
            return ArapRegulariser(template, options.handle_spacing_px)
        if options.regulariser is Regulariser.NONE:
            return None
        beta = beta_from_smoothing_length(options.smoothing_length)
        laplacian, edges = _laplacian(template, options.laplacian)
        return LaplacianRegulariser(laplacian, edges, template.positions_px, beta)


def _laplacian(
    template: TrackingTemplate, kind: LaplacianKind
) -> tuple[sp.csr_array, npt.NDArray[np.integer]]:
    """L, and the edges it couples: a grid's for uniform weights, the triangles' for cotangents."""
    if kind is LaplacianKind.UNIFORM:
        return graph_laplacian(template.edges, len(template.pixels)), template.edges
    laplacian = cotangent_laplacian(template.vertices_in_camera, template.faces)
    upper = sp.coo_array(sp.triu(laplacian, k=1))
    return laplacian, np.stack([upper.row, upper.col], axis=1)

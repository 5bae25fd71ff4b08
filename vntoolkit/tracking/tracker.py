"""The tracker: one template through the frames, one step a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import Points, Points2, VisibilityLabels, read_only
from vntoolkit.checks import require_same_size
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh, cotangent_laplacian, graph_laplacian
from vntoolkit.options.tracking import Tracker, TrackingOptions
from vntoolkit.tracking.flow import (
    advected_positions,
    flow_between,
    flow_from_tracks,
    targets_on_surface,
)
from vntoolkit.tracking.paint import Paint
from vntoolkit.tracking.regularisers import (
    PAPERS_BETA,
    PAPERS_DATA_SHARE,
    ArapRegulariser,
    LaplacianRegulariser,
    TranslationRegulariser,
)
from vntoolkit.tracking.running_template import RunningTemplate
from vntoolkit.tracking.surface_fit import SurfaceFit
from vntoolkit.tracking.template import TrackingTemplate, template_from_maps

Solver = TranslationRegulariser | LaplacianRegulariser | ArapRegulariser


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackedFrame:
    """Where the template's vertices are.

    vertices_in_camera: (n, 3). positions_px: (n, 2) their pixels. uncertainty_px: (n,) the error to expect of
    them, pixels; None from methods that cannot tell.
    """

    vertices_in_camera: Points
    positions_px: Points2
    uncertainty_px: npt.NDArray[np.float32] | None = None


def tracked_frame(
    vertices_in_camera: Points, uncertainty_px: npt.NDArray[np.floating] | None, camera: Camera
) -> TrackedFrame:
    """Return a frame in the single precision that files hold.

    The state that tracking goes on from is then the one on disk, and a run that was interrupted ends in the
    same bytes as one that was not.
    """
    vertices = np.asarray(vertices_in_camera, dtype=np.float32)
    uncertainty = None if uncertainty_px is None else read_only(np.asarray(uncertainty_px, dtype=np.float32))
    return TrackedFrame(
        vertices_in_camera=read_only(vertices),
        positions_px=read_only(camera.project(vertices)),
        uncertainty_px=uncertainty,
    )


class SurfaceTracker:
    """Follows one template, frame by frame, forwards or backwards: `step` takes the next frame."""

    def __init__(
        self,
        template: NormalMap,
        depth: DepthMap,
        camera: Camera,
        options: TrackingOptions | None = None,
        seams: Sequence[Points2] = (),
        labels: VisibilityLabels | None = None,
        paint: Paint | None = None,
    ) -> None:
        """Cut the template along the seams and prepare what every frame solves.

        template, depth: maps of the template frame. seams: polylines (k, 2) in its pixels. labels: (h, w),
        bit k set where light k arrives; None where not known. paint: (h, w) by `paint_of_frame`; None to
        track by relief alone. Raises BadInput where no pixel is valid or a seam leaves the mask.
        """
        self.options = options or TrackingOptions()
        self.camera = camera
        self.template = template_from_maps(template, depth, camera, seams)
        self._fit: SurfaceFit | None = None
        self._solver: Solver | None = None
        uncertainty = None
        if self.options.method is Tracker.DEFAULT:
            self._fit = SurfaceFit(self.template, template, depth, camera, labels, paint)
            uncertainty = np.zeros(len(self.template.pixels))
        else:
            self._solver = _solver(self.template, self.options)
        self.state = tracked_frame(self.template.vertices_in_camera, uncertainty, camera)
        self._before, self._previous = self.state, template

    @property
    def mesh(self) -> Mesh:
        """The template as a mesh."""
        return Mesh(vertices=self.template.vertices_in_camera, faces=self.template.faces)

    def step(
        self,
        normal_map: NormalMap,
        depth_map: DepthMap,
        labels: VisibilityLabels | None = None,
        paint: Paint | None = None,
    ) -> TrackedFrame:
        """Follow the surface into the next frame; labels, paint: as of the template."""
        require_same_size(normal_map.mask, "normals", self._previous.mask, "the frame before")
        require_same_size(depth_map.mask, "depth", normal_map.mask, "normals")
        if self._fit is not None and self.state.uncertainty_px is not None:
            vertices, uncertainty = self._fit.fit(
                self._before.positions_px,
                self.state.positions_px,
                self.state.uncertainty_px,
                self._previous,
                normal_map,
                depth_map,
                labels,
                paint,
            )
        else:
            vertices, uncertainty = self._published_step(normal_map, depth_map), None
        self._before, self.state = self.state, tracked_frame(vertices, uncertainty, self.camera)
        self._previous = normal_map
        return self.state

    @property
    def running(self) -> RunningTemplate | None:
        """The running template after the frames so far; None for a published method."""
        return None if self._fit is None else self._fit.running

    def resume(
        self,
        before: TrackedFrame,
        state: TrackedFrame,
        previous: NormalMap,
        running: RunningTemplate | None = None,
    ) -> None:
        """Continue from the results of the last two frames, the last one's normals, and the running template.

        Without the last, nothing but the template is.
        """
        self._before, self.state, self._previous = before, state, previous
        if self._fit is not None:
            self._fit.reset(running)

    def _published_step(self, normal_map: NormalMap, depth_map: DepthMap) -> npt.NDArray[np.floating]:
        """Equations 5 and 6 (flow, and the surface where it leads), then a regulariser."""
        before = self.state
        moved = np.asarray(before.positions_px)
        if self.options.method is not Tracker.NO_REGISTRATION:
            expected = flow_from_tracks(self._before.positions_px, before.positions_px, normal_map.shape)
            moved = advected_positions(moved, flow_between(self._previous, normal_map, expected))
        targets, _ = targets_on_surface(moved, depth_map, self.camera, before.vertices_in_camera[:, 2])
        if self._solver is None:
            return targets
        if isinstance(self._solver, ArapRegulariser):
            return self._solver.solve(before.vertices_in_camera, targets)
        from_rest = self.options.method is Tracker.LAPLACIAN
        rest = (self.template if from_rest else before).vertices_in_camera
        return np.asarray(rest + self._solver.solve(targets - rest))


def _solver(template: TrackingTemplate, options: TrackingOptions) -> Solver | None:
    count = len(template.pixels)
    match options.method:
        case Tracker.TRANSLATION:
            return TranslationRegulariser(template.edges, count, PAPERS_DATA_SHARE)
        case Tracker.ARAP:
            return ArapRegulariser(template)
        case Tracker.LAPLACIAN | Tracker.LAPLACIAN_PREVIOUS:
            laplacian = graph_laplacian(template.edges, count)
        case Tracker.LAPLACIAN_COTANGENT:
            laplacian = cotangent_laplacian(template.vertices_in_camera, template.faces)
        case _:
            return None
    return LaplacianRegulariser(laplacian, PAPERS_BETA)

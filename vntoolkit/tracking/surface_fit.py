"""Where the template is in one frame: all that tells it, each with its information, solved for together.

The unknowns are the displacements of the nodes of a lattice. Relief, paint and the running template
(`registration`) and the outline (`outline`) are factors; the edges have a prior (`edge_prior`). They make one
linear least-squares problem a step, each with the inverse of its covariance, so that none acts where or in
what direction it knows nothing. The expected error is that of the same problem (`fit_errors`).
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points, Points2, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.tracking.edge_prior import EdgePrior, Prior
from vntoolkit.tracking.factors import Factor, full_of, total
from vntoolkit.tracking.fit_errors import FitErrors
from vntoolkit.tracking.flow import common_shift
from vntoolkit.tracking.lattice import NODES_BY_PASS, LocalJacobians, lattice_on_template
from vntoolkit.tracking.lattice_system import LatticeSystem
from vntoolkit.tracking.modes import modes_of_the_whole
from vntoolkit.tracking.outline import (
    Outline,
    contour_distance,
    depth_steps,
    edges_beside,
    occluding_contours,
    outline_of_silhouette,
)
from vntoolkit.tracking.paint import Paint, PaintImage, paint_image
from vntoolkit.tracking.registration import Registration, TemplateRegistration
from vntoolkit.tracking.running_template import RunningTemplate
from vntoolkit.tracking.slopes import Relief, Slopes, relief_slopes, sample_depth, slopes_from_normals
from vntoolkit.tracking.template import TrackingTemplate

_CELL_PX = 8  # of the lattice
_ITERATIONS = 3
_CONVERGED = 0.1  # steps by the expected error, after which no other follows
_LEAST_ERROR_PX = 0.3
_MOST = 0.9  # share of the vertices for which that holds: the rest is lost, or creeps
_EDGES_ALIKE = NODES_BY_PASS  # edges whose residuals are alike share what they tell
_LEAST_SINGULAR = 0.2  # of a Jacobian: steps are not taken through a surface seen more nearly edge-on
# Expected error over the root mean square of what is drawn: about nine in ten errors are then below it, as
# measured on a sweater, a head and a sheet. Were nothing wrong but what is drawn, 1.5 would do.
_COVERAGE = 2.2
_WELL_KNOWN = 0.9  # share of the motion, from which all of it goes on
_JUMPED = 0.05  # share of the figure that no motion of before uncovers in one frame
_LOST_MATCH = 0.5  # share of the expected match under which relief does not match
_HIDDEN = 0.25  # share hidden from which a depth is not that of the pixel that a vertex lies in
_TELLING = (0.2, 0.5)  # expected match from which a mismatch begins to tell that the surface is hidden …
_WARNING = (0.1, 0.3)  # … or that it is not known where it is: a vertex too many in doubt does less harm
_HALF_WAVE_PX = 8.0  # of the longest relief in the finest band: where that does not match, it is so far off


class _View(NamedTuple):
    """What a frame shows: slopes (h, w, 3), its outline (h, w, 4), relief (h, w, 4), paint (h, w, 2) or None,
    and contours within the figure (h, w).
    """

    slopes: Slopes
    outline: npt.NDArray[np.float32]
    relief: Relief
    paint: PaintImage | None
    contours: Mask


class _Measured(NamedTuple):
    """What is measured around positions (n, 2): around: (nodes, 4) their Jacobians. factors: in pixels of the
    frame: relief, paint, running template, outline. known: (nodes,) from 0 to 1, by registration.
    """

    positions_px: Points2
    around: npt.NDArray[np.float64]
    registration: Registration
    factors: tuple[Factor, ...]
    known: npt.NDArray[np.float64]


class SurfaceFit:
    """Fits one template to any frame, from where it was in the frame before."""

    def __init__(
        self,
        template: TrackingTemplate,
        normal_map: NormalMap,
        depth_map: DepthMap,
        camera: Camera,
        labels: VisibilityLabels | None = None,
        paint: Paint | None = None,
    ) -> None:
        """Prepare what hangs on the template alone; normal_map, depth_map, labels, paint: of its frame."""
        view = _view(normal_map, camera, labels, paint)
        contours = view.contours | depth_steps(depth_map, view.slopes, camera)
        within = replace(template, edges=edges_beside(template.edges, template.pixels, contours))
        lattice = lattice_on_template(within, _CELL_PX)
        self._lattice, self._camera = lattice, camera
        self._outline = Outline(template, lattice, view.outline)
        self._registration = TemplateRegistration(template, lattice, view.relief, view.paint)
        self._prior = EdgePrior(lattice, within, camera, view.slopes)
        self._jacobians = LocalJacobians(lattice, template.positions_px)
        self._system = LatticeSystem(self._prior.edges, lattice.count)
        self._errors = FitErrors(lattice, self._prior, self._registration.passes)
        self._template_depth = template.vertices_in_camera[:, 2]
        self.reset(None)

    def reset(self, running: RunningTemplate | None) -> None:
        """Go on with the running template of an earlier frame; None for the template alone."""
        self.running = (
            self._registration.running_template(len(self._prior.edges)) if running is None else running
        )

    def fit(
        self,
        before_px: Points2,
        last_px: Points2,
        expected_px: FloatArray,
        previous: NormalMap,
        normal_map: NormalMap,
        depth_map: DepthMap,
        labels: VisibilityLabels | None = None,
        paint: Paint | None = None,
    ) -> tuple[Points, npt.NDArray[np.float64]]:
        """Fit to a frame, first from where the motion goes on to; return vertices and expected errors.

        Vertices (n, 3) are in the camera frame, expected errors (n,) in pixels.
        before_px, last_px: (n, 2) in the last two frames. expected_px: (n,) the last one's expected error.
        previous: its normals. paint: None where the frame's is not known.
        """
        view = _view(normal_map, self._camera, labels, paint)
        measured = self._predicted(before_px, last_px, previous, normal_map, view)
        positions = measured.positions_px
        enough = _CONVERGED * np.maximum(expected_px, _LEAST_ERROR_PX)
        for number in range(_ITERATIONS):
            if number > 0:
                measured = self._measured(positions, view, measured.registration.correlated)
            prior = self._prior_at(measured, view, depth_map)
            steps = prior.steps - self._prior.steps(positions)
            modes = modes_of_the_whole(prior.steps, self._prior.middles)
            solution = self._system.solve(
                total(measured.factors), 1.0 / (_EDGES_ALIKE * prior.variance), steps, *modes
            )
            moved = self._lattice.at_vertices(solution.displacement)
            positions = positions + moved
            if np.mean(np.maximum(*np.abs(moved.T)) < enough) > _MOST:
                break
        residuals = solution.left + self.running.residuals
        square, known = self._errors.expected(
            solution, measured.factors, np.sqrt(prior.variance), residuals, prior.shared
        )
        observable = self._prior.observable(measured.known)
        hidden = self._mismatched(measured.registration, _TELLING)
        running = self.running.with_frame(measured.registration.comparison)
        self.running = running.with_residuals(residuals, known, observable)
        vertices = self._camera.unproject(positions, self._depth(positions, depth_map, hidden))
        return vertices, self._uncertainty(square, measured)

    def _predicted(
        self, before_px: Points2, last_px: Points2, previous: NormalMap, normal_map: NormalMap, view: _View
    ) -> _Measured:
        """Measure where the motion goes on to; where that leaves figure or relief, where one shift leads.

        The motion goes on as far as it is known (a Wiener filter): where next to nothing tells where the
        surface is, it would drift off by the errors of its own motion.
        """
        last = np.asarray(last_px, dtype=np.float64)
        motion = last - before_px
        first = self._measured(last + motion, view)
        square = float(np.square(motion).sum(axis=1).mean())
        known = square / (square + 2.0 * self._error_of_all(first.factors))
        if known < _WELL_KNOWN:
            first = self._measured(last + known * motion, view)
        misfit, registered = _misfit(first.positions_px, normal_map.mask), first.registration
        is_off = misfit > _misfit(last, previous.mask) + _JUMPED
        is_lost = registered.match.sum() < _LOST_MATCH * registered.expected.sum()
        if not (is_off or is_lost):
            return first
        shifted = self._measured(last + common_shift(previous, normal_map), view)
        fits = _misfit(shifted.positions_px, normal_map.mask) < misfit - _JUMPED
        matches = shifted.registration.match.sum() > registered.match.sum()
        return (
            shifted if matches or (is_lost and fits) else first
        )  # an outline changes where a part is hidden

    def _measured(
        self, positions_px: Points2, view: _View, correlated: tuple[FloatArray, ...] = ()
    ) -> _Measured:
        """Measure around positions (n, 2) in a frame; correlated: of its noise, where that is known."""
        around = self._jacobians.of(positions_px)
        inverse = _inverse(around)
        registered = self._registration.measure(
            positions_px, around, view.relief, view.paint, self.running, correlated
        )
        *by_window, running = (each.in_frame(inverse) for each in registered.factors)
        running = running._replace(shared_px=_HALF_WAVE_PX * self._mismatched(registered, _WARNING))
        window_factors = (*by_window, running)
        a, _, c = total(window_factors).information.T
        return _Measured(
            positions_px=positions_px,
            around=around,
            registration=registered,
            factors=(*window_factors, self._outline.measure(positions_px, inverse, view.outline)),
            known=np.minimum(1.0, a + c),
        )

    def _prior_at(self, measured: _Measured, view: _View, depth_map: DepthMap) -> Prior:
        """Return the prior of the edges there, and beside it what was left of it in the frame before."""
        prior = self._prior.at(
            measured.positions_px,
            measured.around,
            view.slopes,
            depth_map,
            measured.known,
        )
        return prior._replace(steps=prior.steps + self.running.residuals)

    def _mismatched(self, registered: Registration, telling: tuple[float, float]) -> npt.NDArray[np.float64]:
        """(nodes,) from 0 to 1: relief that should match and does not."""
        low, high = telling
        counted = np.clip((registered.expected - low) / (high - low), 0.0, 1.0)
        missing = np.clip(
            1.0 - registered.match / (_LOST_MATCH * np.maximum(registered.expected, low)), 0.0, 1.0
        )
        sums = self._lattice.smoothed(np.column_stack([counted * missing, np.ones(len(missing))]), 1)
        return np.asarray(sums[:, 0] / sums[:, 1])

    def _depth(self, positions: Points2, depth_map: DepthMap, hidden: FloatArray) -> npt.NDArray[np.float64]:
        """(n,) read from the frame; what is hidden is carried along by what is seen around it."""
        depth, found = sample_depth(depth_map.depth, depth_map.mask, positions)
        unseen = self._lattice.at_vertices(hidden[:, None])[:, 0] / _HIDDEN
        seen = found * np.clip(1.0 - unseen, 0.0, 1.0)
        if seen.min() >= 1.0:
            return np.asarray(depth)
        offset = np.where(found, depth - self._template_depth, 0.0)
        sums = self._lattice.sums(np.column_stack([seen, seen * offset]))
        filled = self._system.filled(sums[:, 0], sums[:, 1:])
        return np.asarray(
            self._template_depth + seen * offset + (1.0 - seen) * self._lattice.at_vertices(filled)[:, 0]
        )

    def _error_of_all(self, factors: tuple[Factor, ...]) -> float:
        """Squared error of one shift of all, by what all nodes know together."""
        least = np.eye(2) / float(self._camera.width**2 + self._camera.height**2)
        return float(np.trace(np.linalg.inv(full_of(total(factors).information).sum(axis=0) + least)))

    def _uncertainty(self, square: FloatArray, measured: _Measured) -> npt.NDArray[np.float64]:
        """(n,) what about nine in ten errors are below; square: (nodes,) of the fit.

        No part knows better than all together do of one shift. What is only foreseen, and looks otherwise
        there, is within half a wave: nine in ten, no spread.
        """
        half_wave_px = measured.factors[-2].shared_px
        square = square + self._error_of_all(measured.factors)
        square = square + (1.0 - measured.known) * (half_wave_px / _COVERAGE) ** 2
        sums = self._lattice.smoothed(np.column_stack([square, np.ones(len(square))]), 1)
        root = _COVERAGE * np.sqrt(sums[:, :1] / sums[:, 1:])
        return self._lattice.at_vertices(root)[:, 0]


def _view(
    normal_map: NormalMap, camera: Camera, labels: VisibilityLabels | None, paint: Paint | None
) -> _View:
    slopes = slopes_from_normals(normal_map, camera)
    outline = outline_of_silhouette(normal_map.mask, slopes)
    contours = occluding_contours(slopes, normal_map.mask)
    relief = relief_slopes(slopes, normal_map, labels, contour_distance(outline), contours)
    return _View(slopes, outline, relief, None if paint is None else paint_image(paint, relief), contours)


def _misfit(positions_px: Points2, mask: Mask) -> float:
    """Share of the figure's cells that no vertex covers, and of cells off it that one does."""
    height, width = (n // _CELL_PX for n in mask.shape)
    u, v = np.floor(positions_px / _CELL_PX).astype(np.int64).T
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    covered: Mask = np.zeros((height, width), np.bool_)
    covered[v[inside], u[inside]] = True
    middle = _CELL_PX // 2
    silhouette = mask[middle::_CELL_PX, middle::_CELL_PX][:height, :width]
    return float(np.count_nonzero(covered != silhouette) / max(int(np.count_nonzero(silhouette)), 1))


def _inverse(around: FloatArray) -> npt.NDArray[np.float64]:
    """Inverse (m, 2, 2) of Jacobians (m, 4), bounded where they are nearly singular."""
    a, b, c, d = around.T
    determinant = a * d - b * c
    bounded = np.where(determinant < 0, -1.0, 1.0) * np.maximum(np.abs(determinant), _LEAST_SINGULAR)
    return np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2) / bounded[:, None, None]

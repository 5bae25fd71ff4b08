"""Where the template is in one frame: all that tells it, each with its information, solved for together.

The unknowns are the displacements of the nodes of a lattice. Relief, shape and paint (`registration`), the
outline (`outline`) and lengths on the surface (`lengths`) enter one linear least-squares problem a step, each
with the inverse of its covariance, so that none acts where or in what direction it knows nothing. The
expected error is that of the same problem (`fit_errors`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask, Points2, VisibilityLabels
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.native import njit
from vntoolkit.tracking.body_motion import LINKS_ALIKE, FittedField
from vntoolkit.tracking.covering import Covering
from vntoolkit.tracking.fit_errors import FitErrors
from vntoolkit.tracking.flow import common_shift, dense_flow
from vntoolkit.tracking.guess_errors import usual_errors
from vntoolkit.tracking.lattice import LocalJacobians, lattice_on_template
from vntoolkit.tracking.lattice_system import LatticeSystem
from vntoolkit.tracking.lengths import LinkLengths, modes_of_the_whole
from vntoolkit.tracking.outline import (
    Outline,
    contour_distance,
    depth_steps,
    edges_beside,
    occluding_contours,
    outline_of_figure,
)
from vntoolkit.tracking.paint import Paint, PaintImage, paint_image
from vntoolkit.tracking.registration import Measurement, TemplateRegistration, WindowSteps
from vntoolkit.tracking.remembered import Remembered
from vntoolkit.tracking.slopes import (
    Relief,
    Slopes,
    relief_slopes,
    sample_depth,
    sample_image,
    slopes_from_normals,
)
from vntoolkit.tracking.template import TrackingTemplate

_CELL_PX = 8  # of the lattice
_ITERATIONS = 3
_CONVERGED = 0.1  # steps by the expected error, after which no other follows
_LEAST_ERROR_PX = 0.3
_MOST = 0.9  # share of the vertices for which that holds: the rest is lost, or creeps
# Departure of links at which they hold half as much. Where they err together it is shared by so many; at a
# likely contour, which few of them cross, each gives way alone.
_TORN_SIGMAS = 3.0
_LEAST_SINGULAR = 0.2  # of a Jacobian: steps are not taken through a surface seen more nearly edge-on
# Expected error over the root mean square of what is drawn: about nine in ten errors are then below it, as
# measured on a sweater, a head and a sheet. Were nothing wrong but what is drawn, 1.5 would do.
_COVERAGE = 2.2
_ERROR_PASSES = 1  # of lattice smoothing of the samples' variance
_WELL_KNOWN = 0.9  # share of the motion, from which all of it goes on
_JUMPED = 0.05  # share of the figure that no motion of before uncovers in one frame
_LOST_MATCH = 0.5  # share of the expected match under which another start is tried
_BETTER_MATCH = 0.1  # by which that must match better
_HIDDEN = 0.25  # share hidden from which a depth is not that of the pixel that a vertex lies in
_TELLING = (0.2, 0.5)  # expected match from which a mismatch begins to tell that the surface is hidden …
_WARNING = (0.1, 0.3)  # … or that it is not known where it is: a vertex too many in doubt does less harm
_HALF_WAVE_PX = 8.0  # of the longest relief in the finest band: where that does not match, it is so far off


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedFrame:
    """positions_px: (n, 2). depth: (n,). uncertainty_px: (n,) the expected error, pixels."""

    positions_px: Points2
    depth: npt.NDArray[np.float64]
    uncertainty_px: npt.NDArray[np.float64]


class Seen(NamedTuple):
    """relief: (h, w, 4) and paint: (h, w, 2), or None, of a frame: what registers it."""

    relief: Relief
    paint: PaintImage | None


class SurfaceFit:
    """Fits one template to any frame, from where it was in the frame before."""

    def __init__(
        self,
        template: TrackingTemplate,
        normal_map: NormalMap,
        depth_map: DepthMap,
        camera: Camera,
        labels: VisibilityLabels | None = None,
        pattern: Sequence[FloatArray] = (),
        paint: Paint | None = None,
        paint_pattern: Sequence[FloatArray] = (),
    ) -> None:
        """Prepare what hangs on the template alone; normal_map, depth_map, labels, paint: of its frame.

        pattern, paint_pattern: as `fixed_pattern` returns them.
        """
        slopes = slopes_from_normals(normal_map, camera)
        figure, seen, contours = _seen(slopes, normal_map, labels, paint)
        contours |= depth_steps(depth_map, slopes, camera)
        within = replace(template, edges=edges_beside(template.edges, template.pixels, contours))
        lattice = lattice_on_template(within, _CELL_PX)
        self._lattice, self._camera = lattice, camera
        self._outline = Outline(template, lattice, figure)
        self._registration = TemplateRegistration(
            template, lattice, camera, seen.relief, pattern, seen.paint, paint_pattern
        )
        self._lengths = LinkLengths(lattice, within, camera, slopes)
        self._covering = Covering(lattice, camera)
        self._jacobians = LocalJacobians(lattice, template.positions_px)
        self._system = LatticeSystem(self._lengths.links, lattice.count)
        self.remember(None)
        self._errors = FitErrors(lattice, self._registration, self._lengths)
        self._template_depth = template.vertices_in_camera[:, 2]

    def remember(self, remembered: Remembered | None) -> None:
        """Go on with what was remembered after an earlier frame; None for the template alone."""
        if remembered is None:
            remembered = self._registration.remembered(usual_errors(len(self._lengths.links)))
        self.remembered = remembered

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
    ) -> FittedFrame:
        """Fit to a frame, first from where the motion goes on to.

        before_px, last_px: (n, 2) in the last two frames. expected_px: (n,) the last one's expected error.
        previous: its normals. paint: None where the frame's is not known.
        """
        lattice, lengths = self._lattice, self._lengths
        slopes = slopes_from_normals(normal_map, self._camera)
        figure, seen, _ = _seen(slopes, normal_map, labels, paint)
        last = np.asarray(last_px, dtype=np.float64)
        positions: Points2 = 2.0 * last - before_px
        misfit = _misfit(positions, normal_map.mask)
        if misfit > _misfit(last, previous.mask) + _JUMPED:
            shifted = last + common_shift(previous, normal_map)
            if _misfit(shifted, normal_map.mask) < misfit - _JUMPED:
                positions = shifted
        around = self._jacobians.of(positions)
        measurement = self._measured(positions, around, seen)
        known = self._known_share(positions, positions - last, around, measurement, figure)
        if known < _WELL_KNOWN:
            positions = last + known * (positions - last)
            around = self._jacobians.of(positions)
            measurement = self._measured(positions, around, seen)
        matched = min(np.sum(measurement.found), np.sum(measurement.match))
        if matched < _LOST_MATCH * np.sum(measurement.expected):
            positions, measurement = self._restarted(
                positions, last_px, measurement, previous, normal_map, seen
            )
        lost = measurement.match < _LOST_MATCH * measurement.expected
        if lost.any() and not lost.all():
            positions, measurement = self._found_again(positions, around, measurement, lost, seen)
        around = self._jacobians.of(positions)
        expected, errors = self.remembered.departures, self.remembered.guess_errors
        errors_around = lengths.around(errors)
        enough = _CONVERGED * np.maximum(expected_px, _LEAST_ERROR_PX)
        field: FittedField | None = None
        for number in range(_ITERATIONS):
            if number > 0:
                around = self._jacobians.of(positions)
                measurement = self._measured(positions, around, seen, measurement)
            hidden = self._mismatched(measurement, _TELLING)
            inverse = _inverse(around)
            information = _congruent(measurement.information, inverse)
            pull = np.einsum("nji,nj->ni", inverse, measurement.pull)
            outline, outline_pull = self._outline.measure(positions, inverse, figure)
            measured = np.minimum(1.0, information[:, 0] + information[:, 2])
            behind = hidden * self._covering.of(positions, measurement.match)
            guess = lengths.guessed(
                positions, around, slopes, depth_map, hidden, behind, measured, errors_around, field
            )
            field = guess.field
            steps = guess.steps + expected - lengths.steps(positions)
            alone = guess.torn + (1.0 - guess.torn) / LINKS_ALIKE
            variance = guess.variance + alone * np.sum(steps**2, axis=1) / _TORN_SIGMAS**2
            weight = 1.0 / (LINKS_ALIKE * variance)
            modes, precision = modes_of_the_whole(guess.steps, guess.away_px, lengths.middles)
            solution = self._system.solve(
                information + outline, pull + outline_pull, weight, steps, modes, precision
            )
            measured_at, step = positions, lattice.at_vertices(solution.displacement)
            positions = positions + step
            if np.mean(np.maximum(*np.abs(step.T)) < enough) > _MOST:
                break
        departures, tested = solution.left + expected, lengths.tested(hidden, measured)
        *measured_by, by_memory = _in_frame(measurement.windows, inverse)
        by_memory = replace(by_memory, slide_px=_HALF_WAVE_PX * self._mismatched(measurement, _WARNING))
        windows = [*measured_by, by_memory]
        square, told = self._errors.expected(
            solution, windows, outline, np.sqrt(variance), departures, guess.doubt
        )
        self.remembered = self._registration.mixed_in(self.remembered, measurement, measured_at).with_guesses(
            lengths.learnt(errors, guess, positions, told), departures, told, tested
        )
        square += self._of_the_whole(information + outline)
        # What is only guessed, and looks otherwise there, is within half a wave: nine in ten, no spread.
        square += (1.0 - measured) * (by_memory.slide_px / _COVERAGE) ** 2
        return FittedFrame(
            positions_px=positions,
            depth=self._depth(positions, depth_map, hidden),
            uncertainty_px=self._uncertainty(square),
        )

    def _measured(
        self, positions: Points2, around: FloatArray, seen: Seen, near: Measurement | None = None
    ) -> Measurement:
        return self._registration.measure(positions, around, *seen, near=near, remembered=self.remembered)

    def _restarted(
        self,
        positions: Points2,
        last_px: Points2,
        measurement: Measurement,
        previous: NormalMap,
        normal_map: NormalMap,
        seen: Seen,
    ) -> tuple[npt.NDArray[np.float64], Measurement]:
        """Where DIS flow (`kroeger2016`) leads, as far as the template matches better there."""
        flow = dense_flow(previous, normal_map)
        flown = last_px + sample_image(flow, last_px)
        return self._where_better(positions, self._lengths.nodes(flown - positions), measurement, seen)

    def _found_again(
        self,
        positions: Points2,
        around: FloatArray,
        measurement: Measurement,
        lost: npt.NDArray[np.bool_],
        seen: Seen,
    ) -> tuple[npt.NDArray[np.float64], Measurement]:
        """Where a search finds what is lost, as far as it matches better there.

        What is off by more than a wave of its relief, comes back into the mask, or from behind something, may
        lie farther off than one step of the finest band reaches.
        """
        shift, sure = self._registration.searched(measurement, lost)
        if not sure.any():
            return np.asarray(positions), measurement
        jacobian = around.reshape(-1, 2, 2)
        found = np.einsum("nij,nj->ni", jacobian, np.where(sure[:, None], shift, 0.0))
        return self._where_better(positions, found, measurement, seen)

    def _where_better(
        self, positions: Points2, at_nodes: FloatArray, measurement: Measurement, seen: Seen
    ) -> tuple[npt.NDArray[np.float64], Measurement]:
        """Positions moved by at_nodes (m, 2) where that matches better, and what is measured there."""
        lattice = self._lattice
        moved = positions + lattice.at_vertices(at_nodes)
        there = self._measured(moved, self._jacobians.of(moved), seen)
        better = np.maximum(there.found - measurement.found, there.match - measurement.match) > _BETTER_MATCH
        if not better.any():
            return np.asarray(positions), measurement
        return positions + lattice.at_vertices(np.where(better[:, None], at_nodes, 0.0)), measurement.where(
            better, there
        )

    def _known_share(
        self,
        positions: Points2,
        motion: Points2,
        around: FloatArray,
        measurement: Measurement,
        figure: FloatArray,
    ) -> float:
        """How far the motion so far may go on, 0 to 1: a Wiener filter, by what is known of the whole.

        Where next to nothing tells where the surface is, it would drift off by the errors of its own motion.
        """
        inverse = _inverse(around)
        information = _congruent(measurement.information, inverse)
        square = float(np.square(motion).sum(axis=1).mean())
        known = square / (square + 2.0 * self._of_the_whole(information))
        if known < _WELL_KNOWN:
            outline, _ = self._outline.measure(positions, inverse, figure)
            known = square / (square + 2.0 * self._of_the_whole(information + outline))
        return known

    def _of_the_whole(self, information: FloatArray) -> float:
        """Squared error of one shift of all, by what all nodes (m, 3) know together: no part knows better."""
        least = np.eye(2) / float(self._camera.width**2 + self._camera.height**2)
        return float(np.trace(np.linalg.inv(_full(information).sum(axis=0) + least)))

    def _mismatched(self, measurement: Measurement, telling: tuple[float, float]) -> npt.NDArray[np.float64]:
        """(nodes,) from 0 to 1: relief that should match and does not."""
        low, high = telling
        counted = np.clip((measurement.expected - low) / (high - low), 0.0, 1.0)
        missing = np.clip(
            1.0 - measurement.match / (_LOST_MATCH * np.maximum(measurement.expected, low)), 0.0, 1.0
        )
        sums = self._lattice.smoothed(np.column_stack([counted * missing, np.ones(len(missing))]), 1)
        return np.asarray(sums[:, 0] / sums[:, 1])

    def _depth(self, positions: Points2, depth_map: DepthMap, hidden: FloatArray) -> npt.NDArray[np.float64]:
        """(n,) read from the frame; what is hidden is carried along by what is seen around it."""
        depth, found = sample_depth(depth_map.depth, depth_map.mask, positions)
        doubt = self._lattice.at_vertices(hidden[:, None])[:, 0] / _HIDDEN
        seen = found * np.clip(1.0 - doubt, 0.0, 1.0)
        if seen.min() >= 1.0:
            return np.asarray(depth)
        offset = np.where(found, depth - self._template_depth, 0.0)
        sums = self._lattice.sums(np.column_stack([seen, seen * offset]))
        filled = self._system.filled(sums[:, 0], sums[:, 1:])
        return np.asarray(
            self._template_depth + seen * offset + (1.0 - seen) * self._lattice.at_vertices(filled)[:, 0]
        )

    def _uncertainty(self, square: FloatArray) -> npt.NDArray[np.float64]:
        """(n,) what about nine in ten errors are below, of nodes' expected squares (m,)."""
        sums = self._lattice.smoothed(np.column_stack([square, np.ones(len(square))]), _ERROR_PASSES)
        root = _COVERAGE * np.sqrt(sums[:, :1] / sums[:, 1:])
        return self._lattice.at_vertices(root)[:, 0]


def _seen(
    slopes: Slopes, normal_map: NormalMap, labels: VisibilityLabels | None, paint: Paint | None
) -> tuple[npt.NDArray[np.float32], Seen, Mask]:
    """Return a frame's outline (h, w, 4), what registers it, and the contours within its figure (h, w)."""
    figure = outline_of_figure(normal_map.mask, slopes)
    contours = occluding_contours(slopes, normal_map.mask)
    relief = relief_slopes(slopes, normal_map, labels, contour_distance(figure), contours)
    painted = None if paint is None else paint_image(paint, relief)
    return figure, Seen(relief=relief, paint=painted), contours


def _misfit(positions_px: Points2, mask: Mask) -> float:
    """Share of the figure's cells that no vertex covers, and of cells off it that one does."""
    height, width = (n // _CELL_PX for n in mask.shape)
    covered: Mask = np.zeros((height, width), np.bool_)
    _cover(positions_px, covered)
    middle = _CELL_PX // 2
    figure = mask[middle::_CELL_PX, middle::_CELL_PX][:height, :width]
    return float(np.count_nonzero(covered != figure) / max(int(np.count_nonzero(figure)), 1))


@njit(cache=True)
def _cover(positions_px, covered):  # type: ignore[no-untyped-def]
    """Set the cells of positions (n, 2) to True, in (h, w) of cells."""
    height, width = covered.shape
    for i in range(len(positions_px)):
        u, v = np.floor(positions_px[i, 0] / _CELL_PX), np.floor(positions_px[i, 1] / _CELL_PX)
        if 0 <= u < width and 0 <= v < height:
            covered[int(v), int(u)] = True


def _in_frame(windows: tuple[WindowSteps, ...], inverse: FloatArray) -> list[WindowSteps]:
    """Return what windows know, in pixels of the frame; inverse: (m, 2, 2) J⁻¹."""
    return [replace(each, information=_congruent(each.information, inverse)) for each in windows]


def _inverse(around: FloatArray) -> npt.NDArray[np.float64]:
    """Inverse (m, 2, 2) of Jacobians (m, 4), bounded where they are nearly singular."""
    a, b, c, d = around.T
    determinant = a * d - b * c
    bounded = np.where(determinant < 0, -1.0, 1.0) * np.maximum(np.abs(determinant), _LEAST_SINGULAR)
    return np.stack([d, -b, -c, a], axis=1).reshape(-1, 2, 2) / bounded[:, None, None]


def _congruent(information: FloatArray, inverse: FloatArray) -> npt.NDArray[np.float64]:
    """J⁻ᵀ I J⁻¹ (m, 3) of information (m, 3) and J⁻¹ (m, 2, 2): in pixels of the frame."""
    full = np.swapaxes(inverse, 1, 2) @ _full(information) @ inverse
    return np.stack([full[:, 0, 0], full[:, 0, 1], full[:, 1, 1]], axis=1)


def _full(information: FloatArray) -> npt.NDArray[np.float64]:
    """(m, 2, 2) of (m, 3)."""
    return np.asarray(information[:, [0, 1, 1, 2]].reshape(-1, 2, 2))

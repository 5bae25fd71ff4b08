"""The report's part on simulated footage: how far the result is from what was true."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.evaluation.angular_error import angular_error_map
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.pipeline import truth_comparison
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report import page, pictures
from vntoolkit.report.mesh_views import View, picture_of

_STRIP_PX = 340
_VIEWS_DEG = (-50.0, -20.0, 20.0, 50.0)
_VIEW_PX = 320


def truth_section(result: OpenedResult, simulated: Path) -> page.PageSection:
    """Return numbers and pictures of a result against the folder that `simulate` wrote."""
    frames = list(truth_comparison.compare_with_truth(result, simulated))
    middle = result.numbers[len(result.numbers) // 2]
    lights = truth_comparison.light_errors_deg(result.rig.response, simulated)
    return page.PageSection(
        title="Against the truth",
        paragraphs=(
            "The footage was simulated, so the true normals and depth of every frame are known; the "
            "calibration saw only the footage of the board. A depth map of a perspective camera leaves one "
            "factor free; it is set by the median before depths are compared.",
        ),
        numbers=(*_numbers(frames), _light_number(lights)),
        figures=(
            _strip(result, simulated, middle),
            *_relief_figure(result, simulated, middle),
            *_mesh_figure(result, middle),
            _cumulative_figure(result, simulated, middle),
        ),
        tables=(_table(frames),),
    )


def _numbers(frames: Sequence[truth_comparison.FrameComparison]) -> tuple[page.PageNumber, ...]:
    median = float(np.median([frame.normals.median_deg for frame in frames]))
    mean = float(np.mean([frame.normals.mean_deg for frame in frames]))
    numbers = [
        page.PageNumber(value=f"{median:.2f}°", label="median normal error"),
        page.PageNumber(value=f"{mean:.2f}°", label="mean normal error"),
    ]
    depths = [frame.depth for frame in frames if frame.depth is not None]
    if depths:
        error_mm = 1000 * float(np.mean([depth.mean for depth in depths]))
        percent = float(np.mean([depth.mean_percent for depth in depths]))
        remark = f"{percent:.2f} % of the diagonal"
        numbers.append(page.PageNumber(value=f"{error_mm:.1f} mm", label="mean depth error", remark=remark))
    return tuple(numbers)


def _light_number(errors_deg: FloatArray) -> page.PageNumber:
    return page.PageNumber(
        value=f"{errors_deg.max():.2f}°", label="worst row of M", remark="its angle to the true M's"
    )


def _strip(result: OpenedResult, simulated: Path, number: int) -> page.PageFigure:
    measured, truth = result.normals(number), truth_comparison.true_normals(simulated, number)
    errors, both = angular_error_map(measured, truth)
    shown = [
        pictures.picture_of_normals(measured),
        pictures.picture_of_normals(truth),
        pictures.picture_of_errors(errors, both, pictures.NORMAL_ERRORS),
    ]
    cut = pictures.cropped(shown, measured.mask | truth.mask)
    row = dict(zip(("normals found", "true normals", "angle between them"), cut, strict=True))
    caption = f"Frame {number}: the normals against the true ones; brighter is worse, white was not compared."
    pixels = pictures.tiled([row], scale=pictures.NORMAL_ERRORS, height_px=_STRIP_PX)
    return page.figure_from_pixels(pixels, caption, suffix=".webp", wide=True)


def _relief_figure(result: OpenedResult, simulated: Path, number: int) -> tuple[page.PageFigure, ...]:
    depth = result.depth(number)
    if depth is None:
        return ()
    truth = truth_comparison.true_depth(simulated, number)
    shown = [pictures.picture_of_depth(depth, result.camera), pictures.picture_of_depth(truth, result.camera)]
    row = dict(
        zip(("relief found", "true relief"), pictures.cropped(shown, depth.mask | truth.mask), strict=True)
    )
    caption = f"Frame {number}: the surfaces through the depths, lit from the upper left."
    return (
        page.figure_from_pixels(
            pictures.tiled([row], height_px=_STRIP_PX), caption, suffix=".webp", wide=True
        ),
    )


def _mesh_figure(result: OpenedResult, number: int) -> tuple[page.PageFigure, ...]:
    mesh = result.mesh(number)
    if mesh is None:
        return ()
    row = {f"from {angle:+.0f}°": _seen_from(mesh, angle) for angle in _VIEWS_DEG}
    caption = f"Frame {number}: the mesh as the camera never saw it; angles around the upright axis."
    return (page.figure_from_pixels(pictures.tiled([row]), caption, suffix=".webp", wide=True),)


def _cumulative_figure(result: OpenedResult, simulated: Path, number: int) -> page.PageFigure:
    measured = result.normals(number)
    errors, both = angular_error_map(measured, truth_comparison.true_normals(simulated, number))
    angles = np.sort(errors[both])
    shares = np.linspace(0, 100, len(angles))
    thinned = np.unique(np.linspace(0, len(angles) - 1, 400).astype(int))
    with pictures.new_axes(5.2, 2.6) as axes:
        axes.plot(angles[thinned], shares[thinned], color=pictures.BLUE)
        for limit in (5, 10, 20):
            axes.axvline(limit, color=pictures.FAINT, lw=0.8, ls=":")
        axes.set(
            xlim=(0, pictures.NORMAL_ERRORS.most),
            ylim=(0, 101),
            xlabel="angle to the true normal, degrees",
            ylabel="pixels below it, %",
        )
    return page.figure_from_plot(axes.figure, f"Frame {number}: share of pixels below each error.")


def _table(frames: Sequence[truth_comparison.FrameComparison]) -> page.PageTable:
    rows = []
    for frame in frames:
        angles, depth = frame.normals, frame.depth
        shares = (angles.below_5, angles.below_10, angles.below_20)
        rows.append(
            (
                str(frame.number),
                f"{angles.median_deg:.2f}",
                f"{angles.mean_deg:.2f}",
                *(f"{100 * share:.1f}" for share in shares),
                "" if depth is None else f"{1000 * depth.mean:.2f}",
                "" if depth is None else f"{depth.mean_percent:.2f}",
            )
        )
    return page.PageTable(
        headings=(
            "frame",
            "median °",
            "mean °",
            "% below 5°",
            "below 10°",
            "below 20°",
            "depth mm",
            "% of diagonal",
        ),
        rows=tuple(rows),
        folded="every frame",
        right=tuple(range(1, 8)),
    )


def _seen_from(mesh: Mesh, azimuth_deg: float) -> pictures.Picture:
    """Plain plaster: the captured colours would hide the shape."""
    view = View.around(mesh, _VIEW_PX, _VIEW_PX, azimuth_deg=azimuth_deg, elevation_deg=8.0)
    return picture_of([replace(mesh, colours=None)], view)

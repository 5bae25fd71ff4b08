"""The report's part on the rig: how well M was fitted, and which normals it was fitted to."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report.page import PageFigure, PageNumber, PageSection, PageTable, figure_from_plot
from vntoolkit.report.style import BLUE, FAINT, INK, new_figure, report_style

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Bounds between good, fair and poor, by experience with simulated captures; they only colour the numbers.
_RESIDUAL_DEG = (2.0, 5.0)
_CONDITION = (10.0, 30.0)
_CONE_DEG = (35.0, 20.0)
_HISTOGRAM_CELLS = 60
_LARGEST_SAMPLE = 200_000


def calibration_section(result: OpenedResult, sample: int) -> PageSection:
    """Return the section; `sample`: the frame whose normals are set against the calibrated cone."""
    return PageSection(
        title="Calibration",
        paragraphs=(
            "Colour is M times the normal plus ambient light. A small residual says that one M explains the "
            "calibration footage; the condition number, how much a colour error grows on its way to a normal "
            "(1 is best); the cone, how far the calibration normals leaned to the sides.",
        ),
        numbers=_numbers(result),
        figures=(_cone_figure(result, sample), _response_figure(result)),
        tables=(_source_table(result),) if result.rig.sources else (),
    )


def _numbers(result: OpenedResult) -> tuple[PageNumber, ...]:
    quality, response = result.rig.quality, result.rig.response
    condition = PageNumber(
        value=f"{response.condition_number:.1f}",
        label="condition number of M",
        grade=graded(response.condition_number, _CONDITION),
        remark="set by the lights' directions and colours",
    )
    if quality is None or quality.samples == 0:
        method = "stated" if quality is None else quality.method
        known = PageNumber(
            value="not fitted", label=f"method: {method}", remark="lights known, no residual or cone"
        )
        return (condition, known)
    return (
        PageNumber(
            value=f"{quality.residual_deg:.2f}°",
            label="median residual",
            grade=graded(quality.residual_deg, _RESIDUAL_DEG),
            remark=f"over {quality.samples:,} pairs of colour and normal, by {quality.method}",
        ),
        condition,
        PageNumber(
            value=f"{quality.cone_deg:.0f}°",
            label="cone of normals",
            grade=graded(-quality.cone_deg, (-_CONE_DEG[0], -_CONE_DEG[1])),
            remark="half-angle that holds 95 % of the calibration normals",
        ),
    )


def graded(value: float, bounds: tuple[float, float]) -> str:
    """Return good up to the first bound, fair up to the second, else poor."""
    return "good" if value <= bounds[0] else "fair" if value <= bounds[1] else "poor"


def _cone_figure(result: OpenedResult, sample: int) -> PageFigure:
    """The hemisphere of normals seen from the camera: capture's normals, calibrated cone, lights."""
    quality = result.rig.quality
    with report_style():
        figure = new_figure(4.6, 4.3)
        axes = figure.subplots()
        axes.set_aspect("equal")
        axes.set_axis_off()
        axes.set_xlim(-1.25, 1.25)
        axes.set_ylim(-1.18, 1.12)
        _draw_capture(axes, result, sample)
        turn = np.linspace(0, 2 * np.pi, 181)
        for angle in (30, 60, 90):
            radius = np.sin(np.deg2rad(angle))
            axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=FAINT, lw=0.8, ls="-")
            axes.annotate(f"{angle}°", (0, -radius), fontsize=7, color=FAINT, ha="center", va="bottom")
        if quality is not None and quality.samples:
            radius = np.sin(np.deg2rad(min(quality.cone_deg, 90.0)))
            line: dict[str, Any] = {"color": BLUE, "lw": 1.8, "ls": (0, (4, 2))}
            axes.plot(
                radius * np.cos(turn),
                radius * np.sin(turn),
                label=f"calibrated {quality.cone_deg:.0f}°",
                **line,
            )
        _draw_lights(axes, result)
        axes.legend(loc="lower center", ncols=4, fontsize=7.5, handletextpad=0.3, columnspacing=0.9)
    fitted = quality is not None and quality.samples > 0
    points = "Points: the lights."
    if result.rig.response.light_colours is None:
        points = (
            "Points: the rows of M, from where each channel is lit most; they are the lights only where each "
            "channel sees one light alone, else they lie closer together than the lights do."
        )
    cone = " Dashed: the size of the cone of calibration normals." if fitted else ""
    return figure_from_plot(
        figure,
        "Directions as the camera sees them, up is up; the rim is 90° from the optical axis. Grey: the "
        f"normals of frame {sample}. {points}{cone}",
    )


def _draw_capture(axes: Axes, result: OpenedResult, sample: int) -> None:
    normal_map = result.normals(sample)
    if normal_map is None:
        return
    normals = normal_map.normals_in_camera[normal_map.mask]
    normals = normals[:: max(1, len(normals) // _LARGEST_SAMPLE)]
    counts, x, y = np.histogram2d(
        normals[:, 0], -normals[:, 1], bins=_HISTOGRAM_CELLS, range=[[-1, 1], [-1, 1]]
    )
    shown = np.ma.masked_equal(np.sqrt(counts.T), 0)
    axes.imshow(
        shown, extent=(x[0], x[-1], y[0], y[-1]), origin="lower", cmap="Greys", vmin=-0.15 * shown.max(),
        vmax=1.2 * shown.max(), interpolation="nearest",
    )  # fmt: skip


def _draw_lights(axes: Axes, result: OpenedResult) -> None:
    response = result.rig.response
    colours: FloatArray = np.eye(3) if response.light_colours is None else np.array(response.light_colours)
    for k, (name, direction) in enumerate(
        zip(response.direction_names, response.light_directions, strict=True)
    ):
        hue = np.clip(colours[k] / max(colours[k].max(), 1e-9), 0, 1) * 0.85
        axes.plot(direction[0], -direction[1], "o", ms=9, color=tuple(hue), mec="white", mew=1.2, ls="none",
                  label=name)  # fmt: skip


def _response_figure(result: OpenedResult) -> PageFigure:
    """M itself: what a unit of each axis adds to red, green and blue."""
    matrix = np.array(result.rig.response.matrix)
    top = np.abs(matrix).max()
    with report_style():
        figure = new_figure(4.6, 4.3)
        axes = figure.subplots()
        axes.imshow(matrix, cmap="RdBu_r", vmin=-1.3 * top, vmax=1.3 * top)
        axes.set_xticks(range(3), ["x, right", "y, down", "z, away"])
        axes.set_yticks(range(3), ["red", "green", "blue"])
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0)
        for row, column in np.ndindex(3, 3):
            ink = "white" if abs(matrix[row, column]) > 0.75 * top else INK
            axes.text(column, row, f"{matrix[row, column]:+.3f}", ha="center", va="center", color=ink)
    ambient = ", ".join(f"{value:.3f}" for value in result.rig.response.ambient)
    return figure_from_plot(
        figure,
        f"M: what a unit of a normal's x, y, z adds to each channel, full scale 1. Ambient: {ambient}.",
    )


def _source_table(result: OpenedResult) -> PageTable:
    rows = tuple((source.file, source.sha256[:16] + "…") for source in result.rig.sources)
    return PageTable(headings=("calibrated from", "SHA-256"), rows=rows)

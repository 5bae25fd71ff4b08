"""`report.html`: one page on the quality of a reconstruction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.diagnosis.inspection import inspect_capture
from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.footage.captures import CaptureOptions
from vntoolkit.io.maps_and_meshes.ply import read_ply_counts
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.pipeline.opened_result import OpenedResult, open_result
from vntoolkit.report.calibration_section import calibration_section
from vntoolkit.report.page import (
    PageFigure,
    PageNotice,
    PageNumber,
    PageSection,
    PageTable,
    figure_from_plot,
    write_page,
)
from vntoolkit.report.samples_section import (
    samples_section,
    settings_section,
    size_and_rate,
    track_section,
)
from vntoolkit.report.style import BLUE, GREEN, ORANGE, PURPLE, RED, new_figure, report_style

_POINTS = 300  # more frames than this are drawn as a line without points


@dataclass(frozen=True, kw_only=True)
class ReportOptions:
    """What the report shows.

    samples: frames shown as pictures, evenly spread. picture_height: most pixels that each of them is high.
    footage: where the footage is now, if not where it was when it was reconstructed.
    """

    samples: int = 4
    picture_height: int = 300
    footage: str = ""

    def __post_init__(self) -> None:
        if self.samples < 1 or self.picture_height < 1:
            raise BadInput("report: expected at least one sample frame and one pixel")


def write_report(
    folder: Path,
    out: Path | None = None,
    options: ReportOptions | None = None,
    *,
    extra: Sequence[PageSection] = (),
) -> Path:
    """Write the page about a folder that `reconstruct` wrote; return its path.

    out: default folder/report.html. extra: further sections, set before the calibration's. Parts that the
    folder lacks (depth, meshes, tracks, the footage) are left out. Raises `BadInput`, `CannotWrite`.
    """
    options = options or ReportOptions()
    out = folder / "report.html" if out is None else out
    result = open_result(folder, footage=options.footage)
    middle = result.numbers[len(result.numbers) // 2]
    sections = [
        samples_section(result, options.samples, options.picture_height),
        *extra,
        warnings_section(result),
        calibration_section(result, middle),
        shares_section(result),
        results_section(result),
    ]
    if result.track is not None:
        sections.append(track_section(result, result.track))
    sections.append(settings_section(result))
    source = result.manifest.input
    write_page(
        out,
        f"Reconstruction of {Path(source.source).name}",
        sections,
        subtitle=f"{source.source} · {size_and_rate(source)}",
        numbers=_headline(result),
    )
    return out


def warnings_section(result: OpenedResult) -> PageSection:
    """Return what `doctor` finds in the footage, and which frames failed."""
    notices = list(_findings(result))
    failed = [entry for entry in result.entries.values() if entry.failure]
    if failed:
        text = f"frames skipped: {len(failed)}; the first is {failed[0].number}: {failed[0].failure}"
        notices.append(PageNotice(severity="warning", text=text))
    if not result.manifest.finished:
        text = "the run was not finished: the same command goes on where it stopped"
        notices.append(PageNotice(severity="warning", text=text))
    paragraphs = () if notices else ("Nothing was found that would ruin normals.",)
    return PageSection(title="Warnings", paragraphs=paragraphs, notices=tuple(notices))


def _findings(result: OpenedResult) -> list[PageNotice]:
    try:
        result.capture  # noqa: B018 - is it there, and is it the one?
        report = inspect_capture(result.source, CaptureOptions(transfer=result.rig.transfer), rig=result.rig)
    except VntError as error:
        text = f"the footage could not be looked over: {error}"
        return [PageNotice(severity="note", text=text)]
    return [PageNotice(severity=finding.severity.value, text=finding.text) for finding in report.findings]


def _headline(result: OpenedResult) -> tuple[PageNumber, ...]:
    done = [entry for entry in result.entries.values() if not entry.failure]
    numbers = [PageNumber(value=f"{len(result.numbers):,}", label="frames")]
    if done:
        shares = np.array([[e.valid_share, e.shadowed_share, e.clipped_share] for e in done]).mean(axis=0)
        for share, label in zip(shares, ("with a normal", "shadowed", "clipped"), strict=True):
            numbers.append(PageNumber(value=f"{100 * share:.1f} %", label=label))
    quality = result.rig.quality
    if quality is not None and quality.samples:
        numbers.append(PageNumber(value=f"{quality.residual_deg:.2f}°", label="calibration residual"))
    return tuple(numbers)


# Sections on all frames: usable pixels over time, time spent, sizes of the meshes.


def shares_section(result: OpenedResult) -> PageSection:
    """Return how much of each frame was usable, clipped and in shadow, with the skipped frames named."""
    entries = [entry for entry in result.entries.values() if not entry.failure]
    skipped = [entry for entry in result.entries.values() if entry.failure]
    rows = tuple((str(entry.number), entry.failure) for entry in skipped)
    return PageSection(
        title="Frames",
        paragraphs=(
            "Clipped pixels carry no normal. Shadowed ones, which not all three lights reach, were recovered "
            "from the lights that do and from the surface around them; their share is of the valid pixels.",
        ),
        numbers=_shares(entries[0]) if len(entries) == 1 else (),
        figures=(_shares_figure(entries, skipped),) if len(entries) > 1 else (),
        tables=(PageTable(headings=("skipped frame", "why"), rows=rows),) if rows else (),
    )


def _shares(entry: FrameEntry) -> tuple[PageNumber, ...]:
    """What the figure shows of many frames, of a single one."""
    shares = (entry.valid_share, entry.shadowed_share, entry.clipped_share)
    labels = ("with a normal, of all pixels", "shadowed, of those", "clipped, of all pixels")
    return tuple(
        PageNumber(value=f"{100 * share:.1f} %", label=label)
        for share, label in zip(shares, labels, strict=True)
    )


def _shares_figure(entries: list[FrameEntry], skipped: list[FrameEntry]) -> PageFigure:
    numbers = [entry.number for entry in entries]
    curves = (
        ("with a normal, of all pixels", [entry.valid_share for entry in entries], GREEN),
        ("shadowed, of those", [entry.shadowed_share for entry in entries], PURPLE),
        ("clipped, of all pixels", [entry.clipped_share for entry in entries], RED),
    )
    with report_style():
        figure = new_figure(9.6, 3.0)
        axes = figure.subplots()
        for label, values, colour in curves:
            axes.plot(numbers, 100 * np.array(values), color=colour, label=label, **_marker(len(numbers)))
        for entry in skipped:
            axes.axvline(entry.number, color=ORANGE, lw=1, ls=":")
        axes.set_xlabel("frame")
        axes.locator_params(axis="x", integer=True)
        axes.set_ylabel("share of pixels, %")
        axes.set_ylim(bottom=0)
        axes.legend(loc="upper left", bbox_to_anchor=(0, 1.16), ncols=3, fontsize=8)
    dotted = " Dotted: skipped frames." if skipped else ""
    return figure_from_plot(figure, f"Usable, shadowed and clipped shares over time.{dotted}", wide=True)


def results_section(result: OpenedResult) -> PageSection:
    """Return the time spent on each frame and how large the meshes are."""
    figures = []
    seconds = {number: entry.seconds for number, entry in result.entries.items() if not entry.failure}
    if len(seconds) > 1:
        figures.append(_curve(seconds, "seconds per frame", "Time spent on each frame, reading aside.", BLUE))
    counts = mesh_counts(result)
    numbers = _result_numbers(result, seconds, counts)
    if len(counts) > 1:
        thousands = {number: faces / 1000 for number, (_, faces) in counts.items()}
        figures.append(_curve(thousands, "thousand triangles", "Triangles of each frame's mesh.", GREEN))
    return PageSection(title="Time and meshes", numbers=numbers, figures=tuple(figures))


def mesh_counts(result: OpenedResult) -> dict[int, tuple[int, int]]:
    """Return {frame: (vertices, triangles)} from the headers of the meshes on disk."""
    counts = {}
    for number in result.numbers:
        path = result.folder.mesh(number)
        if path.exists():
            sizes = read_ply_counts(path)
            counts[number] = (sizes.get("vertex", 0), sizes.get("face", 0))
    return counts


def _result_numbers(
    result: OpenedResult, seconds: Mapping[int, float], counts: Mapping[int, tuple[int, int]]
) -> tuple[PageNumber, ...]:
    numbers = [PageNumber(value=f"{len(result.numbers):,}", label="frames with normals")]
    if seconds:
        median = float(np.median(list(seconds.values())))
        numbers.append(PageNumber(value=f"{1000 * median:,.0f} ms", label="median time per frame"))
    wall = result.manifest.timings.get("wall_s")
    if wall:
        numbers.append(PageNumber(value=f"{wall:,.1f} s", label="the last run, whole"))
    if counts:
        vertices, faces = np.median(np.array(list(counts.values())), axis=0)
        numbers.append(
            PageNumber(value=f"{vertices:,.0f}", label="vertices, median", remark=f"{faces:,.0f} triangles")
        )
    return tuple(numbers)


def _curve(values: Mapping[int, float], label: str, caption: str, colour: str) -> PageFigure:
    with report_style():
        figure = new_figure(5.2, 2.6)
        axes = figure.subplots()
        axes.plot(list(values), list(values.values()), color=colour, **_marker(len(values)))
        axes.set_xlabel("frame")
        axes.locator_params(axis="x", integer=True)
        axes.set_ylabel(label)
        axes.set_ylim(0, 1.15 * max(values.values()) or 1.0)
    return figure_from_plot(figure, caption)


def _marker(count: int) -> dict[str, Any]:
    """Few frames get points, a single one could not be seen without."""
    return {"marker": "o", "ms": 3.5} if count <= _POINTS else {}

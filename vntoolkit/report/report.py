"""`report.html`: everything that tells whether a reconstruction can be trusted, on one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.captures import CaptureOptions
from vntoolkit.io.inspection import inspect_capture
from vntoolkit.pipeline.opened_result import OpenedResult, open_result
from vntoolkit.report.calibration_section import calibration_section
from vntoolkit.report.frames_section import results_section, shares_section
from vntoolkit.report.page import PageNotice, PageNumber, PageSection, write_page
from vntoolkit.report.samples_section import (
    samples_section,
    settings_section,
    size_and_rate,
    track_section,
)


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

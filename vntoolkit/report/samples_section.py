"""The report's pictures: a few frames as captured, their normals, relief and shadows; the tracked surface."""

from __future__ import annotations

import numpy as np

from vntoolkit.io.images import read_image, resized_image
from vntoolkit.io.label_images import LABEL_LEGEND, label_colours
from vntoolkit.pipeline.opened_result import OpenedResult, TrackedSurface
from vntoolkit.report.page import (
    PageFigure,
    PageNumber,
    PageSection,
    PageTable,
    figure_from_pixels,
    figure_from_plot,
)
from vntoolkit.report.pictures import (
    Picture,
    cropped,
    picture_of_depth,
    picture_of_labels,
    picture_of_normals,
    strip_of,
)
from vntoolkit.report.svg import BLUE, FAINT, new_figure, report_style

_SHEET_PX = 1600
_LIT_BY_ALL = "7"


def sampled(numbers: tuple[int, ...], count: int) -> tuple[int, ...]:
    """Return at most `count` of the frame numbers, evenly spread, the first and the last among them."""
    places = np.linspace(0, len(numbers) - 1, min(count, len(numbers))).round().astype(int)
    return tuple(numbers[place] for place in dict.fromkeys(places.tolist()))


def samples_section(result: OpenedResult, count: int, height_px: int) -> PageSection:
    """Return one strip a sampled frame: capture, normals, relief, shadows, as far as they are there."""
    figures = []
    for number in sampled(result.numbers, count):
        names, pictures = _parts(result, number)
        strip = strip_of(pictures, height_px)
        figures.append(figure_from_pixels(strip, f"Frame {number}: {', '.join(names)}.", wide=True))
    legend: tuple[PageFigure, ...] = ()
    if any(result.folder.shadows(number).exists() for number in result.numbers):
        legend = (_legend(),)
    return PageSection(
        title="Sample frames",
        paragraphs=(
            "Normals in their usual colours (red to the right, green up, blue to the viewer). The relief is "
            "the integrated depth, lit from the upper left, its slopes taken from the depth itself.",
        ),
        figures=(*figures, *legend),
    )


def _parts(result: OpenedResult, number: int) -> tuple[list[str], list[Picture]]:
    normal_map, depth_map = result.normals(number), result.depth(number)
    assert normal_map is not None  # the frame is in result.numbers
    labels, captured = result.labels(number), result.picture(number)
    parts: dict[str, Picture] = {}
    if captured is not None:
        parts["captured"] = captured
    parts["normals"] = picture_of_normals(normal_map)
    if depth_map is not None:
        parts["relief"] = picture_of_depth(depth_map, result.camera)
    if labels is not None:
        parts["shadows"] = picture_of_labels(labels, normal_map.mask)
    return list(parts), cropped(list(parts.values()), normal_map.mask)


def _legend() -> PageFigure:
    """The colours of the shadow labels."""
    with report_style():
        figure = new_figure(9.6, 0.55)
        axes = figure.subplots()
        axes.set_axis_off()
        axes.set_xlim(0, 4)
        axes.set_ylim(-1.6, 0.6)
        for place, (label, name) in enumerate(LABEL_LEGEND.items()):
            x, y = place % 4, -(place // 4)
            colour = tuple(label_colours(np.uint8(int(label))) / 255)
            axes.plot(x + 0.02, y, "s", ms=8, color=colour, mec=FAINT, mew=0.8)
            short = "lit by all three" if label == _LIT_BY_ALL else name
            axes.text(x + 0.08, y, short, va="center", fontsize=8)
    return figure_from_plot(figure, "Colours of the shadows: which lights arrive.", wide=True)


def track_section(result: OpenedResult, track: TrackedSurface) -> PageSection:
    """Return the registered surface: its size, its confidence over time, the checkerboard that it carries."""
    figures = []
    confidence = track.sequence.confidence
    if confidence is not None:
        shares = [float(np.mean(np.asarray(confidence[row]))) for row in range(len(track.sequence))]
        with report_style():
            figure = new_figure(9.6, 2.4)
            axes = figure.subplots()
            axes.plot(track.numbers, shares, color=BLUE)
            axes.axvline(track.template, color=FAINT, ls=":", lw=1)
            axes.set_xlabel("frame")
            axes.set_ylabel("mean confidence")
            axes.set_ylim(0, 1.02)
        caption = "Confidence of the tracked vertices, mean of each frame. Dotted: the template's frame."
        figures.append(figure_from_plot(figure, caption, wide=True))
    sheet = result.folder.root / "track" / "checkerboard.png"
    if sheet.exists():
        pixels = resized_image(np.asarray(read_image(sheet), dtype=np.uint8), _SHEET_PX)
        caption = "A checkerboard painted on the template and carried along: it should look printed on."
        figures.append(figure_from_pixels(pixels, caption, wide=True))
    return PageSection(
        title="Registered surface",
        numbers=(
            PageNumber(value=f"{len(track.sequence.template.vertices):,}", label="vertices, in every frame"),
            PageNumber(value=f"{len(track.sequence):,}", label="frames"),
            PageNumber(value=str(track.template), label="template frame"),
        ),
        figures=tuple(figures),
    )


def settings_section(result: OpenedResult) -> PageSection:
    """Return what the result was made from and with."""
    manifest = result.manifest
    files = manifest.input.files
    camera = result.rig.camera
    unit = result.length_unit
    facts = {
        "footage": f"{manifest.input.source}: {manifest.input.frame_count} frames of "
        f"{manifest.input.width} × {manifest.input.height}, {manifest.input.frame_rate_hz:g} per second",
        "SHA-256": files[0].sha256 if len(files) == 1 else f"of {len(files)} files, in reconstruction.json",
        "camera": f"{camera.model.value}, focal length {camera.matrix[0, 0]:.1f} px",
        "transfer curve": result.rig.transfer.to_text(),
        "lengths": "none"
        if unit is None
        else {"px": "pixels", "m": "metres", "free": "free scale"}[unit.value],
        "run": f"{manifest.started} to {manifest.finished or 'not finished'}",
        "versions": ", ".join(f"{name} {version}" for name, version in manifest.versions.items()),
    }
    options = tuple((name, str(value)) for name, value in sorted(manifest.options.items()))
    return PageSection(
        title="Made from",
        tables=(
            PageTable(headings=("what", ""), rows=tuple(facts.items())),
            PageTable(headings=("option", "value"), rows=options, folded=f"{len(options)} options"),
        ),
    )

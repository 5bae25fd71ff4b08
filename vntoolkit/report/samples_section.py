"""The report's pictures: a few frames as captured, their normals, relief and shadows; the tracked surface."""

from __future__ import annotations

import numpy as np

from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.io.footage.images import read_image, resized_image
from vntoolkit.io.maps_and_meshes.label_images import LABEL_LEGEND
from vntoolkit.io.results.manifest import InputEntry
from vntoolkit.pipeline.opened_result import OpenedResult, TrackedSurface
from vntoolkit.report.page import (
    PageNumber,
    PageSection,
    PageTable,
    figure_from_pixels,
    figure_from_plot,
)
from vntoolkit.report.pictures import (
    GROUND,
    Picture,
    cropped,
    pictures_of_frame,
    sampled,
    short_label,
    web_colour,
)
from vntoolkit.report.style import BLUE, FAINT, new_figure, report_style
from vntoolkit.report.tiles import tiled

_SHEET_PX = 1600
_TITLES = {"depth": "relief", "shadows": "lights that arrive"}
_BESIDE = 205  # grey beside the subject, since white means that all lights arrive


def samples_section(result: OpenedResult, count: int, height_px: int) -> PageSection:
    """Return a row for each sampled frame: capture, normals, relief, shadows, as far as they are there."""
    shown = sampled(result.numbers, count)
    rows = [_parts(result, number) for number in shown]
    labelled = any("lights that arrive" in row for row in rows)
    pixels = tiled(
        rows,
        [f"frame {number}" for number in shown],
        legend=_legend() if labelled else None,
        height_px=height_px,
    )
    words = list(dict.fromkeys(name for row in rows for name in row))
    frames = ", ".join(map(str, shown))
    caption = f"{', '.join(words).capitalize()} of {'frame' if len(shown) == 1 else 'frames'} {frames}."
    return PageSection(
        title="Sample frames",
        paragraphs=(
            "Normals in their usual colours (red to the right, green up, blue to the viewer). The relief is "
            "the integrated depth, lit from the upper left, its slopes taken from the depth itself.",
        ),
        figures=(figure_from_pixels(pixels, caption, suffix=".webp", wide=True),),
    )


def _parts(result: OpenedResult, number: int) -> dict[str, Picture]:
    normal_map = result.normals(number)
    assert normal_map is not None  # the frame is in result.numbers
    parts = pictures_of_frame(result, number, ground=GROUND, beside_normals=GROUND, beside_labels=_BESIDE)
    titles = [_TITLES.get(name, name) for name in parts]
    return dict(zip(titles, cropped(list(parts.values()), normal_map.mask), strict=True))


def _legend() -> dict[str, str]:
    """The colours of the shadow labels, by short names of what arrives."""
    return {short_label(int(label)): web_colour(int(label)) for label in LABEL_LEGEND}


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
            axes.locator_params(axis="x", integer=True)
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


def size_and_rate(source: InputEntry) -> str:
    """Return frames, size and rate of footage in words; a single image has no rate."""
    size = f"{source.width} × {source.height} pixels"
    if source.frame_count == 1:
        return f"one image of {size}"
    return f"{source.frame_count} frames of {size}, {source.frame_rate_hz:g} per second"


def _camera_in_words(camera: Camera) -> str:
    if camera.model is CameraModel.ORTHOGRAPHIC:
        return "orthographic"
    lens = "pinhole" if camera.model is CameraModel.PINHOLE else "pinhole with distortion"
    return f"{lens}, focal length {camera.matrix[0, 0]:.1f} px"


def settings_section(result: OpenedResult) -> PageSection:
    """Return what the result was made from and with."""
    manifest = result.manifest
    files = manifest.input.files
    camera = result.rig.camera
    unit = result.length_unit
    facts = {
        "footage": f"{manifest.input.source}: {size_and_rate(manifest.input)}",
        "SHA-256": files[0].sha256 if len(files) == 1 else f"of {len(files)} files, in reconstruction.json",
        "camera": _camera_in_words(camera),
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

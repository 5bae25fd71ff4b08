"""`report.html`: one page on the quality of a reconstruction."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import VntError
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.footage.image_writing import resized_image
from vntoolkit.io.results.frame_log import FrameEntry
from vntoolkit.io.results.manifest import InputEntry
from vntoolkit.options.pages import ReportOptions
from vntoolkit.photometry.frame import LABEL_LEGEND
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.report import page, pictures
from vntoolkit.shipped import guide_section

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from vntoolkit.pipeline.tracked_folder import Tracks

_PICTURE_HEIGHT_PX = 300  # of a sample, at most
_POINTS = 300  # more frames than this are drawn as a line without points


def write_report(
    folder: Path,
    out: Path | None = None,
    options: ReportOptions | None = None,
    *,
    extra: Sequence[page.PageSection] = (),
) -> Path:
    """Write the page about a folder that `reconstruct` wrote; return its path.

    out: default folder/report.html. extra: further sections, set before the calibration's. Parts that the
    folder lacks (depth, meshes, tracks, the footage) are left out. Raises `BadInput`, `CannotWrite`.
    """
    options = options or ReportOptions()
    out = folder / "report.html" if out is None else out
    result = read_result(folder, footage=options.footage)
    middle = result.numbers[len(result.numbers) // 2]
    sections = [
        warnings_section(result),
        samples_section(result, options.samples, _PICTURE_HEIGHT_PX),
        *extra,
        calibration_section(result, middle),
        shares_section(result),
        results_section(result),
    ]
    if result.track is not None:
        sections.append(track_section(result, result.track))
    sections.append(settings_section(result))
    source = result.manifest.input
    page.write_page(
        out,
        f"Reconstruction of {Path(source.source).name}",
        sections,
        subtitle=f"{source.source} · {size_and_rate(source)}",
        numbers=_headline(result),
    )
    return out


def warnings_section(result: OpenedResult) -> page.PageSection:
    """Return what was found wrong, the gravest first, and what the footage's header says."""
    from vntoolkit.diagnosis.header_checks import findings_from_header

    notices = [_notice(each.level, each.line, each.check) for each in result.findings]
    try:
        stated = findings_from_header(result.capture)
        notices += [_notice(each.level.value, each.text, each.check) for each in stated]
    except VntError as error:
        text = f"the footage could not be looked at: {error}"
        notices.append(page.PageNotice(severity="note", text=text))
    paragraphs = () if notices else ("Nothing was found that would ruin normals.",)
    return page.PageSection(title="Warnings", paragraphs=paragraphs, notices=tuple(notices))


def _notice(severity: str, line: str, check: str) -> page.PageNotice:
    """Return a finding, with its section of the guide in the place of the reference to it."""
    text = line.removesuffix(f", see docs/wrong.md#{check}")
    return page.PageNotice(severity=severity, text=text, more=tuple(guide_section(check)))


def content_of_report(result: OpenedResult) -> dict[str, Any]:
    """Return what the page says in words and numbers, as JSON: findings first, then each frame."""
    manifest = result.manifest
    return {
        "folder": str(result.folder.root),
        "findings": [finding.model_dump() for finding in result.findings],
        "error_deg": manifest.error_deg,
        "frames": [vars(entry) for entry in result.entries.values()],
        "materials": [entry.model_dump() for entry in manifest.known.materials],
        "options": manifest.options,
    }


def _headline(result: OpenedResult) -> tuple[page.PageNumber, ...]:
    done = [entry for entry in result.entries.values() if not entry.failure]
    numbers = [page.PageNumber(value=f"{len(result.numbers):,}", label="frames")]
    if done:
        shares = np.array([[e.valid_share, e.shadowed_share, e.clipped_share] for e in done]).mean(axis=0)
        for share, label in zip(shares, ("with a normal", "shadowed", "clipped"), strict=True):
            numbers.append(page.PageNumber(value=f"{100 * share:.1f} %", label=label))
    if result.manifest.error_deg is not None:
        error = f"{result.manifest.error_deg:.1f}°"
        numbers.append(page.PageNumber(value=error, label="expected error of the normals, median"))
    quality = result.rig.quality
    if quality is not None and quality.samples:
        numbers.append(page.PageNumber(value=f"{quality.residual_deg:.2f}°", label="calibration residual"))
    return tuple(numbers)


# Sections on all frames: usable pixels over time, time spent, sizes of the meshes.


def shares_section(result: OpenedResult) -> page.PageSection:
    """Return how much of each frame was usable, clipped and in shadow, with the skipped frames named."""
    entries = [entry for entry in result.entries.values() if not entry.failure]
    skipped = [entry for entry in result.entries.values() if entry.failure]
    rows = tuple((_named(result, entry.number), entry.failure) for entry in skipped)
    return page.PageSection(
        title="Frames",
        paragraphs=(
            "Clipped pixels carry no normal. Shadowed ones, which not all three lights reach, were recovered "
            "from the lights that do and from the surface around them; their share is of the valid pixels.",
        ),
        figures=(_shares_figure(entries, skipped),) if len(entries) > 1 else (),
        tables=(page.PageTable(headings=("skipped frame", "why"), rows=rows),) if rows else (),
    )


def _shares_figure(entries: list[FrameEntry], skipped: list[FrameEntry]) -> page.PageFigure:
    numbers = [entry.number for entry in entries]
    curves = (
        ("with a normal, of all pixels", [entry.valid_share for entry in entries], pictures.GREEN),
        ("shadowed, of those", [entry.shadowed_share for entry in entries], pictures.PURPLE),
        ("clipped, of all pixels", [entry.clipped_share for entry in entries], pictures.RED),
    )
    with pictures.new_axes(9.6, 3.0) as axes:
        for label, values, colour in curves:
            axes.plot(numbers, 100 * np.array(values), color=colour, label=label, **_marker(len(numbers)))
        for entry in skipped:
            axes.axvline(entry.number, color=pictures.ORANGE, lw=1, ls=":")
        axes.set(xlabel="frame", ylabel="share of pixels, %", ylim=(0, None))
        axes.locator_params(axis="x", integer=True)
        axes.legend(loc="upper left", bbox_to_anchor=(0, 1.16), ncols=3, fontsize=8)
    dotted = " Dotted: skipped frames." if skipped else ""
    return page.figure_from_plot(
        axes.figure, f"Usable, shadowed and clipped shares over time.{dotted}", wide=True
    )


def results_section(result: OpenedResult) -> page.PageSection:
    """Return the time spent on each frame and how large the meshes are."""
    figures = []
    seconds = {number: entry.seconds for number, entry in result.entries.items() if not entry.failure}
    if len(seconds) > 1:
        figures.append(
            _curve(seconds, "seconds per frame", "Time spent on each frame, reading aside.", pictures.BLUE)
        )
    counts = mesh_counts(result)
    numbers = _result_numbers(result, seconds, counts)
    if len(counts) > 1:
        thousands = {number: faces / 1000 for number, (_, faces) in counts.items()}
        figures.append(
            _curve(thousands, "thousand triangles", "Triangles of each frame's mesh.", pictures.GREEN)
        )
    return page.PageSection(title="Time and meshes", numbers=numbers, figures=tuple(figures))


def mesh_counts(result: OpenedResult) -> dict[int, tuple[int, int]]:
    """Return {frame: (vertices, triangles)} from the headers of the meshes on disk."""
    counts = {}
    for number in result.numbers:
        path = result.folder.file("mesh", number)
        if path.exists():
            from vntoolkit.io.maps_and_meshes.ply import read_ply_counts

            sizes = read_ply_counts(path)
            counts[number] = (sizes.get("vertex", 0), sizes.get("face", 0))
    return counts


def _result_numbers(
    result: OpenedResult, seconds: Mapping[int, float], counts: Mapping[int, tuple[int, int]]
) -> tuple[page.PageNumber, ...]:
    numbers = [page.PageNumber(value=f"{len(result.numbers):,}", label="frames with normals")]
    if seconds:
        median = float(np.median(list(seconds.values())))
        numbers.append(page.PageNumber(value=f"{1000 * median:,.0f} ms", label="median time per frame"))
    wall = result.manifest.timings.get("wall_s")
    if wall:
        numbers.append(page.PageNumber(value=f"{wall:,.1f} s", label="the last run, whole"))
    if counts:
        vertices, faces = np.median(np.array(list(counts.values())), axis=0)
        numbers.append(
            page.PageNumber(
                value=f"{vertices:,.0f}", label="vertices, median", remark=f"{faces:,.0f} triangles"
            )
        )
    return tuple(numbers)


def _curve(values: Mapping[int, float], label: str, caption: str, colour: str) -> page.PageFigure:
    with pictures.new_axes(5.2, 2.6) as axes:
        axes.plot(list(values), list(values.values()), color=colour, **_marker(len(values)))
        axes.set(xlabel="frame", ylabel=label, ylim=(0, 1.15 * max(values.values()) or 1.0))
        axes.locator_params(axis="x", integer=True)
    return page.figure_from_plot(axes.figure, caption)


def _marker(count: int) -> dict[str, Any]:
    """Few frames get points, a single one could not be seen without."""
    return {"marker": "o", "ms": 3.5} if count <= _POINTS else {}


_SHEET_PX = 1600
_TITLES = {"depth": "relief", "dents": "depth in mm", "shadows": "lights that arrive"}
_BESIDE = 205  # grey beside the subject, since white means that all lights arrive


def samples_section(result: OpenedResult, count: int, height_px: int) -> page.PageSection:
    """Return a row for each sampled frame: capture, normals, relief, shadows, as far as they are there."""
    shown = sampled(result.numbers, count)
    rows = [_parts(result, number) for number in shown]
    labelled = any("lights that arrive" in row for row in rows)
    pixels = pictures.tiled(
        rows,
        [_named(result, number) for number in shown],
        legend=({pictures.short_label(int(label)): pictures.web_colour(int(label)) for label in LABEL_LEGEND})
        if labelled
        else None,
        scale=pictures.NORMAL_ERRORS if any("expected error" in row for row in rows) else None,
        height_px=height_px,
    )
    words = list(dict.fromkeys(name for row in rows for name in row))
    caption = f"{', '.join(words).capitalize()} of {', '.join(_named(result, n) for n in shown)}."
    return page.PageSection(
        title="Sample frames",
        paragraphs=(
            "Normals in their usual colours (red to the right, green up, blue to the viewer). The relief is "
            "the integrated depth, lit from the upper left, its slopes taken from the depth itself. The "
            "expected error is what nine of ten normals keep to where rig and subject are as assumed.",
        ),
        figures=(page.figure_from_pixels(pixels, caption, suffix=".webp", wide=True),),
    )


def _named(result: OpenedResult, number: int) -> str:
    """A frame's number and, of a still, the name of its file."""
    source = result.manifest.input
    stems = {n: Path(file.file).stem for n, file in zip(source.numbers, source.files, strict=False)}
    return f"frame {number} ({stems[number]})" if number in stems else f"frame {number}"


def _parts(result: OpenedResult, number: int) -> dict[str, pictures.Picture]:
    normal_map = result.normals(number)
    parts = pictures.pictures_of_frame(result, number, ground=pictures.GROUND, beside_labels=_BESIDE)
    if normal_map.error_deg is not None:
        parts["expected error"] = pictures.picture_of_errors(
            normal_map.error_deg, normal_map.mask, pictures.NORMAL_ERRORS, pictures.GROUND
        )
    titles = [_TITLES.get(name, name) for name in parts]
    return dict(zip(titles, pictures.cropped(list(parts.values()), normal_map.mask), strict=True))


def track_section(result: OpenedResult, track: Tracks) -> page.PageSection:
    """Return the registered surface: its size, its expected error over time, the checkerboard on it."""
    figures = []
    uncertainty = track.sequence.uncertainty_px
    if uncertainty is not None:
        rows = [np.asarray(uncertainty[row]) for row in range(len(track.sequence))]
        levels = np.array([np.percentile(row, [50, 95], method="lower") for row in rows])
        levels[~np.isfinite(levels)] = np.nan  # of frames that are missing
        with pictures.new_axes(9.6, 2.4) as axes:
            axes.plot(track.numbers, levels[:, 1], color=pictures.FAINT, label="95th percentile")
            axes.plot(track.numbers, levels[:, 0], color=pictures.BLUE, label="median")
            axes.axvline(track.template, color=pictures.FAINT, ls=":", lw=1)
            axes.set(xlabel="frame", ylabel="expected error, px", ylim=(0, None))
            axes.locator_params(axis="x", integer=True)
            axes.legend(frameon=False)
        caption = "Expected error of the tracked vertices in each frame. Dotted: the template's frame."
        figures.append(page.figure_from_plot(axes.figure, caption, wide=True))
    sheet = result.folder.root / "track" / "checkerboard.png"
    if sheet.exists():
        from vntoolkit.io.footage.images import read_image

        pixels = resized_image(np.asarray(read_image(sheet), dtype=np.uint8), _SHEET_PX)
        caption = "A checkerboard painted on the template and carried along: it should look printed on."
        figures.append(page.figure_from_pixels(pixels, caption, wide=True))
    return page.PageSection(
        title="Registered surface",
        numbers=(
            page.PageNumber(
                value=f"{len(track.sequence.template.vertices):,}", label="vertices, in every frame"
            ),
            page.PageNumber(value=f"{len(track.sequence):,}", label="frames"),
            page.PageNumber(value=str(track.template), label="template frame"),
        ),
        figures=tuple(figures),
    )


def size_and_rate(source: InputEntry) -> str:
    """Return frames, size and rate of footage in words; stills have no rate."""
    size = f"{source.width} × {source.height} pixels"
    if source.frame_count == 1:
        return f"one image of {size}"
    rate = "" if source.frame_rate_hz is None else f", {source.frame_rate_hz:g} per second"
    return f"{source.frame_count} frames of {size}{rate}"


def _camera_in_words(camera: Camera) -> str:
    if camera.model is CameraModel.ORTHOGRAPHIC:
        return "orthographic"
    lens = "pinhole" if camera.model is CameraModel.PINHOLE else "pinhole with distortion"
    return f"{lens}, focal length {camera.matrix[0, 0]:.1f} px"


def settings_section(result: OpenedResult) -> page.PageSection:
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
    names = tuple((str(k), file.file) for k, file in zip(manifest.input.numbers, files, strict=False))
    named = page.PageTable(headings=("frame", "file"), rows=names, folded=f"{len(names)} files")
    return page.PageSection(
        title="Made from",
        tables=(
            page.PageTable(headings=("what", ""), rows=tuple(facts.items())),
            page.PageTable(headings=("option", "value"), rows=options, folded=f"{len(options)} options"),
            *((named,) if names else ()),
        ),
    )


# Bounds between good, fair and poor, by experience with simulated captures; they only colour the numbers.
_RESIDUAL_DEG = (2.0, 5.0)
_CONE_DEG = (35.0, 20.0)
_HISTOGRAM_CELLS = 60
_LARGEST_SAMPLE = 200_000


def calibration_section(result: OpenedResult, sample: int) -> page.PageSection:
    """Return the section; `sample`: the frame whose normals are set against the calibrated cone."""
    return page.PageSection(
        title="Calibration",
        paragraphs=(
            "Colour is M times the normal plus ambient light. A small residual says that one M explains the "
            "calibration footage; the condition number, how much a colour error grows on its way to a normal "
            "(1 is best); the cone, how far the calibration normals leaned to the sides.",
        ),
        numbers=_numbers(result),
        figures=(_cone_figure(result, sample), _response_figure(result)),
        tables=(page.table_of_sources("calibrated from", result.rig),) if result.rig.sources else (),
    )


def _numbers(result: OpenedResult) -> tuple[page.PageNumber, ...]:
    quality, condition = result.rig.quality, page.condition_of(result.rig.response)
    if quality is None or quality.samples == 0:
        method = "stated" if quality is None else quality.method
        known = page.PageNumber(
            value="not fitted", label=f"method: {method}", remark="lights known, no residual or cone"
        )
        return (condition, known)
    pairs = f"over {quality.samples:,} pairs of colour and normal, by {quality.method}"
    residual, cone = quality.residual_deg, quality.cone_deg
    half = "half-angle that holds 95 % of the calibration normals"
    return (
        page.graded("median residual", f"{residual:.2f}°", residual, _RESIDUAL_DEG, pairs),
        condition,
        page.graded("cone of normals", f"{cone:.0f}°", cone, _CONE_DEG, half),
    )


def _cone_figure(result: OpenedResult, sample: int) -> page.PageFigure:
    """The hemisphere of normals seen from the camera: capture's normals, calibrated cone, lights."""
    quality = result.rig.quality
    with pictures.new_axes(4.6, 4.3) as axes:
        axes.set(aspect="equal", xlim=(-1.25, 1.25), ylim=(-1.18, 1.12))
        axes.set_axis_off()
        _draw_capture(axes, result, sample)
        turn = np.linspace(0, 2 * np.pi, 181)
        for angle in (30, 60, 90):
            radius = np.sin(np.deg2rad(angle))
            axes.plot(radius * np.cos(turn), radius * np.sin(turn), color=pictures.FAINT, lw=0.8, ls="-")
            axes.annotate(
                f"{angle}°", (0, -radius), fontsize=7, color=pictures.FAINT, ha="center", va="bottom"
            )
        if quality is not None and quality.samples:
            radius = np.sin(np.deg2rad(min(quality.cone_deg, 90.0)))
            line: dict[str, Any] = {"color": pictures.BLUE, "lw": 1.8, "ls": (0, (4, 2))}
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
    return page.figure_from_plot(
        axes.figure,
        "Directions as the camera sees them, up is up; the rim is 90° from the optical axis. Grey: the "
        f"normals of frame {sample}. {points}{cone}",
    )


def _draw_capture(axes: Axes, result: OpenedResult, sample: int) -> None:
    normal_map = result.normals(sample)
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


def _response_figure(result: OpenedResult) -> page.PageFigure:
    """M itself: what a unit of each axis adds to red, green and blue."""
    matrix = np.array(result.rig.response.matrix)
    top = np.abs(matrix).max()
    with pictures.new_axes(4.6, 4.3) as axes:
        axes.imshow(matrix, cmap="RdBu_r", vmin=-1.3 * top, vmax=1.3 * top)
        axes.set_xticks(range(3), ["x, right", "y, down", "z, away"])
        axes.set_yticks(range(3), ["red", "green", "blue"])
        axes.grid(visible=False)
        axes.spines[:].set_visible(False)
        axes.tick_params(length=0)
        for row, column in np.ndindex(3, 3):
            ink = "white" if abs(matrix[row, column]) > 0.75 * top else pictures.INK
            axes.text(column, row, f"{matrix[row, column]:+.3f}", ha="center", va="center", color=ink)
    ambient = ", ".join(f"{value:.3f}" for value in result.rig.response.ambient)
    return page.figure_from_plot(
        axes.figure,
        f"M: what a unit of a normal's x, y, z adds to each channel, full scale 1. Ambient: {ambient}.",
    )

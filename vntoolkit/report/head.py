"""A calibration on a head as a page and a picture: tracks, poses, shape, samples, normals seen, lights."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from vntoolkit.arrays import ByteArray, FloatArray, Vector3
from vntoolkit.calibration.head.hull import turn_angles_deg
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rays import RayScene, pixel_rays
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import HeadCalibration
from vntoolkit.report import page, pictures
from vntoolkit.report.mesh_views import View, picture_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI = 110
Draw = Callable[[Any], None]
# Bounds between good, fair and poor, by experience with simulated turns.
_TURN_DEG = (100.0, 60.0)
_AGREEING = (0.65, 0.4)
_ERROR_PX = (0.4, 0.7)
_RESIDUAL_DEG = (4.0, 7.0)
_CHANGE = (0.005, 0.02)  # of M in the last round, as a share
_SHAPE_PERCENT = (0.15, 0.5)


class _ShownFrame(NamedTuple):
    place: int  # among the light frames
    number: int  # in the capture
    used: int  # among the frames used
    image: ByteArray


def write_head_page(path: Path, job: CalibrationJob, rig: Rig, result: HeadCalibration) -> None:
    """Write one self-contained HTML page about a calibration on a head."""
    frames = _shown_frames(job, result)
    sections = [
        page.PageSection(
            title="What the footage carries",
            numbers=numbers_of_head(rig, result),
            notices=notices_of_head(result),
        ),
        _poses_section(frames, result),
        _shape_section(frames, result),
        _light_section(frames, rig, result),
        _times_section(rig, result),
    ]
    page.write_page(
        path,
        "Calibration on a turning head",
        sections,
        subtitle=f"{Path(job.source).name}: {len(result.footage.numbers)} frames",
    )


def _shown_frames(job: CalibrationJob, result: HeadCalibration) -> list[_ShownFrame]:
    capture, frames = job.open(), []
    for place in places_shown(result):
        number = result.light_numbers[place]
        image = pictures.displayed(capture.frame(number).rgb)
        frames.append(_ShownFrame(place, number, result.footage.numbers.index(number), image))
    return frames


def _poses_section(frames: list[_ShownFrame], result: HeadCalibration) -> page.PageSection:
    def tracks(axis: Any, shown: _ShownFrame) -> None:
        draw_tracks(axis, shown.image, result, shown.used)
        axis.set_title(f"frame {shown.number}")

    with pictures.new_axes(9.0, 3.0) as turn:
        draw_turn(turn, result)
    return page.PageSection(
        title="Tracks and poses",
        paragraphs=(
            "Each track shows the eight frames before and after: blue ones were kept, orange ones follow "
            "shading, a highlight or what does not turn with the head, and were rejected.",
        ),
        figures=(
            _strip(tracks, frames, "Tracks on the frames."),
            page.figure_from_plot(turn.figure, "The head's angle in every frame.", wide=True),
        ),
    )


def _shape_section(frames: list[_ShownFrame], result: HeadCalibration) -> page.PageSection:
    def shape(axis: Any, shown: _ShownFrame) -> None:
        draw_shape(axis, shown.image, result, shown.used)

    shapes = shapes_of(result)
    counts = "; ".join(f"{name}: {len(mesh.vertices):,} vertices" for name, mesh in shapes.items()) + "."
    figures = [
        _strip(shape, frames, "Shape and hull over the silhouettes; overlap of shape and silhouette."),
        _picture(lambda axis: draw_meshes(axis, result), (240 * len(shapes), 720), counts, wide=True),
    ]
    if result.refined is None:
        return page.PageSection(title="Shape", figures=tuple(figures))
    figures.append(page.PageFigure(caption="The shape used, from all sides.", image=_turntable(result.mesh)))
    return page.PageSection(
        title="Shape",
        paragraphs=(
            "Stereo places the skin, but blurs and ripples it. The last shape agrees with stereo over long "
            "distances and with the normals of all frames over short ones. Teeth, hair and eyeglasses are "
            "not modelled: they gloss, cover or move.",
        ),
        figures=tuple(figures),
    )


def _turntable(mesh: Mesh) -> str:
    """Return the mesh, turning once, in its own colours beside plain ones, as the URI of an animation."""
    from PIL import Image

    plain = Mesh(vertices=mesh.vertices, faces=mesh.faces)
    drawn = []
    for azimuth in np.arange(0.0, 360.0, 360.0 / _TURNTABLE_FRAMES):
        view = View.around(mesh, _TURNTABLE_PX, _TURNTABLE_PX, azimuth_deg=float(azimuth))
        drawn.append(Image.fromarray(np.hstack([picture_of([each], view) for each in (mesh, plain)])))
    content = io.BytesIO()
    drawn[0].save(content, "WEBP", save_all=True, append_images=drawn[1:], duration=_TURNTABLE_MS, loop=0)
    return page.data_uri(content.getvalue(), ".webp")


def _light_section(frames: list[_ShownFrame], rig: Rig, result: HeadCalibration) -> page.PageSection:
    def samples(axis: Any, shown: _ShownFrame) -> None:
        draw_samples(axis, shown.image, result, shown.place)

    directions = rig.response.light_directions
    rows = tuple(
        (
            name,
            ", ".join(f"{value:+.3f}" for value in direction),
            f"{np.rad2deg(np.arccos(np.clip(-direction[2], -1.0, 1.0))):.1f}°",
            f"{np.rad2deg(np.arctan2(-direction[1], direction[0])) % 360.0:.0f}°",
        )
        for name, direction in zip(rig.response.direction_names, directions, strict=True)
    )
    matrix = tuple(
        (name, *(f"{value:+.4f}" for value in row))
        for name, row in zip(("red", "green", "blue"), rig.response.matrix, strict=True)
    )
    return page.PageSection(
        title="Light",
        paragraphs=(
            "Every sample is a normal of the shape, in the camera frame, and a colour. The sphere shows "
            "which normals were seen, in the colour of their residual; stars are the rows of M, from where "
            "each channel is lit most. They are the lights only where each channel sees one light alone; "
            "else they lie closer together than the lights do.",
        ),
        figures=(
            _strip(samples, frames, "Samples on the head, by what became of them."),
            _picture(lambda axis: draw_sphere(axis, result), (620, 600), "Normals seen, and the rows of M."),
        ),
        tables=(
            page.PageTable(
                headings=("", "towards x, y, z", "off the axis", "about it, 0 right, 90 up"), rows=rows
            ),
            page.PageTable(headings=("M", "n_x", "n_y", "n_z"), rows=matrix, right=(1, 2, 3)),
        ),
    )


def _times_section(rig: Rig, result: HeadCalibration) -> page.PageSection:
    times = tuple((stage, f"{seconds:.1f} s") for stage, seconds in result.stage_seconds.items())
    return page.PageSection(
        title="Time and sources",
        tables=(
            page.PageTable(headings=("stage", "time"), rows=times, right=(1,)),
            page.table_of_sources("file", rig),
        ),
    )


def _strip(
    draw: Callable[[Any, _ShownFrame], None], frames: list[_ShownFrame], caption: str
) -> page.PageFigure:
    """Paint the same drawing over several frames side by side."""
    rows, columns = frames[0].image.shape[:2]
    with pictures.report_style():
        figure = pictures.new_figure(12.0, 12.0 / len(frames) * rows / columns + 0.5)
        axes = figure.subplots(1, len(frames), squeeze=False)[0]
        for axis, shown in zip(axes, frames, strict=True):
            draw(axis, shown)
        return page.figure_from_pixels(_pixels_of(figure), caption, wide=True)


def _picture(draw: Draw, size: tuple[int, int], caption: str, *, wide: bool = False) -> page.PageFigure:
    """Paint one drawing of so many rows and columns: too much for a vector graphic."""
    width = 9.0 if wide else 6.0
    with pictures.new_axes(width, width * size[0] / size[1] + 0.4) as axis:
        draw(axis)
        return page.figure_from_pixels(_pixels_of(axis.figure), caption, wide=wide)


def _pixels_of(figure: Figure) -> ByteArray:
    figure.set_dpi(_DPI)
    canvas: Any = figure.canvas
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()


# Quality of the calibration: graded numbers, and notices where it is weak.


def numbers_of_head(rig: Rig, result: HeadCalibration) -> tuple[page.PageNumber, ...]:
    """Return turn, errors, agreement and condition, graded."""
    motion, quality = result.motion, result.light.quality
    agreeing = float(result.light.inliers.mean())
    tracks = f"{len(motion.point):,} tracks, {motion.observations:,} observations"
    samples = f"of {len(result.samples.point):,} on one M"
    by_shape = "normal by colour against normal by shape"
    turn, residual = motion.turn_deg, quality.residual_deg
    numbers = [
        page.graded("turn of the head", f"{turn:.0f}°", turn, _TURN_DEG, "between the two ends"),
        page.graded("reprojection error", f"{motion.error_px:.2f} px", motion.error_px, _ERROR_PX, tracks),
        page.graded("samples that agree", f"{agreeing:.0%}", agreeing, _AGREEING, samples),
        page.graded("median residual", f"{residual:.1f}°", residual, _RESIDUAL_DEG, by_shape),
        page.condition_of(rig.response),
    ]
    if (refined := result.refined) is not None:
        assert refined.mesh.error_deg is not None
        last, error = refined.changes[-1], float(np.median(refined.error_percent))
        rounds = "by rounds: " + ", ".join(f"{100 * change:.1f} %" for change in refined.changes)
        normals = f"of its diagonal, median; nine of ten normals to {np.median(refined.mesh.error_deg):.1f}°"
        numbers += [
            page.graded("last change of M", f"{100 * last:.1f} %", last, _CHANGE, rounds),
            page.graded("expected error of the shape", f"{error:.2f} %", error, _SHAPE_PERCENT, normals),
        ]
    return tuple(numbers)


def notices_of_head(result: HeadCalibration) -> tuple[page.PageNotice, ...]:
    """Say plainly what is weak; what carries no calibration at all was refused before."""
    motion = result.motion
    found = []
    if motion.turn_deg < _TURN_DEG[0]:
        found.append(
            f"The head turns by only {motion.turn_deg:.0f}°. Depth and lights grow surer with 60° to both "
            "sides."
        )
    if motion.interpolated.any():
        missing = ", ".join(str(result.footage.numbers[k]) for k in np.flatnonzero(motion.interpolated)[:8])
        found.append(
            f"{np.count_nonzero(motion.interpolated)} of the frames were not placed but interpolated: "
            f"{missing}."
        )
    if result.light.inliers.mean() < _AGREEING[0]:
        found.append(
            f"Only {result.light.inliers.mean():.0%} of the samples agree on one M. Look for stray light, "
            "gloss or a wrong transfer curve."
        )
    if motion.error_px > _ERROR_PX[0]:
        found.append(
            f"Tracks miss the rigid head by {motion.error_px:.2f} px. Look for a moving expression or blur."
        )
    if not found:
        return (page.PageNotice(severity="note", text="Turn, tracks and samples carry the calibration."),)
    return tuple(page.PageNotice(severity="warning", text=text) for text in found)


_TRAIL_FRAMES = 8
_MOST_TRAILS = 400
_YELLOW = "#f0e442"  # of the same colours for all kinds of colour vision as the style's
_FIGURE_DPI = 100
_LIGHT_COLOURS = ("#d9261c", "#1fa34a", "#2b62d9")
_VIEW_HEIGHT = 1.1  # of the mesh's own height
_TURNTABLE_FRAMES, _TURNTABLE_PX, _TURNTABLE_MS = 20, 260, 140


def write_head_figure(path: Path | str, job: CalibrationJob, result: HeadCalibration) -> None:
    """Write a .png: frames towards the ends and in the middle of the turn, and a row of summaries."""
    with pictures.report_style():
        figure = pictures.new_figure(12.0, 12.4)
        axes = figure.subplots(4, 3, height_ratios=(3, 3, 3, 4))
        for column, shown in enumerate(_shown_frames(job, result)):
            draw_tracks(axes[0, column], shown.image, result, shown.used)
            draw_shape(axes[1, column], shown.image, result, shown.used)
            draw_samples(axes[2, column], shown.image, result, shown.place)
            axes[0, column].set_title(f"frame {shown.number}:\ntracks kept (blue), rejected (orange)")
        draw_turn(axes[3, 0], result)
        draw_sphere(axes[3, 1], result)
        draw_meshes(axes[3, 2], result)
    pictures.write_figure(figure, path, dpi=_FIGURE_DPI)


def places_shown(result: HeadCalibration) -> list[int]:
    """Return which light frames are shown: towards both ends of the turn and in its middle."""
    count = len(result.light_numbers)
    return sorted({count // 6, count // 2, count - 1 - count // 6})


def draw_tracks(axis: Any, image: ByteArray, result: HeadCalibration, used: int) -> None:
    """Draw where the skin came from and goes to about a frame: used (counted over those used)."""
    tracks, motion = result.tracks, result.motion
    _show(axis, image)
    here = tracks.point[tracks.frame == used]
    here = here[:: max(1, len(here) // _MOST_TRAILS)]
    kept = np.isin(here, motion.point)
    starts = np.searchsorted(tracks.point, here)
    ends = np.searchsorted(tracks.point, here, side="right")
    judged = np.isin(here, motion.offered)
    for good, start, end, counts in zip(kept, starts, ends, judged, strict=True):
        if not counts:
            continue
        recent = np.abs(tracks.frame[start:end] - used) <= _TRAIL_FRAMES
        trail = tracks.positions_px[start:end][recent]
        axis.plot(trail[:, 0], trail[:, 1], color=pictures.SKY if good else pictures.RED, linewidth=0.8)


def draw_shape(axis: Any, image: ByteArray, result: HeadCalibration, used: int) -> None:
    """Draw the shape over a frame, with the outlines of silhouette and hull."""
    motion = result.motion
    pose = motion.camera_from_head[used]
    shading = _shading(result.mesh, motion.camera, pose)
    blend = np.where(shading[..., None] >= 0, 255.0 * np.maximum(shading, 0)[..., None], 0.4 * image)
    _show(axis, blend.astype(np.uint8))
    axis.contour(result.footage.silhouettes[used].mask, levels=[0.5], colors=_YELLOW, linewidths=0.8)
    hull = _shading(result.hull, motion.camera, pose) >= 0
    axis.contour(hull, levels=[0.5], colors=pictures.SKY, linewidths=0.6)
    shape, silhouette = shading >= 0, result.footage.silhouettes[used].mask
    overlap = (shape & silhouette).sum() / max(1, (shape | silhouette).sum())
    axis.set_title(f"shape, silhouette (yellow), hull (blue);\noverlap {overlap:.3f}")


def draw_samples(axis: Any, image: ByteArray, result: HeadCalibration, place: int) -> None:
    """Draw the samples of a light frame, by what became of them."""
    samples, light = result.samples, result.light
    _show(axis, image // 2)
    own = samples.frame == place
    for chosen, colour in (
        (own & light.inliers, pictures.SKY),
        (own & ~light.inliers & ~light.shadowed, pictures.RED),
        (own & light.shadowed, _YELLOW),
    ):
        axis.scatter(*samples.position_px[chosen].T, s=3, color=colour, linewidths=0)
    axis.set_title("samples: agree (blue), do not (orange),\nin shadow (yellow)")


def draw_turn(axis: Any, result: HeadCalibration) -> None:
    """Plot the turn of the head over the frames."""
    angles = turn_angles_deg(result.motion.camera_from_head)
    numbers = np.array(result.footage.numbers)
    axis.plot(numbers, angles, ".-", color=pictures.BLUE, markersize=4, label="found")
    gaps = result.motion.interpolated
    axis.plot(numbers[gaps], angles[gaps], "x", color=pictures.RED, label="interpolated")
    axis.set(
        xlabel="frame", ylabel="angle, °", title=f"turn of the head, {result.motion.turn_deg:.0f}° in all"
    )
    axis.legend()


def draw_sphere(axis: Any, result: HeadCalibration) -> None:
    """Draw the normals seen, seen by the camera, in the colour of their residual, and the rows of M."""
    from matplotlib.patches import Circle

    samples, light = result.samples, result.light
    normals = samples.normals_in_camera[light.inliers]
    colours = samples.rgb[light.inliers] / light.albedo[light.inliers] - light.response.ambient
    residual = angles_deg(colours @ light.response.inverse.T, normals)
    points = axis.scatter(
        normals[:, 0], normals[:, 1], c=residual, s=3, vmin=0, vmax=15, cmap=pictures.ERROR_COLOURS
    )
    scale = axis.figure.colorbar(
        points, ax=axis, label="residual, °", location="bottom", shrink=0.6, extend="max"
    )
    scale.outline.set_visible(False)
    names, directions = light.response.direction_names, light.response.light_directions
    for direction, colour, name in zip(directions, _LIGHT_COLOURS, names, strict=True):
        axis.plot(*direction[:2], "*", color=colour, markersize=18, markeredgecolor="white", label=name)
    axis.add_artist(Circle((0, 0), 1.0, fill=False, color="0.5"))
    axis.set(aspect="equal", xlim=(-1.05, 1.05), ylim=(1.05, -1.05))
    axis.set(xlabel="x, right", ylabel="y, down")
    axis.set_title(f"normals seen, and rows of M; median residual {light.quality.residual_deg:.1f}°")
    axis.legend(loc="lower left", bbox_to_anchor=(0.8, -0.02))


def shapes_of(result: HeadCalibration) -> dict[str, Mesh]:
    """Return the shapes of the stages by their names, the one used last."""
    shapes = {"hull": result.hull}
    if result.fused is not result.hull:
        shapes["with stereo"] = result.fused
    if result.refined is not None:
        shapes["refined by normals"] = result.mesh
    return shapes


def draw_meshes(axis: Any, result: HeadCalibration) -> None:
    """Draw the shapes of all stages from three sides."""
    shapes = shapes_of(result)
    low, high = result.mesh.vertices.min(axis=0), result.mesh.vertices.max(axis=0)
    drawn = [_from_three_sides(mesh, 0.5 * (low + high), float(high[1] - low[1])) for mesh in shapes.values()]
    _show(axis, np.vstack(drawn))
    axis.set_title("from above: " + ", ".join(shapes))


def _from_three_sides(mesh: Mesh, centre: Vector3, height: float) -> ByteArray:
    plain = Mesh(vertices=mesh.vertices, faces=mesh.faces)
    views = (
        View(centre=centre, height=_VIEW_HEIGHT * height, azimuth_deg=azimuth, width_px=240, height_px=240)
        for azimuth in (-50.0, 0.0, 50.0)
    )
    return np.hstack([picture_of([plain], view) for view in views])


def _shading(mesh: Mesh, camera: Camera, pose: RigidTransform) -> FloatArray:
    """Return (h, w) how much the mesh faces the camera, 0 to 1, and −1 beside it."""
    rays = np.concatenate(pixel_rays(camera, camera.pixel_grid()), axis=-1).reshape(-1, 6)
    hits = RayScene((pose.apply(mesh.vertices), mesh.faces)).first_hits(rays)
    return hits.image(np.abs(hits.normals[:, 2]), (camera.height, camera.width), -1.0)


def _show(axis: Any, image: ByteArray) -> None:
    axis.imshow(image)
    axis.set_axis_off()

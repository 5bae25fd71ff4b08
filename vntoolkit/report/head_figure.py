"""A picture of a calibration on a head: tracks, shape over the silhouettes, samples, normals seen, lights."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.calibration.fit import angles_deg
from vntoolkit.calibration.head.hull import turn_angles_deg
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.rays import RayScene, pixel_rays
from vntoolkit.geometry.rigid import RigidTransform
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import HeadCalibration
from vntoolkit.report.pictures import displayed
from vntoolkit.report.raycast_view import View, picture_of
from vntoolkit.report.style import BLUE, ERROR_COLOURS, RED, SKY, new_figure, report_style, write_figure

_TRAIL_FRAMES = 8
_MOST_TRAILS = 400
_YELLOW = "#f0e442"  # of the same colours for all kinds of colour vision as the style's
_DPI = 100
_LIGHT_COLOURS = ("#d9261c", "#1fa34a", "#2b62d9")
_VIEW_HEIGHT = 1.1  # of the mesh's own height


def write_head_figure(path: Path | str, job: CalibrationJob, result: HeadCalibration) -> None:
    """Write a .png: frames towards the ends and in the middle of the turn, and a row of summaries."""
    with report_style():
        figure = new_figure(12.0, 12.4)
        axes = figure.subplots(4, 3, height_ratios=(3, 3, 3, 4))
        capture = job.open()
        for column, place in enumerate(places_shown(result)):
            number = result.light_numbers[place]
            used = result.footage.numbers.index(number)
            image = displayed(capture.frame(number).rgb)
            draw_tracks(axes[0, column], image, result, used)
            draw_shape(axes[1, column], image, result, used)
            draw_samples(axes[2, column], image, result, place)
            axes[0, column].set_title(f"frame {number}:\ntracks kept (blue), rejected (orange)")
        draw_turn(axes[3, 0], result)
        draw_sphere(axes[3, 1], result)
        draw_meshes(axes[3, 2], result)
    write_figure(figure, path, dpi=_DPI)


def places_shown(result: HeadCalibration) -> list[int]:
    """Return which light frames are shown: towards both ends of the turn and in its middle."""
    count = len(result.light_numbers)
    return sorted({count // 6, count // 2, count - 1 - count // 6})


def draw_tracks(axis: Any, image: npt.NDArray[np.uint8], result: HeadCalibration, used: int) -> None:
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
        axis.plot(trail[:, 0], trail[:, 1], color=SKY if good else RED, linewidth=0.8)


def draw_shape(axis: Any, image: npt.NDArray[np.uint8], result: HeadCalibration, used: int) -> None:
    """Draw the shape over a frame, with the outlines of silhouette and hull."""
    motion = result.motion
    pose = motion.camera_from_head[used]
    shading = _shading(result.mesh, motion.camera, pose)
    blend = np.where(shading[..., None] >= 0, 255.0 * np.maximum(shading, 0)[..., None], 0.4 * image)
    _show(axis, blend.astype(np.uint8))
    axis.contour(result.footage.silhouettes[used].mask, levels=[0.5], colors=_YELLOW, linewidths=0.8)
    hull = _shading(result.hull, motion.camera, pose) >= 0
    axis.contour(hull, levels=[0.5], colors=SKY, linewidths=0.6)
    overlap = _overlap(shading >= 0, result.footage.silhouettes[used].mask)
    axis.set_title(f"shape, silhouette (yellow), hull (blue);\noverlap {overlap:.3f}")


def draw_samples(axis: Any, image: npt.NDArray[np.uint8], result: HeadCalibration, place: int) -> None:
    """Draw the samples of a light frame, by what became of them."""
    samples, light = result.samples, result.light
    _show(axis, image // 2)
    own = samples.frame == place
    for chosen, colour in (
        (own & light.inliers, SKY),
        (own & ~light.inliers & ~light.shadowed, RED),
        (own & light.shadowed, _YELLOW),
    ):
        axis.scatter(*samples.position_px[chosen].T, s=3, color=colour, linewidths=0)
    axis.set_title("samples: agree (blue), do not (orange),\nin shadow (yellow)")


def draw_turn(axis: Any, result: HeadCalibration) -> None:
    """Plot the turn of the head over the frames."""
    angles = turn_angles_deg(result.motion.camera_from_head)
    numbers = np.array(result.footage.numbers)
    axis.plot(numbers, angles, ".-", color=BLUE, markersize=4, label="found")
    gaps = result.motion.interpolated
    axis.plot(numbers[gaps], angles[gaps], "x", color=RED, label="interpolated")
    axis.set(
        xlabel="frame", ylabel="angle, °", title=f"turn of the head, {result.motion.turn_deg:.0f}° in all"
    )
    axis.legend()


def draw_sphere(axis: Any, result: HeadCalibration) -> None:
    """Draw the normals seen, seen by the camera, in the colour of their residual, and the rows of M."""
    samples, light = result.samples, result.light
    normals = samples.normals_in_camera[light.inliers]
    colours = samples.rgb[light.inliers] / light.albedo[light.inliers] - light.response.ambient
    residual = angles_deg(colours @ light.response.inverse.T, normals)
    points = axis.scatter(normals[:, 0], normals[:, 1], c=residual, s=3, vmin=0, vmax=15, cmap=ERROR_COLOURS)
    scale = axis.figure.colorbar(
        points, ax=axis, label="residual, °", location="bottom", shrink=0.6, extend="max"
    )
    scale.outline.set_visible(False)
    names, directions = light.response.direction_names, light.response.light_directions
    for direction, colour, name in zip(directions, _LIGHT_COLOURS, names, strict=True):
        axis.plot(*direction[:2], "*", color=colour, markersize=18, markeredgecolor="white", label=name)
    axis.add_artist(_circle())
    axis.set(aspect="equal", xlim=(-1.05, 1.05), ylim=(1.05, -1.05))
    axis.set(xlabel="x, right", ylabel="y, down")
    axis.set_title(f"normals seen, and rows of M; median residual {light.quality.residual_deg:.1f}°")
    axis.legend(loc="lower left", bbox_to_anchor=(0.8, -0.02))


def draw_meshes(axis: Any, result: HeadCalibration) -> None:
    """Draw hull and shape from three sides."""
    low, high = result.mesh.vertices.min(axis=0), result.mesh.vertices.max(axis=0)
    pictures = []
    for mesh in (result.hull, result.mesh):
        plain = Mesh(vertices=mesh.vertices, faces=mesh.faces)
        row = [
            picture_of(
                [plain],
                View(
                    centre=0.5 * (low + high),
                    height=_VIEW_HEIGHT * float(high[1] - low[1]),
                    azimuth_deg=azimuth,
                    width_px=240,
                    height_px=240,
                ),
            )
            for azimuth in (-50.0, 0.0, 50.0)
        ]
        pictures.append(np.hstack(row))
    _show(axis, np.vstack(pictures))
    axis.set_title("hull (above) and the shape used (below)")


def _shading(mesh: Mesh, camera: Camera, pose: RigidTransform) -> FloatArray:
    """Return (h, w) how much the mesh faces the camera, 0 to 1, and −1 beside it."""
    rays = np.concatenate(pixel_rays(camera, camera.pixel_grid()), axis=-1).reshape(-1, 6)
    hits = RayScene((pose.apply(mesh.vertices), mesh.faces)).first_hits(rays)
    return hits.image(np.abs(hits.normals[:, 2]), (camera.height, camera.width), -1.0)


def _overlap(first: Mask, second: Mask) -> float:
    return float((first & second).sum() / max(1, (first | second).sum()))


def _show(axis: Any, image: npt.NDArray[np.uint8]) -> None:
    axis.imshow(image)
    axis.set_axis_off()


def _circle() -> Any:
    from matplotlib.patches import Circle

    return Circle((0, 0), 1.0, fill=False, color="0.5")

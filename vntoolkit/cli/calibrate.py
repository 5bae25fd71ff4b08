"""`vntoolkit calibrate …`: footage of a calibration object in, rig.json out."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
from cyclopts import Parameter

from vntoolkit.calibration.board import BoardOptions
from vntoolkit.calibration.board_camera import IntrinsicsOptions
from vntoolkit.calibration.fit import FitOptions
from vntoolkit.calibration.lights import LightColours
from vntoolkit.calibration.sphere import SphereOptions
from vntoolkit.cli.flags import flags_from
from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import JSON, require_output
from vntoolkit.cli.progress import ProgressBars
from vntoolkit.cli.shared_flags import AmbientImage, Curve, FocalPx, Frames, SingleLight
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.frame_range import FrameRange
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.pipeline import calibrate

if TYPE_CHECKING:
    FitFlags: TypeAlias = FitOptions | None
    SphereFlags: TypeAlias = SphereOptions | None
    LayoutFlags: TypeAlias = BoardLayout | None
    BoardFlags: TypeAlias = BoardOptions | None
    IntrinsicsFlags: TypeAlias = IntrinsicsOptions | None
else:
    FitFlags = flags_from(FitOptions, method="fit-method")
    SphereFlags = flags_from(SphereOptions)
    LayoutFlags = flags_from(BoardLayout)
    BoardFlags = flags_from(BoardOptions)
    IntrinsicsFlags = flags_from(IntrinsicsOptions, without=("largest_error_px",))


@limits_on("max_megapixels")
def sphere(
    source: str,
    /,
    *,
    out: Path,
    mask: Path | None = None,
    background: AmbientImage = None,
    transfer: Curve = "linear",
    camera: Path | None = None,
    focal_px: FocalPx = None,
    single_light: SingleLight = None,
    frames: Frames = "::",
    options: SphereFlags = None,
    fit: FitFlags = None,
) -> None:
    """Calibrate on a matte ball of the material, at rest under all three lights.

    Parameters
    ----------
    source
        A video, an image, a folder of images, or a pattern. Several frames are averaged.
    out
        The rig.json to write.
    mask
        Image, white where the ball is; without it the outline is found.
    camera
        A rig.json whose camera is taken; default: orthographic.
    """
    require_output(out, JSON)
    job = _job(source, mask, background, transfer, camera, focal_px, single_light, frames)
    sphere_options = replace(options or SphereOptions(), fit=fit or FitOptions())
    rig, result = calibrate.calibrate_sphere(job, sphere_options)
    write_rig(out, rig)
    (u, v), radius = result.outline.centre_px, result.outline.radius_px
    report_rig(out, rig, f"ball at ({u:.1f}, {v:.1f}), radius {radius:.1f} px")


@limits_on("max_megapixels")
def board(
    source: str,
    /,
    *,
    out: Path,
    background: AmbientImage = None,
    transfer: Curve = "linear",
    camera: Path | None = None,
    focal_px: FocalPx = None,
    single_light: SingleLight = None,
    frames: Frames = "::",
    layout: LayoutFlags = None,
    options: BoardFlags = None,
    intrinsics: IntrinsicsFlags = None,
    fit: FitFlags = None,
) -> None:
    """Calibrate on the printed board with the material in its hole, tilted in all directions.

    Parameters
    ----------
    source
        A video, a folder of images, or a pattern.
    out
        The rig.json to write.
    camera
        A rig.json whose camera is taken; default: fitted to the same footage.
    """
    require_output(out, JSON)
    job = _job(source, None, background, transfer, camera, focal_px, single_light, frames)
    board_options = replace(
        options or BoardOptions(), fit=fit or FitOptions(), intrinsics=intrinsics or IntrinsicsOptions()
    )
    with ProgressBars() as bars:
        rig, result = calibrate.calibrate_board(
            job, layout or BoardLayout(), board_options, partial(bars.reach, "find the board")
        )
    write_rig(out, rig)
    error = np.median([pose.error_px for pose in result.poses])
    focal = result.camera.matrix[0, 0]
    report_rig(out, rig, f"{len(result.poses)} poses to {error:.2f} px, focal length {focal:.0f} px")


@limits_on("max_megapixels")
def lights(
    source: Path,
    /,
    *,
    out: Path,
    like: str | None = None,
    lights: Annotated[tuple[int, int, int], Parameter(consume_multiple=True, negative=())] = (0, 1, 2),
    light_colours: LightColours = LightColours.CHANNELS,
    transfer: Curve = "linear",
    camera: Path | None = None,
    focal_px: FocalPx = None,
) -> None:
    """Make a rig from lights whose directions and strengths are known.

    Parameters
    ----------
    source
        A DiLiGenT folder (light_directions.txt, light_intensities.txt, filenames.txt), or a text file with
        x y z, and perhaps red green blue, per light; x right, y up, z towards the viewer.
    out
        The rig.json to write.
    like
        Footage of the rig, for the image size; default: the first image that the folder names.
    lights
        Which three of the lights, counted from 0, are the red, the green and the blue one.
    light_colours
        Whether the intensities are the lights' colours, or channel k sees light k alone.
    camera
        A rig.json whose camera is taken; default: orthographic.
    """
    require_output(out, JSON)
    job = _job(str(source), None, None, transfer, camera, focal_px, None, "::")
    rig = calibrate.calibrate_lights(source, like, lights, light_colours, job)
    write_rig(out, rig)
    report_rig(out, rig, f"lights {lights[0]}, {lights[1]}, {lights[2]} of {source}")


def _job(
    source: str,
    mask: Path | None,
    background: Path | None,
    transfer: str,
    camera: Path | None,
    focal_px: float | None,
    single_light: tuple[Path, ...] | None,
    frames: str,
) -> calibrate.CalibrationJob:
    return calibrate.CalibrationJob(
        source=source,
        mask=mask,
        background=background,
        transfer=Transfer.from_text(transfer),
        camera=camera,
        focal_px=focal_px,
        single_light=single_light or (),
        frames=FrameRange.from_text(frames),
    )


def report_rig(out: Path, rig: Rig, seen: str) -> None:
    """Say what was fitted and how well."""
    print(f"{out}: {seen}")
    quality = rig.quality
    if quality is not None and quality.samples:
        print(
            f"  residual          {quality.residual_deg:.2f} degrees, median over {quality.samples} samples"
        )
        print(f"  cone of normals   {quality.cone_deg:.0f} degrees about their mean")
    print(f"  condition number  {rig.response.condition_number:.1f} (1 is best, below 10 is good)")
    if rig.response.variation is not None:
        print("  varies over the image; the condition number is that of its centre")
        return
    title = "lights" if rig.response.light_colours is not None else "lights (channel by channel)"
    tilts = np.rad2deg(np.arccos(np.clip(-rig.response.light_directions[:, 2], -1, 1)))
    print(f"  {title}: {', '.join(f'{tilt:.0f}' for tilt in tilts)} degrees from the optical axis")

"""`vntoolkit calibrate …`: fit a rig to footage of a calibration object and write rig.json."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np

from vntoolkit.calibration.ball_lamps import LitBall
from vntoolkit.calibration.fit import ResponseFit
from vntoolkit.cli.output import (
    JSON,
    MESH,
    PAGE,
    PICTURE,
    print_next,
    require_output,
    say,
    unused,
)
from vntoolkit.cli.verb import verb
from vntoolkit.diagnosis.finding import judge, require_known_checks
from vntoolkit.diagnosis.rig_checks import check_lamps, check_residual
from vntoolkit.diagnosis.transfer_match import check_transfer_of_samples
from vntoolkit.errors import BadInput
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.footage.captures import Capture, CaptureOptions, open_capture
from vntoolkit.io.maps_and_meshes.meshes import write_mesh
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.libraries import require_installed
from vntoolkit.options.base import File, Named, OptionalFile, Options, Source, as_path, named
from vntoolkit.options.calibration import (
    BoardOptions,
    LightColours,
    LightColoursName,
    ResponseFitOptions,
)
from vntoolkit.options.footage import PictureLimits, SensorOptions
from vntoolkit.options.head import HeadOptions
from vntoolkit.options.shared import (
    CornerOptions,
    CurveOptions,
)
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline import calibrate
from vntoolkit.pipeline import calibrate_presses as pipeline
from vntoolkit.pipeline.calibrate import CalibrationJob, SphereJob
from vntoolkit.pipeline.calibrate_head import HeadCalibration
from vntoolkit.pipeline.calibrate_head import calibrate_head as fit_head
from vntoolkit.pipeline.calibrate_presses import PressJob
from vntoolkit.pipeline.corners import rectification_from_corners, rig_with_corners
from vntoolkit.tactile.fit import GelFit


@dataclass(frozen=True, kw_only=True)
class RigOptions(Options):
    """Where a rig is written."""

    out: File
    """The rig.json to write."""


def _require_possible(allow: tuple[str, ...], out: File) -> None:
    """Raise `BadInput` for a check that there is not, or a rig that cannot be written."""
    require_known_checks(allow)
    require_output(Path(out), JSON)


@dataclass(frozen=True, kw_only=True)
class SphereArguments(RigOptions, SphereJob):
    """What `calibrate_sphere` takes."""


@verb(SphereArguments)
def calibrate_sphere(asked: SphereArguments) -> Rig:
    """Calibrate on a matte ball of the material, at rest under all lights, or one after the other."""
    _require_possible(asked.allow, asked.out)
    rig, result = calibrate.calibrate_sphere(asked)
    _keep(Path(asked.out), rig, asked, result.fit)
    (u, v), radius = result.outline.centre_px, result.outline.radius_px
    report_rig(Path(asked.out), rig, f"ball at ({u:.1f}, {v:.1f}), radius {radius:.1f} px")
    if result.lit is not None:
        _report_lamps(result.lit, rig.camera.is_perspective)
    _print_what_is_next(asked.out)
    return rig


def _report_lamps(lit: LitBall, is_perspective: bool) -> None:
    """Print how far the lamps are from the ball, and the light of the room."""
    away = [f"{1.0 / lamp.closeness:.0f}" if lamp.closeness else "over 100" for lamp in lit.lamps]
    say(f"  lamps' distance   {', '.join(away)} radii of the ball (red, green, blue)")
    if not is_perspective:
        say("                    (or nearer: give --camera or --focal-px to measure it)")
    room = ", ".join(f"{100.0 * share:.1f}" for share in lit.room)
    say(f"  light of the room {f'{room} % of full scale' if lit.is_room_known else 'not told'}")


@dataclass(frozen=True, kw_only=True)
class BoardArguments(RigOptions, CalibrationJob, BoardOptions, ResponseFitOptions, BoardLayout):
    """What `calibrate_board` takes."""


@verb(BoardArguments)
def calibrate_board(asked: BoardArguments) -> Rig:
    """Calibrate on the printed board, tilted in all directions, with the subject's material in its hole."""
    _require_possible(asked.allow, asked.out)
    rig, result = calibrate.calibrate_board(asked, asked.part(BoardLayout), asked.part(BoardOptions))
    _keep(Path(asked.out), rig, asked, result.fit)
    error = np.median([pose.error_px for pose in result.poses])
    focal = result.camera.matrix[0, 0]
    seen = f"{len(result.poses)} poses to {error:.2f} px, focal length {focal:.0f} px"
    report_rig(Path(asked.out), rig, seen)
    _print_what_is_next(asked.out)
    return rig


@dataclass(frozen=True, kw_only=True)
class LightsArguments(RigOptions, CalibrationJob):
    """What `calibrate_lights` takes."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("background", "single_light", "frames")

    source: Source = field(kw_only=False)
    """A DiLiGenT folder (light_directions.txt, light_intensities.txt, filenames.txt), or a text file with a
    line per light: x y z, or x y z red green blue. x right, y up, z towards the viewer."""
    like: str | os.PathLike[str] | None = None
    """Footage of the rig, which gives the image size. Default: the first image that the folder names."""
    lights: tuple[int, int, int] = (0, 1, 2)
    """Numbers of the red, the green and the blue light, counted from 0."""
    light_colours: Named[LightColours, LightColoursName] = named(LightColours.CHANNELS)
    """Use the intensities as the lights' colours, or assume that channel k sees only light k."""


@verb(LightsArguments)
def calibrate_lights(asked: LightsArguments) -> Rig:
    """Compute a rig from known light directions and strengths."""
    _require_possible(asked.allow, asked.out)
    like = None if asked.like is None else str(asked.like)
    rig = calibrate.calibrate_lights(Path(asked.source), like, asked.lights, asked.light_colours, asked)
    _keep(Path(asked.out), rig, asked)
    numbers = ", ".join(map(str, asked.lights))
    report_rig(Path(asked.out), rig, f"lights {numbers} of {asked.source}")
    _print_what_is_next(asked.out)
    return rig


def _print_what_is_next(out: File) -> None:
    print_next("reconstruct", "capture.mkv", "--rig", str(out), "--out", unused("result"))


def _keep(out: Path, rig: Rig, job: CalibrationJob, fit: ResponseFit | None = None) -> None:
    """Write a rig; raise `FatalFinding` for one that its own lamps or samples contradict."""
    findings = [*check_lamps(rig), *check_residual(rig)]
    if fit is not None:
        findings += check_transfer_of_samples(fit.normals, fit.rgb, rig.transfer)
    judge(findings, job.allow)
    write_rig(out, rig)


def report_rig(out: Path, rig: Rig, seen: str) -> None:
    """Print what was fitted, its residual and its condition number."""
    say(f"{out}: {seen}")
    quality = rig.quality
    if quality is not None and quality.samples:
        say(f"  residual          {quality.residual_deg:.2f} degrees, median over {quality.samples} samples")
        say(f"  cone of normals   {quality.cone_deg:.0f} degrees about their mean")
    say(f"  transfer curve    {rig.transfer.to_text()}")
    if rig.material:
        say(f"  material          {rig.material}")
        if rig.response.light_colours is None:
            say("                    (others need the lamps' colours: each lamp alone for a while, or")
            say("                    --single-light, with calibrate sphere or board)")
    say(f"  condition number  {rig.response.condition_number:.1f} (1 is best, below 10 is good)")
    if rig.response.variation is not None:
        say("  M varies over the image; the condition number is that of the centre")
        if rig.response.light_colours is None:
            return
    tilts = np.rad2deg(np.arccos(np.clip(-rig.response.light_directions[:, 2], -1, 1)))
    tilts_text = f"{', '.join(f'{tilt:.0f}' for tilt in tilts)} degrees from the optical axis"
    if rig.response.light_colours is not None:
        say(f"  lights            {tilts_text}")
    else:
        say(f"  rows of M         {tilts_text} (red, green, blue channel;")
        say("                    the lights lie further out where a channel sees several of them)")


@dataclass(frozen=True, kw_only=True)
class HeadArguments(RigOptions, CalibrationJob, HeadOptions):
    """What `calibrate_head` takes."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("single_light",)

    mesh: OptionalFile = named(None)
    """Also write the head's mesh, .ply or .obj, with normals and the skin's colour. Its length unit is the
    distance to the camera. In .ply, `quality` is the angle in degrees that nine of ten normals stay
    within."""
    figure: OptionalFile = named(None)
    """Also write a picture of tracks, shape, samples and lights, .png or .svg."""
    report: OptionalFile = named(None)
    """Also write a page about tracks, poses, shape, samples and lights, .html."""


@verb(HeadArguments)
def calibrate_head(asked: HeadArguments) -> Rig:
    """Calibrate on a bare head that turns fully left and right, with a fixed expression, in a dark room.

    60 to 120 frames are enough.
    """
    require_installed("pycolmap", "pycolmap", "calibrate head adjusts poses by pycolmap")
    _require_possible(asked.allow, asked.out)
    for path, suffixes in ((asked.mesh, MESH), (asked.figure, PICTURE), (asked.report, PAGE)):
        require_output(path, suffixes)
    rig, result = fit_head(asked, asked.part(HeadOptions))
    _keep(Path(asked.out), rig, asked)
    if asked.mesh is not None:
        write_mesh(asked.mesh, result.mesh)
    if asked.figure is not None:
        from vntoolkit.report.head import write_head_figure

        write_head_figure(asked.figure, asked, result)
    if asked.report is not None:
        from vntoolkit.report.head import write_head_page

        write_head_page(asked.report, asked, rig, result)
    _report_head(asked, rig, result)
    _print_what_is_next(asked.out)
    return rig


def _report_head(asked: HeadArguments, rig: Rig, result: HeadCalibration) -> None:
    """Print the poses, the rig and the shape."""
    motion = result.motion
    seen = (
        f"{len(motion.camera_from_head)} poses over {motion.turn_deg:.0f} degrees, "
        f"{len(motion.point)} tracks to {motion.error_px:.2f} px"
    )
    report_rig(Path(asked.out), rig, seen)
    if asked.camera is None and asked.focal_px is None:
        say(f"  focal length      {motion.camera.matrix[0, 0]:.0f} px, estimated from the turn: rough")
    say(f"  samples agreeing  {result.light.inliers.mean():.0%}")
    if result.refined is not None:
        changes = ", ".join(f"{100 * change:.1f} %" for change in result.refined.changes)
        say(f"  refined           M moved by {changes}")
        error = np.median(result.refined.error_percent)
        say(f"  shape             {error:.2f} % of its diagonal expected error, median")
    say("  time              " + ", ".join(f"{k} {s:.0f} s" for k, s in result.stage_seconds.items()))


@dataclass(frozen=True, kw_only=True)
class PressesArguments(PressJob):
    """What `calibrate_presses` takes."""

    out: File
    """The rig.json to write."""
    overlay: OptionalFile = named(None)
    """Also write a picture of all presses with their circles over a labelled grid, .png or .svg."""


@verb(PressesArguments)
def calibrate_presses(asked: PressesArguments) -> Rig:
    """Calibrate a tactile sensor on presses of a ball of known size into its gel.

    The contact circles are found. The rig keeps --corners, so `reconstruct` and `live` rectify the picture
    without them. Both need --background, a picture of the untouched gel. Depth is 0 at the untouched gel and
    negative in a dent, which is nearer to the camera.
    """
    _require_possible(asked.allow, asked.out)
    require_output(as_path(asked.overlay), PICTURE)
    if asked.overlay is not None:  # also of presses that no rig can be fitted to
        from vntoolkit.report.presses import write_press_overlay

        write_press_overlay(asked.overlay, asked)
    result = pipeline.calibrate_presses(asked)
    judge([*result.findings, *check_lamps(result.rig), *check_residual(result.rig)], asked.allow)
    write_rig(Path(asked.out), result.rig)
    report_rig(Path(asked.out), result.rig, f"presses of {asked.source}")
    _report_presses(result, asked)
    background = str(asked.background)
    print_next(
        "reconstruct", "touch.mkv", "--rig", str(asked.out), "--background", background, "--out", "touch"
    )
    return result.rig


def _report_presses(result: pipeline.PressCalibration, asked: PressesArguments) -> None:
    """Print which circles were taken, the ball, the scale and the sign of depth."""
    held_back, camera = result.fit.held_back_deg, result.rig.camera
    if np.isfinite(held_back):
        say(f"  held back         {held_back:.2f} degrees, median on presses that a fit did not see")
    took = "found" if asked.labels is None else f"as labelled in {asked.labels}"
    say(f"  contact circles   {result.used}, {took}{_moves(result.fit)}")
    if result.passed_over:
        names = ", ".join(result.passed_over[:5]) + (" …" if len(result.passed_over) > 5 else "")
        without = "a dent that is symmetric" if asked.labels is None else "a label"
        say(f"  passed over       {len(result.passed_over)} images without {without}: {names}")
        say("                    (--overlay circles.png draws them, --circle gives one a circle)")
    radii, across = (", ".join(f"{k * r:g}" for r in result.ball_radii_mm) for k in (1, 2))
    say(f"  ball              {radii} mm in radius, {across} mm across")
    side_mm = asked.options.side_mm
    width, height = camera.width * side_mm, camera.height * side_mm
    scale = f"{side_mm:.4g} mm a pixel in u and v, {width:.1f}×{height:.1f} mm"
    say(f"  scale             {scale}; depth is 0 at rest, negative in a dent")


def _moves(fit: GelFit) -> str:
    """How far the circles lay from their dents."""
    if not fit.label_scatter_px:
        return ""
    u, v = fit.label_offset_px
    common = f" all by ({u:.1f}, {v:.1f}) pixels and" if u or v else ""
    return f"; moved to their dents,{common} each by {fit.label_scatter_px:.1f} (median)"


@dataclass(frozen=True, kw_only=True)
class RectifyArguments(CornerOptions, CurveOptions, SensorOptions, PictureLimits):
    """What `rectify` takes."""

    source: Source = field(kw_only=False)
    """A video, an image, a folder of images, or a pattern."""
    out: File
    """The folder to write: 16-bit PNG files with the same transfer curve."""
    rig: OptionalFile = named(None)
    """The rig.json of a tactile gel. Its corners, size, pixels and transfer curve are taken where none are
    given."""
    pixel_mm: float | None = None
    """Side of a pixel of the result in millimetres."""
    overwrite: bool = False
    """Replace the images that the folder holds."""


@verb(RectifyArguments)
def rectify(asked: RectifyArguments) -> Path:
    """Resample footage of a tilted plane to square pixels of known size; return the folder."""
    known = None if asked.rig is None else read_rig(asked.rig)
    curve = asked.curve or (None if known is None else known.transfer)
    options = CaptureOptions(transfer=curve, sensor=asked.part(SensorOptions))
    capture = open_capture(str(asked.source), options)
    rectification = _rectification(asked, known, (capture.info.width, capture.info.height))
    count = pipeline.rectify_capture(capture, rectification, Path(asked.out), overwrite=asked.overwrite)
    _report_rectified(asked, count, rectification, capture)
    return Path(asked.out)


def _rectification(asked: RectifyArguments, known: Rig | None, filmed: tuple[int, int]) -> Rectification:
    if known is None:
        rectification = rectification_from_corners(asked, asked.pixel_mm)
        if rectification is None:
            raise BadInput("rectify: expected --corners and --size-mm, or the --rig of a tactile gel")
        return rectification
    if asked.pixel_mm is not None:
        raise BadInput("rectify: --pixel-mm is the rig's; leave it out, or leave out --rig")
    known = rig_with_corners(known, asked, filmed)
    if known.gel is None or known.gel.rectification is None:
        raise BadInput(f"{asked.rig}: holds no corners of a gel; give --corners and --size-mm")
    known.require_size(*filmed, str(asked.source))
    return known.gel.rectification


def _report_rectified(
    asked: RectifyArguments, count: int, rectification: Rectification, capture: Capture
) -> None:
    """Print what was written and left out."""
    width, height = rectification.size
    source = Path(asked.source)
    if source.is_dir():
        left_out = sum(path.is_file() for path in source.iterdir()) - len(capture.info.files)
        if left_out:
            say(f"{source}: {left_out} files that are no images were left out")
    say(f"{asked.out}: {count} images of {width}×{height}, {rectification.pixel_mm:g} mm a pixel")
    ball = ("--ball-radius-mm", "2", "--pixel-mm", f"{rectification.pixel_mm:g}")
    print_next("calibrate", "presses", str(asked.out), "--background", "gel.png", *ball, "--out", "gel.json")

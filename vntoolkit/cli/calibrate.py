"""`vntoolkit calibrate …`: fit a rig to footage of a calibration object and write rig.json."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from cyclopts import Parameter

from vntoolkit.calibration.ball_lamps import LitBall
from vntoolkit.calibration.board import BoardOptions
from vntoolkit.calibration.fit import ResponseFit
from vntoolkit.calibration.lights import LightColours
from vntoolkit.calibration.sphere import SphereOptions
from vntoolkit.cli import flags
from vntoolkit.cli.output import JSON, MESH, PAGE, PICTURE, ProgressBars, print_next, require_output
from vntoolkit.diagnosis.checks import CHECK_NAMES
from vntoolkit.diagnosis.finding import judge, require_known_checks
from vntoolkit.diagnosis.rig_checks import check_lamps, check_residual
from vntoolkit.diagnosis.transfer_match import check_transfer_of_samples
from vntoolkit.errors import BadInput
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.mattes import MatteOptions
from vntoolkit.io.footage.mosaics import SensorOptions
from vntoolkit.io.maps_and_meshes.meshes import write_mesh
from vntoolkit.io.rigs import read_rig, write_rig
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline import calibrate
from vntoolkit.pipeline import calibrate_presses as pipeline
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import HeadOptions, calibrate_head
from vntoolkit.tactile.fit import GelFit
from vntoolkit.tactile.presses import PressOptions

_OF_LIGHTS = flags.Flags(without=("background", "single_light", "frames"))
_FIT = flags.Flags(renamed={"method": "fit-method"})
RigOut: TypeAlias = Annotated[Path, Parameter(help="The rig.json to write.")]
SizePx: TypeAlias = Annotated[tuple[int, int] | None, Parameter(consume_multiple=True, negative=())]


@dataclass(frozen=True, kw_only=True)
class FootageFlags:
    """What the calibrations ask of their footage.

    camera: a rig.json whose camera is taken. Default: orthographic (sphere, lights), fitted to the same
    footage (board), or of a focal length that is estimated from the turn, which is rough (head).
    """

    background: flags.AmbientImage = None
    transfer: flags.Curve = None
    sensor: SensorOptions = field(default_factory=SensorOptions)
    camera: Path | None = None
    focal_px: flags.FocalPx = None
    single_light: flags.SingleLight = None
    frames: flags.Frames = "::"
    allow: flags.Allow = ()

    def job(self, source: str, **more: Any) -> CalibrationJob:
        """Return the calibration of this footage; more: further fields of it."""
        require_known_checks(self.allow, CHECK_NAMES)
        as_given = ("background", "sensor", "camera", "focal_px", "allow")
        return CalibrationJob(
            source=source,
            transfer=flags.curve_from_text(self.transfer),
            single_light=self.single_light or (),
            frames=FrameRange.from_text(self.frames),
            **{name: getattr(self, name) for name in as_given},
            **more,
        )


@flags.verb("max_megapixels")
def sphere(
    source: str,
    /,
    *,
    out: RigOut,
    mask: Path | None = None,
    matting: Annotated[MatteOptions | None, flags.Flags()] = None,
    footage: Annotated[FootageFlags | None, flags.Flags()] = None,
    options: Annotated[SphereOptions | None, _FIT] = None,
) -> None:
    """Calibrate on a matte ball of the subject's material, at rest under all lights, or one after the other.

    Parameters
    ----------
    source
        A video, an image, a folder of images, or a pattern. Several frames are averaged.
    mask
        White where the ball is: an image, or a video, a folder or a pattern with a matte for each frame.
        Default: the outline is detected.
    """
    job = (footage or FootageFlags()).job(source, mask=mask, matting=matting or MatteOptions())
    require_output(out, JSON)
    rig, result = calibrate.calibrate_sphere(job, options or SphereOptions())
    (u, v), radius = result.outline.centre_px, result.outline.radius_px
    _finish(out, rig, job, f"ball at ({u:.1f}, {v:.1f}), radius {radius:.1f} px", result.fit)
    if result.lit is not None:
        _report_lamps(result.lit, rig.camera.is_perspective)
    _print_what_is_next(out)


def _report_lamps(lit: LitBall, is_perspective: bool) -> None:
    """Print how far the lamps are from the ball, and the light of the room."""
    away = [f"{1.0 / lamp.closeness:.0f}" if lamp.closeness else "over 100" for lamp in lit.lamps]
    print(f"  lamps' distance   {', '.join(away)} radii of the ball (red, green, blue)")
    if not is_perspective:
        print("                    (or nearer: --camera or --focal-px tells, and lets M change with it)")
    room = ", ".join(f"{100.0 * share:.1f}" for share in lit.room)
    print(f"  light of the room {f'{room} % of full scale' if lit.is_room_known else 'not told'}")


@flags.verb("max_megapixels")
def board(
    source: str,
    /,
    *,
    out: RigOut,
    footage: Annotated[FootageFlags | None, flags.Flags()] = None,
    layout: Annotated[BoardLayout | None, flags.Flags()] = None,
    options: Annotated[BoardOptions | None, _FIT] = None,
) -> None:
    """Calibrate on the printed board, tilted in all directions, with the subject's material in its hole.

    Parameters
    ----------
    source
        A video, a folder of images, or a pattern.
    """
    job = (footage or FootageFlags()).job(source)
    require_output(out, JSON)
    with ProgressBars() as bars:
        rig, result = calibrate.calibrate_board(
            job, layout or BoardLayout(), options or BoardOptions(), partial(bars.reach, "find the board")
        )
    error = np.median([pose.error_px for pose in result.poses])
    focal = result.camera.matrix[0, 0]
    seen = f"{len(result.poses)} poses to {error:.2f} px, focal length {focal:.0f} px"
    _finish(out, rig, job, seen, result.fit)
    _print_what_is_next(out)


@flags.verb("max_megapixels")
def lights(
    source: Path,
    /,
    *,
    out: RigOut,
    like: str | None = None,
    lights: Annotated[tuple[int, int, int], Parameter(consume_multiple=True, negative=())] = (0, 1, 2),
    light_colours: LightColours = LightColours.CHANNELS,
    footage: Annotated[FootageFlags | None, _OF_LIGHTS] = None,
) -> None:
    """Compute a rig from known light directions and strengths.

    Parameters
    ----------
    source
        A DiLiGenT folder (light_directions.txt, light_intensities.txt, filenames.txt), or a text file with a
        line per light: x y z, or x y z red green blue. x right, y up, z towards the viewer.
    like
        Footage of the rig, which gives the image size. Default: the first image that the folder names.
    lights
        Numbers of the red, the green and the blue light, counted from 0.
    light_colours
        Use the intensities as the lights' colours, or assume that channel k sees only light k.
    """
    job = (footage or FootageFlags()).job(str(source))
    require_output(out, JSON)
    rig = calibrate.calibrate_lights(source, like, lights, light_colours, job)
    _finish(out, rig, job, f"lights {lights[0]}, {lights[1]}, {lights[2]} of {source}")
    _print_what_is_next(out)


def _print_what_is_next(out: Path) -> None:
    print_next("reconstruct", "capture.mkv", "--rig", out, "--out", "result")


def _finish(out: Path, rig: Rig, job: CalibrationJob, seen: str, fit: ResponseFit | None = None) -> None:
    """Write and report a rig; raise `FatalFinding` for one that its own lamps or samples contradict."""
    findings = [*check_lamps(rig), *check_residual(rig)]
    if fit is not None:
        findings += check_transfer_of_samples(fit.normals, fit.rgb, rig.transfer)
    judge(findings, job.allow)
    write_rig(out, rig)
    report_rig(out, rig, seen)


def report_rig(out: Path, rig: Rig, seen: str) -> None:
    """Print what was fitted, its residual and its condition number."""
    print(f"{out}: {seen}")
    quality = rig.quality
    if quality is not None and quality.samples:
        print(
            f"  residual          {quality.residual_deg:.2f} degrees, median over {quality.samples} samples"
        )
        print(f"  cone of normals   {quality.cone_deg:.0f} degrees about their mean")
    print(f"  transfer curve    {rig.transfer.to_text()}")
    if rig.material:
        print(f"  material          {rig.material}")
        if rig.response.light_colours is None:
            print("                    (others need the lamps' colours: each lamp alone for a while, or")
            print("                    --single-light, with calibrate sphere or board)")
    print(f"  condition number  {rig.response.condition_number:.1f} (1 is best, below 10 is good)")
    if rig.response.variation is not None:
        print("  M varies over the image; the condition number is that of the centre")
        if rig.response.light_colours is None:
            return
    tilts = np.rad2deg(np.arccos(np.clip(-rig.response.light_directions[:, 2], -1, 1)))
    tilts_text = f"{', '.join(f'{tilt:.0f}' for tilt in tilts)} degrees from the optical axis"
    if rig.response.light_colours is not None:
        print(f"  lights            {tilts_text}")
    else:
        print(f"  rows of M         {tilts_text} (red, green, blue channel;")
        print("                    the lights lie further out where a channel sees several of them)")


@flags.verb("max_megapixels")
def head(
    source: str,
    /,
    *,
    out: RigOut,
    footage: Annotated[FootageFlags | None, flags.Flags(without=("single_light",))] = None,
    mesh: Path | None = None,
    figure: Path | None = None,
    report: Path | None = None,
    options: Annotated[HeadOptions | None, flags.Flags(without=("neighbour_angles_deg",))] = None,
) -> None:
    """Calibrate on a bare head that turns fully left and right, with a fixed expression, in a dark room.

    60 to 120 frames are enough.

    Parameters
    ----------
    source
        A video, a folder of images, or a pattern.
    mesh
        Also write the head's mesh, .ply or .obj, with normals and the skin's colour. Its length unit
        is the distance to the camera. In .ply, `quality` is the angle in degrees that nine of ten normals
        stay within.
    figure
        Also write a picture of tracks, shape, samples and lights, .png or .svg.
    report
        Also write a page about tracks, poses, shape, samples and lights, .html.
    """
    job = (footage or FootageFlags()).job(source)
    for path, suffixes in ((out, JSON), (mesh, MESH), (figure, PICTURE), (report, PAGE)):
        require_output(path, suffixes)
    with ProgressBars() as bars:
        rig, result = calibrate_head(job, options, bars.reach)
    motion = result.motion
    seen = (
        f"{len(motion.camera_from_head)} poses over {motion.turn_deg:.0f} degrees, "
        f"{len(motion.point)} tracks to {motion.error_px:.2f} px"
    )
    _finish(out, rig, job, seen)
    if mesh is not None:
        write_mesh(mesh, result.mesh)
    if figure is not None:
        from vntoolkit.report.head import write_head_figure

        write_head_figure(figure, job, result)
    if report is not None:
        from vntoolkit.report.head import write_head_page

        write_head_page(report, job, rig, result)
    if job.camera is None and job.focal_px is None:
        print(f"  focal length      {motion.camera.matrix[0, 0]:.0f} px, estimated from the turn: rough")
    print(f"  samples agreeing  {result.light.inliers.mean():.0%}")
    if result.refined is not None:
        changes = ", ".join(f"{100 * change:.1f} %" for change in result.refined.changes)
        print(f"  refined           M moved by {changes}")
        error = np.median(result.refined.error_percent)
        print(f"  shape             {error:.2f} % of its diagonal expected error, median")
    print("  time              " + ", ".join(f"{k} {s:.0f} s" for k, s in result.stage_seconds.items()))
    _print_what_is_next(out)


@flags.verb("max_megapixels")
def presses(
    source: str,
    /,
    *,
    out: RigOut,
    background: Path,
    options: Annotated[PressOptions, flags.Flags()],
    labels: Path | None = None,
    circle: Annotated[tuple[tuple[str, float, float, float], ...], Parameter(negative=())] = (),
    overlay: Path | None = None,
    corners: flags.Corners = None,
    size_mm: flags.SizeMm = None,
    label_size: SizePx = None,
    transfer: flags.Curve = None,
    allow: flags.Allow = (),
    sensor: flags.Sensor = None,
) -> None:
    """Calibrate a tactile sensor on presses of a ball of known size into its gel.

    The contact circles are found. The rig keeps --corners, so that `reconstruct` and `live` rectify without
    being told; give both a --background, the gel untouched. Depth is 0 at the untouched gel and negative in a
    dent, which is nearer to the camera.

    Parameters
    ----------
    source
        A folder or pattern of images, one for each press.
    background
        Image of the untouched gel.
    labels
        A folder of text files, NAME.txt for NAME.jpg: u v contact_radius in pixels of the rectified image; an
        image without one is passed over. Or a text file of lines NAME.jpg u v contact_radius; the circles of
        other images are found. Default: all contact circles are found.
    circle
        Name of an image, and u v contact_radius in pixels of the rectified image: the circle of a press that
        was passed over, or found beside its dent. May be given several times.
    overlay
        Also write a picture of all presses with their circles over a labelled grid, .png or .svg.
    label_size
        Width and height of the image that the labels refer to; default: the rectified one.
    """
    require_known_checks(allow, CHECK_NAMES)
    for path, suffixes in ((out, JSON), (overlay, PICTURE)):
        require_output(path, suffixes)
    job = pipeline.PressJob(
        source=source,
        background=background,
        labels=labels,
        circles=circle,
        transfer=flags.curve_from_text(transfer),
        sensor=sensor or SensorOptions(),
        rectification=flags.rectification_from_flags(corners, size_mm, options.pixel_mm),
        label_size=label_size,
        allow=allow,
    )
    if overlay is not None:  # also of presses that no rig can be fitted to
        from vntoolkit.report.presses import write_press_overlay

        write_press_overlay(overlay, job)
    with ProgressBars() as bars:
        result = pipeline.calibrate_presses(job, options, partial(bars.reach, "read presses"))
    rig = result.rig
    judge([*result.findings, *check_lamps(rig), *check_residual(rig)], allow)
    write_rig(out, rig)
    report_rig(out, rig, f"presses of {source}")
    _report_presses(result, options, labels)
    print_next("reconstruct", "touch.mkv", "--rig", out, "--background", background, "--out", "touch")


def _report_presses(result: pipeline.PressCalibration, options: PressOptions, labels: Path | None) -> None:
    """Print which circles were taken, the ball, the scale and the sign of depth."""
    held_back, camera = result.fit.held_back_deg, result.rig.camera
    if np.isfinite(held_back):
        print(f"  held back         {held_back:.2f} degrees, median on presses that a fit did not see")
    took = "found" if labels is None else f"as labelled in {labels}"
    print(f"  contact circles   {result.used}, {took}{_moves(result.fit)}")
    if result.passed_over:
        names = ", ".join(result.passed_over[:5]) + (" …" if len(result.passed_over) > 5 else "")
        without = "a dent that is symmetric" if labels is None else "a label"
        print(f"  passed over       {len(result.passed_over)} images without {without}: {names}")
        print("                    (--overlay circles.png draws them, --circle gives one a circle)")
    radius = options.ball_radius_mm
    print(f"  ball              {radius:g} mm in radius, {2 * radius:g} mm across")
    width, height = camera.width * options.pixel_mm, camera.height * options.pixel_mm
    scale = f"{options.pixel_mm:g} mm a pixel in u and v, {width:.1f}×{height:.1f} mm"
    print(f"  scale             {scale}; depth is 0 at rest, negative in a dent")


def _moves(fit: GelFit) -> str:
    """How far the circles lay from their dents."""
    if not fit.label_scatter_px:
        return ""
    u, v = fit.label_offset_px
    common = f" all by ({u:.1f}, {v:.1f}) pixels and" if u or v else ""
    return f"; moved to their dents,{common} each by {fit.label_scatter_px:.1f} (median)"


@flags.verb("max_megapixels")
def rectify(
    source: str,
    /,
    *,
    out: Path,
    rig: Path | None = None,
    corners: flags.Corners = None,
    size_mm: flags.SizeMm = None,
    pixel_mm: float | None = None,
    transfer: flags.Curve = None,
    sensor: flags.Sensor = None,
    overwrite: flags.Overwrite = False,
) -> None:
    """Resample footage of a tilted plane to square pixels of known size.

    Parameters
    ----------
    source
        A video, an image, a folder of images, or a pattern.
    out
        The folder to write: 16-bit PNG files with the same transfer curve.
    rig
        The rig.json of a tactile gel. Its corners, size, pixels and transfer curve are taken where none are
        given.
    pixel_mm
        Side of a pixel of the result in millimetres.
    overwrite
        Replace the images that the folder holds.
    """
    known = None if rig is None else read_rig(rig)
    curve = flags.curve_from_text(transfer) or (None if known is None else known.transfer)
    capture = open_capture(source, CaptureOptions(transfer=curve, sensor=sensor or SensorOptions()))
    filmed = (capture.info.width, capture.info.height)
    if known is None:
        if corners is None or size_mm is None or pixel_mm is None:
            raise BadInput(
                "rectify: expected --corners, --size-mm and --pixel-mm, or the --rig of a tactile gel"
            )
        rectification = flags.rectification_from_flags(corners, size_mm, pixel_mm)
    else:
        if pixel_mm is not None:
            raise BadInput("rectify: --pixel-mm is the rig's; leave it out, or leave out --rig")
        known = flags.rig_with_corners(known, corners, size_mm, filmed)
        rectification = None if known.gel is None else known.gel.rectification
        if rectification is None:
            raise BadInput(f"{rig}: holds no corners of a gel; give --corners, --size-mm and --pixel-mm")
        known.require_size(*filmed, source)
        pixel_mm = rectification.pixel_mm
    assert rectification is not None  # of corners and a size
    with ProgressBars() as bars:
        count = pipeline.rectify_capture(
            capture, rectification, out, partial(bars.reach, "rectify"), overwrite=overwrite
        )
    width, height = rectification.size
    if Path(source).is_dir():
        left_out = sum(path.is_file() for path in Path(source).iterdir()) - len(capture.info.files)
        if left_out:
            print(f"{source}: {left_out} files that are no images were left out")
    print(f"{out}: {count} images of {width}×{height}, {pixel_mm:g} mm a pixel")
    ball = ("--ball-radius-mm", "2", "--pixel-mm", f"{pixel_mm:g}")
    print_next("calibrate", "presses", out, "--background", "gel.png", *ball, "--out", "gel.json")

"""`vntoolkit calibrate head`: footage of a turning head in, rig.json out."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from vntoolkit.calibration.head.contrast import ContrastOptions
from vntoolkit.calibration.head.fusion import FusionOptions
from vntoolkit.calibration.head.hull import HullOptions
from vntoolkit.calibration.head.light import LightOptions
from vntoolkit.calibration.head.poses import PoseOptions, PoseStart
from vntoolkit.calibration.head.samples import SampleOptions
from vntoolkit.calibration.head.sift import SiftOptions
from vntoolkit.calibration.head.silhouettes import SilhouetteOptions
from vntoolkit.calibration.head.stereo import StereoOptions
from vntoolkit.calibration.head.tracks import TrackOptions
from vntoolkit.cli.calibrate import report_rig
from vntoolkit.cli.flags import flags_from
from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import JSON, MESH, PAGE, PICTURE, require_output
from vntoolkit.cli.progress import ProgressBars
from vntoolkit.cli.shared_flags import AmbientImage, Curve, FocalPx, Frames
from vntoolkit.io.frame_range import FrameRange
from vntoolkit.io.meshes import write_mesh
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import HeadOptions, HeadShape, calibrate_head
from vntoolkit.pipeline.head_footage import Features, FollowOptions

if TYPE_CHECKING:
    ContrastFlags: TypeAlias = ContrastOptions | None
    SilhouetteFlags: TypeAlias = SilhouetteOptions | None
    TrackFlags: TypeAlias = TrackOptions | None
    SiftFlags: TypeAlias = SiftOptions | None
    PoseFlags: TypeAlias = PoseOptions | None
    HullFlags: TypeAlias = HullOptions | None
    StereoFlags: TypeAlias = StereoOptions | None
    FusionFlags: TypeAlias = FusionOptions | None
    SampleFlags: TypeAlias = SampleOptions | None
    LightFlags: TypeAlias = LightOptions | None
else:
    ContrastFlags = flags_from(ContrastOptions)
    SilhouetteFlags = flags_from(SilhouetteOptions)
    TrackFlags = flags_from(TrackOptions)
    SiftFlags = flags_from(SiftOptions)
    PoseFlags = flags_from(PoseOptions)
    HullFlags = flags_from(HullOptions)
    StereoFlags = flags_from(StereoOptions, without=("neighbour_angles_deg", "closer_angles_deg"))
    FusionFlags = flags_from(FusionOptions)
    SampleFlags = flags_from(SampleOptions)
    LightFlags = flags_from(LightOptions)


@limits_on("max_megapixels")
def head(
    source: str,
    /,
    *,
    out: Path,
    background: AmbientImage = None,
    transfer: Curve = "linear",
    camera: Path | None = None,
    focal_px: FocalPx = None,
    frames: Frames = "::",
    mesh: Path | None = None,
    figure: Path | None = None,
    report: Path | None = None,
    features: Features = Features.TRACKS,
    pose_start: PoseStart | None = None,
    head_shape: HeadShape = HeadShape.FUSED,
    contrast: ContrastFlags = None,
    silhouettes: SilhouetteFlags = None,
    tracks: TrackFlags = None,
    sift: SiftFlags = None,
    poses: PoseFlags = None,
    hull: HullFlags = None,
    stereo: StereoFlags = None,
    fusion: FusionFlags = None,
    samples: SampleFlags = None,
    light: LightFlags = None,
) -> None:
    """Calibrate on a bare head that turns all the way left and right, with a fixed expression, in the dark.

    60 to 120 frames are plenty.

    Parameters
    ----------
    source
        A video, a folder of images, or a pattern.
    out
        The rig.json to write.
    camera
        A rig.json whose camera is taken; best. Without it and --focal-px the focal length is fitted to the
        turn, roughly.
    mesh
        Also write the head's mesh, .ply or .obj; its unit is the distance from the camera.
    figure
        Also write a picture of tracks, shape, samples and lights, .png or .svg.
    report
        Also write a page about tracks, poses, shape, samples and lights, .html.
    features
        What is recognised from frame to frame: skin followed in a video, or SIFT features of photographs that
        lie up to 20 degrees apart.
    pose_start
        Where the first guess of the poses comes from; default: factorisation for tracks, mapping for features
        and, where it fails, factorisation.
    head_shape
        Shape that gives the normals: silhouettes alone, or fused with stereo.
    """
    for path, suffixes in ((out, JSON), (mesh, MESH), (figure, PICTURE), (report, PAGE)):
        require_output(path, suffixes)
    job = CalibrationJob(
        source=source,
        background=background,
        transfer=Transfer.from_text(transfer),
        camera=camera,
        focal_px=focal_px,
        frames=FrameRange.from_text(frames),
    )
    options = HeadOptions(
        head_shape=head_shape,
        pose_start=pose_start,
        following=FollowOptions(
            features=features,
            contrast=contrast or ContrastOptions(),
            silhouettes=silhouettes or SilhouetteOptions(),
            tracks=tracks or TrackOptions(),
            sift=sift or SiftOptions(),
        ),
        poses=poses or PoseOptions(),
        hull=hull or HullOptions(),
        stereo=stereo or StereoOptions(),
        fusion=fusion or FusionOptions(),
        samples=samples or SampleOptions(),
        light=light or LightOptions(),
    )
    with ProgressBars() as bars:
        rig, result = calibrate_head(job, options, bars.reach)
    write_rig(out, rig)
    if mesh is not None:
        write_mesh(mesh, result.mesh)
    if figure is not None:
        from vntoolkit.report.head_figure import write_head_figure

        write_head_figure(figure, job, result)
    if report is not None:
        from vntoolkit.report.head_page import write_head_page

        write_head_page(report, job, rig, result)
    motion = result.motion
    report_rig(
        out,
        rig,
        f"{len(motion.camera_from_head)} poses over {motion.turn_deg:.0f} degrees, "
        f"{len(motion.point)} tracks to {motion.error_px:.2f} px",
    )
    if camera is None and focal_px is None:
        print(f"  focal length      {motion.camera.matrix[0, 0]:.0f} px, fitted to the turn: a rough guess")
    print(f"  samples agreeing  {result.light.inliers.mean():.0%}")
    print("  time              " + ", ".join(f"{k} {s:.0f} s" for k, s in result.stage_seconds.items()))

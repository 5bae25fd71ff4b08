"""`vntoolkit track`: register all frames of a reconstruction to one mesh."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from vntoolkit.cli.output import ProgressBars, print_next, say
from vntoolkit.cli.verb import command, verb
from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.io.results.seams import read_seams
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.shared import MovedFootageOptions
from vntoolkit.options.tracking import LOST_PX, CheckerboardOptions, TrackingOptions
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.texture import write_texture
from vntoolkit.pipeline.track import TrackJob, TrackSummary
from vntoolkit.pipeline.track import track as run

if TYPE_CHECKING:
    from vntoolkit.tactile.pose import TrackedPose


@dataclass(frozen=True, kw_only=True)
class TrackArguments(MovedFootageOptions, TrackingOptions, CheckerboardOptions, ReadingLimits):
    """What `track` takes."""

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote, with normals and depth."""
    seams: OptionalFile = named(None)
    """JSON file of polylines on the template image. The surface is cut along them, as at mouth and eyes."""
    template: int | None = None
    """Number of the template frame. Default: the one that shows most of the surface, lit and sharp; with
    --seams the first. It is tracked forwards and backwards."""
    out: OptionalFile = named(None)
    """The folder to write; default FOLDER/track."""
    lost_px: float = LOST_PX
    """A vertex is called lost where its expected error is above this, in pixels."""
    background: OptionalFile = named(None)
    """The background image that the reconstruction subtracted, for the colours of the texture."""
    object: bool = False
    """On a tactile gel: also write object.csv, the pose of what touches it, frame by frame."""
    overwrite: bool = False
    """Replace the tracks that the folder holds."""


@verb(TrackArguments)
def track(asked: TrackArguments) -> MeshSequence:
    """Register the frames of a reconstruction to one mesh of fixed topology, and draw a checkerboard on it.

    Its texture is gathered from the footage, which is read again for that. The same command again continues
    an interrupted run.
    """
    job = TrackJob(
        folder=Path(asked.folder),
        options=asked.part(TrackingOptions),
        template=asked.template,
        seams=() if asked.seams is None else read_seams(asked.seams),
        out=asked.out,
        lost_px=asked.lost_px,
        footage=asked.footage,
        background=asked.background,
    )
    with ProgressBars() as bars:
        begin = partial(bars.begin, "track")
        summary = run(job, overwrite=asked.overwrite, on_start=begin, on_frame=bars.step)
    if asked.object:
        from vntoolkit.pipeline.object_poses import write_object_poses

        _report_poses(write_object_poses(job.folder, job.target))
    files = write_checkerboard(job.folder, job.target, asked.part(CheckerboardOptions))
    _report(summary)
    say(f"{files.video}, {files.sheet.name}")
    made = write_texture(job.folder, job.target, footage=asked.footage, background=asked.background)
    shown = made.texture.albedo or made.texture.normal
    say(f"{shown}: {made.covered:.1%} of the surface from {made.frames} frames, the rest filled")
    print_next("dress", job.target, "--motion", "data/walk.bvh", "--out", "cloth.usdc")
    return read_mesh_sequence(job.target)


def _report_poses(poses: "list[TrackedPose]") -> None:
    known = [pose for pose in poses if not pose.lost]
    line = f"object.csv: pose in {len(known)} of {len(poses)} frames"
    if known:
        line += f", within {max(p.error_deg for p in known):.1f} degrees and "
        line += f"{max(p.error_mm for p in known):.2f} mm; unobservable directions: "
        line += f"{max(len(p.unobservable) for p in known)}"
    say(line)


track_command = command(track)


def _report(summary: TrackSummary) -> None:
    """Print how much was tracked."""
    held = f", {len(summary.missing)} missing and held" if summary.missing else ""
    resumed = f", {summary.resumed} of them from before" if summary.resumed else ""
    say(
        f"{summary.folder}: {summary.vertices} vertices of frame {summary.template}, {summary.frames} "
        f"frames{resumed}{held}"
    )
    if summary.visible:
        middle, least = median(summary.visible), min(summary.visible)
        say(f"reported visible: {middle:.1%} of the vertices, {least:.1%} in the worst frame")

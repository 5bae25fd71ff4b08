"""`vntoolkit track`: register all frames of a reconstruction to one mesh."""

from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING

from vntoolkit.cli.output import print_next, say
from vntoolkit.cli.verb import verb
from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.io.results.sequences import read_mesh_sequence
from vntoolkit.options.tracking import TrackArguments
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.texture import write_texture
from vntoolkit.pipeline.track import TrackSummary
from vntoolkit.pipeline.track import track as run

if TYPE_CHECKING:
    from vntoolkit.tactile.pose import TrackedPose


@verb(TrackArguments)
def track(asked: TrackArguments) -> MeshSequence:
    """Register the frames of a reconstruction to one mesh of fixed topology, and draw a checkerboard on it.

    Its texture is gathered from the footage, which is read again for that. The same command again continues
    an interrupted run.
    """
    summary = run(asked)
    if asked.object:
        from vntoolkit.pipeline.object_poses import write_object_poses

        _report_poses(write_object_poses(Path(asked.folder), asked.target))
    write_checkerboard(Path(asked.folder), asked.target)
    _report(summary)
    say(f"{asked.target / 'checkerboard.mkv'}, checkerboard.png")
    made = write_texture(Path(asked.folder), asked.target, footage=asked.footage, background=asked.background)
    shown = made.texture.albedo or made.texture.normal
    say(f"{shown}: {made.covered:.1%} of the surface from {made.frames} frames, the rest filled")
    print_next("export", str(asked.folder), "--to", "usd")
    return read_mesh_sequence(asked.target)


def _report_poses(poses: "list[TrackedPose]") -> None:
    known = [pose for pose in poses if not pose.lost]
    line = f"object.csv: pose in {len(known)} of {len(poses)} frames"
    if known:
        line += f", within {max(p.error_deg for p in known):.1f} degrees and "
        line += f"{max(p.error_mm for p in known):.2f} mm; unobservable directions: "
        line += f"{max(len(p.unobservable) for p in known)}"
    say(line)


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

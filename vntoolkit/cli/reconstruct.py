"""`vntoolkit reconstruct`: compute normals, depth and meshes from footage and a rig."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, ClassVar

from vntoolkit.cli.output import print_next, say
from vntoolkit.cli.verb import verb
from vntoolkit.diagnosis.finding import require_known_checks
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.base import File, Named, OptionalFile, Source, as_path, named, positive
from vntoolkit.options.depth import IntegrationOptions, MeshOptions
from vntoolkit.options.footage import Gaps, GapsName, MatteOptions, PictureLimits, SensorOptions
from vntoolkit.options.normals import InversionOptions
from vntoolkit.options.reconstruction import ReconstructOptions
from vntoolkit.options.shared import AllowOptions, BackgroundOptions, CornerOptions, FrameOptions, JobOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.pipeline.corners import rig_with_corners
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.pipeline.reconstruct import ReconstructionSummary
from vntoolkit.pipeline.reconstruct import reconstruct as run
from vntoolkit.pipeline.request import Request


@dataclass(frozen=True, kw_only=True)
class RunArguments(
    FrameOptions, BackgroundOptions, MatteOptions, SensorOptions, AllowOptions, ReconstructOptions,
    InversionOptions, IntegrationOptions, MeshOptions, JobOptions, PictureLimits,
):  # fmt: skip
    """What a reconstruction takes beside its footage, its rig and its folder."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("relative_albedo", "distance_m")

    distance: Annotated[float | None, positive("a positive number of metres")] = None
    """Distance in metres from a perspective camera to the subject, along the optical axis. It fixes the scale
    that normals alone leave free."""
    gaps: Named[Gaps, GapsName] = named(Gaps.REFUSE)
    """What to do where numbers of an image sequence are missing: refuse the sequence, or skip these frames.
    The other frames keep their numbers."""
    frame_rate_hz: float | None = None
    """Frames per second that the footage was filmed at. Default: what it states; 30 for images."""
    scheduler: str | None = None
    """Address of a Dask scheduler, tcp://host:8786, or "local". Workers must see the same folders."""
    overwrite: bool = False
    """Replace the results that the folder holds."""

    @property
    def range(self) -> FrameRange:
        """The frames."""
        return FrameRange.from_text(self.frames or "::")

    def job(self, source: str, rig: Rig, folder: Path, mask: Path | None) -> Request:
        """Return the reconstruction of a capture."""
        require_known_checks(self.allow)
        return Request(
            source=source,
            rig=rig,
            folder=ReconstructionFolder(root=folder),
            mask=mask,
            options=replace(self.part(ReconstructOptions), distance_m=self.distance),
            matting=self.part(MatteOptions),
            background=as_path(self.background),
            sensor=self.part(SensorOptions),
            allow=self.allow,
            gaps=self.gaps,
            frame_rate_hz=self.frame_rate_hz,
        )


@dataclass(frozen=True, kw_only=True)
class ReconstructArguments(CornerOptions, RunArguments):
    """What `reconstruct` takes."""

    source: Source = field(kw_only=False)
    """A video, an image, a folder of images, or a pattern such as frame_%04d.png or "frame_*.png"."""
    rig: File
    """The rig.json that `vntoolkit calibrate` wrote."""
    out: File
    """The folder to write: normals, depth, mesh and reconstruction.json."""
    mask: OptionalFile = named(None)
    """White where the subject is, of the footage's size: an image, or a video, a folder or a pattern with a
    matte for each frame."""
    transfer: str | None = None
    """Transfer curve of the footage: linear, srgb, bt709, gamma:G, pq, hlg, slog3, vlog, clog3 or logc3. It
    overrides the curve that the file states. Default: the rig's."""


@verb(ReconstructArguments)
def reconstruct(asked: ReconstructArguments) -> OpenedResult:
    """Compute normals, depth and meshes from footage and a rig, frame by frame.

    The same command again continues an interrupted run.
    """
    source, calibrated = str(asked.source), read_rig(Path(asked.rig))
    if asked.corners is not None or asked.size_mm is not None:
        options = CaptureOptions(transfer=calibrated.transfer, gaps=Gaps(asked.gaps))
        info = open_capture(source, options).info
        calibrated = rig_with_corners(calibrated, asked, (info.width, info.height))
    job = asked.job(source, calibrated, Path(asked.out), asked.mask)
    if asked.transfer is not None:
        job = _with_transfer(job, Transfer.from_text(asked.transfer))
    summary = run(
        job, frames=asked.range, jobs=asked.jobs, scheduler=asked.scheduler, overwrite=asked.overwrite
    )
    _report(summary)
    if summary.loss:
        raise BadCapture(f"{source}: {summary.loss}")
    print_next("view", summary.folder)
    return read_result(asked.out)


def _with_transfer(job: Request, curve: Transfer) -> Request:
    """Return the job with another curve than the file states, which is not judged then."""
    own = job.rig.transfer
    rig = replace(job.rig, transfer=replace(own, curve=curve.curve, gamma=curve.gamma))
    return replace(job, rig=rig, calibrated=own, allow=(*job.allow, "tag"))


def _report(summary: ReconstructionSummary) -> None:
    """Print what was done, and what was left out."""
    for record in summary.skipped:
        if not record.shows_nothing:  # these are told together
            say(f"skipped frame {record.number}: {record.failure}")
    resumed = f", {summary.resumed} from before" if summary.resumed else ""
    rate = f" ({summary.done / summary.seconds:.3g} frames/s)" if summary.done > 1 else ""
    total = summary.frames + summary.lost
    say(f"{summary.folder}: {summary.done} of {total} frames done{resumed}{rate}")
    if summary.found_lamps:
        say("the rig does not hold the lamps' colours: they were found in the subject's shadows")
    if summary.error_deg is not None:
        say(
            f"expected error of the normals: {summary.error_deg:.1f} degrees, the median over the pixels of "
            "the worst frames"
        )

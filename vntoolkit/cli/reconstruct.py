"""`vntoolkit reconstruct`: compute normals, depth and meshes from footage and a rig."""

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, TypeAlias

from vntoolkit.cli import flags
from vntoolkit.cli.output import ProgressBars, print_next
from vntoolkit.diagnosis.checks import CHECK_NAMES
from vntoolkit.diagnosis.finding import require_known_checks
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.footage import Gaps, MatteOptions, SensorOptions
from vntoolkit.options.reconstruction import ReconstructOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.pipeline.outputs import ReconstructionFolder
from vntoolkit.pipeline.reconstruct import ReconstructionSummary
from vntoolkit.pipeline.reconstruct import reconstruct as run
from vntoolkit.pipeline.request import Request

ReconstructFlags: TypeAlias = Annotated[
    ReconstructOptions | None, flags.Flags(without=("relative_albedo",), renamed={"distance_m": "distance"})
]


@dataclass(frozen=True, kw_only=True)
class RunFlags:
    """How footage is read, and who does the work."""

    matting: MatteOptions = field(default_factory=MatteOptions)
    background: flags.AmbientImage = None
    frames: flags.Frames = "::"
    jobs: flags.Jobs = 1
    scheduler: flags.Scheduler = None
    gaps: flags.Missing = Gaps.REFUSE
    allow: flags.Allow = ()
    sensor: SensorOptions = field(default_factory=SensorOptions)

    def job(self, **fields: Any) -> Request:
        """Return the reconstruction of a capture; fields: its further ones."""
        require_known_checks(self.allow, CHECK_NAMES)
        own = {name: getattr(self, name) for name in ("matting", "background", "gaps", "allow", "sensor")}
        return Request(**(own | fields))


@flags.verb("max_megapixels")
def reconstruct(
    source: str,
    *,
    rig: Path,
    out: Path,
    mask: Path | None = None,
    corners: flags.Corners = None,
    size_mm: flags.SizeMm = None,
    transfer: str | None = None,
    overwrite: flags.Overwrite = False,
    running: Annotated[RunFlags | None, flags.Flags()] = None,
    options: ReconstructFlags = None,
) -> None:
    """Compute normals, depth and meshes from footage and a rig, frame by frame.

    The same command again continues an interrupted run.

    Parameters
    ----------
    source
        A video, an image, a folder of images, or a pattern such as frame_%04d.png or "frame_*.png".
    rig
        The rig.json that `vntoolkit calibrate` wrote.
    out
        The folder to write: normals, depth, mesh and reconstruction.json.
    mask
        White where the subject is, of the footage's size: an image, or a video, a folder or a pattern with a
        matte for each frame.
    transfer
        Transfer curve of the footage, linear, srgb, bt709, gamma:G, pq, hlg, slog3, vlog, clog3 or logc3,
        even where the file states another. Default: the rig's.
    overwrite
        Replace the results that the folder holds.
    """
    calibrated, running = read_rig(rig), running or RunFlags()
    if corners is not None or size_mm is not None:
        info = open_capture(source, CaptureOptions(transfer=calibrated.transfer, gaps=running.gaps)).info
        calibrated = flags.rig_with_corners(calibrated, corners, size_mm, (info.width, info.height))
    job = running.job(
        source=source,
        rig=_with_transfer(calibrated, transfer),
        calibrated=calibrated.transfer,
        allow=running.allow if transfer is None else (*running.allow, "tag"),
        options=options or ReconstructOptions(),
        folder=ReconstructionFolder(root=out),
        mask=mask,
    )
    with ProgressBars() as bars:
        summary = run(
            job,
            frames=FrameRange.from_text(running.frames),
            jobs=running.jobs,
            scheduler=running.scheduler,
            overwrite=overwrite,
            on_start=partial(bars.begin, "reconstruct"),
            on_frame=bars.step,
        )
    _report(source, summary)


def _with_transfer(rig: Rig, transfer: str | None) -> Rig:
    if transfer is None:
        return rig
    curve = Transfer.from_text(transfer)
    return replace(rig, transfer=replace(rig.transfer, curve=curve.curve, gamma=curve.gamma))


def _report(source: str, summary: ReconstructionSummary) -> None:
    for record in summary.skipped:
        print(f"skipped frame {record.number}: {record.failure}")
    resumed = f", {summary.resumed} from before" if summary.resumed else ""
    rate = f" ({summary.done / summary.seconds:.1f} frames/s)" if summary.done > 1 else ""
    total = summary.frames + summary.lost
    print(f"{summary.folder}: {summary.done} of {total} frames done{resumed}{rate}")
    if summary.found_lamps:
        print("the rig does not hold the lamps' colours: they were found in the subject's shadows")
    if summary.error_deg is not None:
        print(f"expected error of the normals: {summary.error_deg:.1f} degrees, the median over the pixels")
    if summary.loss:
        raise BadCapture(f"{source}: {summary.loss}")
    print_next("view", summary.folder)

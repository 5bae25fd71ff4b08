"""`vntoolkit session`: reconstruct and track many captures, on one machine or several."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vntoolkit.cli import flags
from vntoolkit.cli.output import ProgressBars, print_next
from vntoolkit.cli.reconstruct import ReconstructFlags, RunFlags
from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.options.tracking import Tracker, TrackingOptions
from vntoolkit.pipeline.outputs import ReconstructionFolder
from vntoolkit.pipeline.session import CaptureOutcome, names_from_sources, run_session


@flags.verb("max_megapixels")
def session(
    *sources: str,
    rig: Path,
    out: Path,
    track: Annotated[bool, Parameter(negative=())] = False,
    method: Tracker = Tracker.DEFAULT,
    mask: Path | None = None,
    overwrite: flags.Overwrite = False,
    running: Annotated[RunFlags | None, flags.Flags()] = None,
    options: ReconstructFlags = None,
) -> None:
    """Reconstruct all captures of one rig, and track them on request, each into its own folder.

    A capture that fails is reported at the end; the others are still done. The same command again continues
    an interrupted run. With a scheduler, all workers reconstruct the frames of one capture, and one of them
    tracks it while the others reconstruct the next.

    Parameters
    ----------
    sources
        Videos or folders of images: take1.mkv take2.mkv ...
    rig
        The rig.json of all these captures.
    out
        The folder to write. It gets one folder per capture: take1, take2, ...
    track
        Also register the frames of each capture to one mesh.
    method
        Tracking method, as for `vntoolkit track`.
    mask
        White where the subject is: an image for all captures; or a folder that holds an image, a video or a
        folder of mattes for each, named as the capture is: take1.png, take1.mkv or take1.
    overwrite
        Replace the reconstructions and tracks that the folders hold.
    """
    if not sources:
        raise BadInput("session: expected at least one video or folder of images, got none")
    options, running = options or ReconstructOptions(), running or RunFlags()
    if track and options.to is Product.NORMALS:
        raise BadInput("--track needs depth: give --to depth or mesh, not normals")
    if method is not Tracker.DEFAULT and not track:
        raise BadInput("--method needs --track")
    lit_by = read_rig(rig)
    captures = {
        name: running.job(
            source=source,
            rig=lit_by,
            options=options,
            folder=ReconstructionFolder(root=out / name),
            mask=_mask_of(name, mask),
        )
        for name, source in names_from_sources(sources).items()
    }
    with ProgressBars() as bars:
        outcomes = run_session(
            captures,
            tracking=TrackingOptions(method=method) if track else None,
            frames=FrameRange.from_text(running.frames),
            workers=running.jobs,
            scheduler=running.scheduler,
            overwrite=overwrite,
            on_capture=bars.begin,
            on_frame=bars.step,
        )
    _report(out, outcomes)


def _mask_of(name: str, mask: Path | None) -> Path | None:
    """Return the mask of one capture: the image for all, or what the folder holds under its name."""
    if mask is None or not mask.is_dir():
        return mask
    found = sorted(path for path in mask.iterdir() if name in (path.stem, path.name))
    if len(found) != 1:
        got = "none" if not found else " and ".join(path.name for path in found)
        raise BadInput(f"{mask}: expected one mask, video or folder of mattes named {name}, got {got}")
    return found[0]


def _report(out: Path, outcomes: list[CaptureOutcome]) -> None:
    """Print a line for each capture; raise `VntError` where one failed."""
    for outcome in outcomes:
        print(f"{out / outcome.name}: {_line(outcome)}")
    failed = [outcome.name for outcome in outcomes if outcome.failure or _loss(outcome)]
    if failed:
        raise VntError(f"{len(failed)} of {len(outcomes)} captures failed: {', '.join(failed)}")
    print_next("view", out / outcomes[0].name)


def _loss(outcome: CaptureOutcome) -> str:
    return "" if outcome.reconstruction is None else outcome.reconstruction.loss


def _line(outcome: CaptureOutcome) -> str:
    made = outcome.reconstruction
    if made is None:
        return f"failed: {outcome.failure}"
    text = f"{made.done} of {made.frames + made.lost} frames done"
    text += f", {made.resumed} from before" if made.resumed else ""
    text += "".join(f"; skipped frame {record.number}: {record.failure}" for record in made.skipped)
    text += f"; {_loss(outcome)}" if _loss(outcome) else ""
    text += "" if made.error_deg is None else f"; normals expected within {made.error_deg:.1f} degrees"
    if outcome.failure:
        return f"{text}; failed: {outcome.failure}"
    return text if outcome.tracks is None else f"{text}; {outcome.tracks.vertices} vertices tracked"

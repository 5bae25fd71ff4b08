"""`vntoolkit session`: reconstruct and track many captures, on one machine or several."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from vntoolkit.cli.output import print_next, say
from vntoolkit.cli.reconstruct import RunArguments
from vntoolkit.cli.verb import verb
from vntoolkit.errors import BadInput, VntError
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.base import File, Named, OptionalFile, Source, named
from vntoolkit.options.reconstruction import Product
from vntoolkit.options.tracking import Tracker, TrackerName, TrackingOptions
from vntoolkit.pipeline.session import CaptureOutcome, names_from_sources, run_session


@dataclass(frozen=True, kw_only=True)
class SessionArguments(RunArguments):
    """What `session` takes."""

    sources: tuple[Source, ...] = field(kw_only=False)
    """Videos or folders of images: take1.mkv take2.mkv ..."""
    rig: File
    """The rig.json of all these captures."""
    out: File
    """The folder to write. It gets one folder per capture: take1, take2, ..."""
    track: bool = False
    """Also register the frames of each capture to one mesh."""
    method: Named[Tracker, TrackerName] = named(Tracker.DEFAULT)
    """Tracking method, as for `vntoolkit track`."""
    mask: OptionalFile = named(None)
    """White where the subject is: an image for all captures; or a folder that holds an image, a video or a
    folder of mattes for each, named as the capture is: take1.png, take1.mkv or take1."""


def _mask_of(name: str, mask: Path | None) -> Path | None:
    """Return the mask of one capture: the image for all, or what the folder holds under its name."""
    if mask is None or not mask.is_dir():
        return mask
    found = sorted(path for path in mask.iterdir() if name in (path.stem, path.name))
    if len(found) != 1:
        got = "none" if not found else " and ".join(path.name for path in found)
        raise BadInput(f"{mask}: expected one mask, video or folder of mattes named {name}, got {got}")
    return found[0]


def _reported(asked: SessionArguments, run: Callable[[SessionArguments], list[CaptureOutcome]]) -> None:
    """Print a line for each capture; raise `VntError` where one failed."""
    out, outcomes = Path(asked.out), run(asked)
    for outcome in outcomes:
        say(f"{out / outcome.name}: {_line(outcome)}")
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
    skipped = [record for record in made.skipped if not record.shows_nothing]
    text += "".join(f"; skipped frame {record.number}: {record.failure}" for record in skipped)
    text += f"; {_loss(outcome)}" if _loss(outcome) else ""
    text += "" if made.error_deg is None else f"; normals expected within {made.error_deg:.1f} degrees"
    if outcome.failure:
        return f"{text}; failed: {outcome.failure}"
    return text if outcome.tracks is None else f"{text}; {outcome.tracks.vertices} vertices tracked"


@verb(SessionArguments, show=_reported)
def session(asked: SessionArguments) -> list[CaptureOutcome]:
    """Reconstruct all captures of one rig, and track them on request, each into its own folder.

    A capture that fails is reported at the end; the others are still done. The same command again continues
    an interrupted run. With a scheduler, all workers reconstruct the frames of one capture, and one of them
    tracks it while the others reconstruct the next.
    """
    if not asked.sources:
        raise BadInput("session: expected at least one video or folder of images, got none")
    if asked.track and asked.to is Product.NORMALS:
        raise BadInput("--track needs depth: give --to depth or mesh, not normals")
    if asked.method is not Tracker.DEFAULT and not asked.track:
        raise BadInput("--method needs --track")
    lit_by, out = read_rig(Path(asked.rig)), Path(asked.out)
    captures = {
        name: asked.job(source, lit_by, out / name, _mask_of(name, asked.mask))
        for name, source in names_from_sources(tuple(map(str, asked.sources))).items()
    }
    return run_session(
        captures,
        tracking=TrackingOptions(method=asked.method) if asked.track else None,
        frames=asked.range,
        workers=asked.jobs,
        scheduler=asked.scheduler,
        overwrite=asked.overwrite,
    )

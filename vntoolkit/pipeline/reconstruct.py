"""Reconstruction of a capture: normals, depth, meshes; resumable, in one process or many."""

import logging
import os
import time
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from vntoolkit import progress
from vntoolkit.diagnosis.finding import judge
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.atomic import remove_leftovers, require_apart, write_text
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.mattes import require_mattes
from vntoolkit.io.footage.sequence import find_capture_files, text_of_names
from vntoolkit.io.results import manifest as manifests
from vntoolkit.io.results.folder import begin_run, require_same_request, write_lock
from vntoolkit.io.results.frame_log import FrameEntry, FrameLog
from vntoolkit.io.results.manifest import FindingEntry, Known, Manifest
from vntoolkit.io.results.numbered_files import numbers_in_words
from vntoolkit.io.results.reconstruction import (
    RECONSTRUCTION,
    entry_of_files,
    hashed,
    library_versions,
    write_manifest,
)
from vntoolkit.io.rigs import entry_from_rig
from vntoolkit.options.footage import Gaps
from vntoolkit.pipeline.request import Footage, Request

if TYPE_CHECKING:
    from vntoolkit.diagnosis.backdrop import Backdrop
    from vntoolkit.geometry.maps import NormalMap
    from vntoolkit.pipeline.frame_blocks import Block

logger = logging.getLogger(__name__)
BLOCK_FRAMES = 16
_WORST = 90.0  # percentile over the frames: the median would hide a third that is wrong


@dataclass(frozen=True, kw_only=True)
class ReconstructionSummary:
    """What a run did: frames asked for, found on disk already, newly done, and skipped with their reasons.

    lost: frames asked for that the video declares but does not hold. loss: that in one line; empty where
    nothing is lost. error_deg: expected error of the normals, the median over the
    pixels of a frame, and of the frames the least of the worst tenth; None where not known. found_lamps:
    whether the lamps' colours, which the rig does not hold, were found in the subject's shadows.
    """

    folder: Path
    frames: int
    resumed: int
    done: int
    skipped: tuple[FrameEntry, ...]
    seconds: float
    lost: int = 0
    loss: str = ""
    error_deg: float | None = None
    found_lamps: bool = False


def reconstruct(
    request: Request,
    *,
    frames: FrameRange | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    overwrite: bool = False,
) -> ReconstructionSummary:
    """Reconstruct the chosen frames of a capture into `request.folder`; go on where an earlier run stopped.

    What holds for the whole capture is prepared once; then every frame goes from video to linear RGB,
    normals, depth and a mesh (`FrameProcessor.process`), in `jobs` processes of this machine, or of a Dask
    `scheduler`: its address, or "local" for `jobs` workers that are started here. The files are the same to
    the byte. Raises the kinds of `VntError` that bad input deserves, before anything is written where that
    can be known, and `CannotWrite` while another run is at work in the folder.
    """
    frames, started = frames or FrameRange(), time.perf_counter()
    progress.begin("prepare")
    warnings: list[FindingEntry] = []
    with recorded_warnings(warnings):
        footage = _checked_footage(request, frames, jobs, scheduler)
    with write_lock(request.folder.root), recorded_warnings(warnings):
        run = _begun(request, footage, frames, overwrite)
        progress.begin(f"frames of {request.folder.root.name}", len(run.numbers), len(run.resumed))
        for entry in run.missing:
            run.log.append(entry)
            progress.step()
        made = _made_frames(run, jobs, scheduler)
        seconds = time.perf_counter() - started
        return _ended(run, footage, frames, made, warnings, seconds)


def _checked_footage(request: Request, frames: FrameRange, jobs: int, scheduler: str | None) -> Footage:
    """Open footage and mattes; raise for what is wrong with the request, before anything is written."""
    if jobs < 1:
        raise BadInput(f"jobs: expected 1 or more, got {jobs}")
    footage, root = request.open_footage(), request.folder.root
    info, mattes = footage.capture.info, footage.mattes
    request.rig.require_background(request.background is not None)
    request.rig.require_size(info.width, info.height, request.source)
    rig = request.rig
    if request.options.distance_m is not None and not rig.camera.is_perspective and rig.gel is None:
        logger.warning(
            "--distance changes nothing: the rig's camera is orthographic, so depth stays in its own unit; "
            "calibrate with --camera or --focal-px for a perspective one"
        )
    numbers = frames.numbers(info.frame_count)
    if request.gaps is Gaps.REFUSE:
        require_mattes(mattes, (n for n in footage.capture.present if n in numbers), request.mask)
    inputs = (*info.files, *mattes.files, request.background)
    require_apart(inputs, (root / name for name in manifests.FRAME_FILES))
    if scheduler is not None:
        from vntoolkit.pipeline.cluster import require_scheduler

        require_scheduler(scheduler)
    if info.unusable_times:
        logger.warning(
            "%s: %s; the frames are played at %g per second: give --frame-rate-hz with the rate that they "
            "were filmed at", request.source, info.unusable_times, info.frame_rate_hz,
        )  # fmt: skip
    if info.left_out:
        names = text_of_names([path.name for path in info.left_out])
        logger.warning("%s: left out, since the frames are named otherwise: %s", request.source, names)
    return footage


@dataclass(frozen=True, kw_only=True, eq=False)
class _Run:
    """A run whose manifest is written. numbers: frames to have in the end. on_disk: those that are there."""

    request: Request
    known: Known
    manifest: Manifest
    log: FrameLog
    numbers: tuple[int, ...]
    on_disk: frozenset[int]
    missing: list[FrameEntry]

    @property
    def resumed(self) -> frozenset[int]:
        """Frames of this run that were there before."""
        return self.on_disk.intersection(self.numbers)


def _begun(request: Request, footage: Footage, frames: FrameRange, overwrite: bool) -> _Run:
    """Prepare, or go on with what an earlier run prepared; write the manifest into a folder that is free.

    What was found holds for the frames that it was found among. If more are asked for, it is found again; if
    that changes it, frames from before are made again, so that a result does not depend on the first try.
    """
    root, count = request.folder.root, footage.capture.info.frame_count
    manifest = manifest_of_request(request, footage, frames)
    goes_on = require_same_request(root, RECONSTRUCTION, manifest, overwrite=overwrite)
    earlier = manifests.read_manifest(root).known if goes_on else None
    covered = _covered(earlier, frames, count)
    if earlier is not None and covered == earlier.frames:
        known = earlier
        for finding in known.findings:
            say = logger.info if finding.level == "note" else logger.warning
            say("%s%s", "note: " if finding.level == "note" else "", finding.text)
    else:
        from vntoolkit.pipeline.prepare import prepare

        warnings: list[FindingEntry] = []
        with recorded_warnings(warnings):
            known = prepare(request, footage, manifests.numbers_of_ranges(covered, count))
        findings = [*known.findings, *_not_among(known.findings, warnings)]
        known = known.model_copy(update={"frames": covered, "findings": findings})
    log, again = FrameLog(root), set[int]()
    if earlier is not None and known.shapes() != earlier.shapes():
        again = set(log.done())
        logger.warning(
            "with more frames than before (%s), other lamps, materials or blur are found: %s from before are "
            "made again", ", ".join(earlier.frames), numbers_in_words(again),
        )  # fmt: skip
    manifest = manifest.model_copy(update={"known": known, "outputs": request.folders_with(known)})
    begin_run(root, RECONSTRUCTION, manifest, overwrite=overwrite or bool(again))
    numbers = tuple(sorted(again.union(frames.numbers(count))))
    return _Run(
        request=request,
        known=known,
        manifest=manifest,
        log=log,
        numbers=numbers,
        on_disk=frozenset(n for n in log.done() if request.folder.has(n, *manifest.outputs)),
        missing=_missing_frames(footage, numbers),
    )


def _covered(earlier: Known | None, frames: FrameRange, count: int) -> list[str]:
    """Return the frames, as ranges, that an earlier run and this one ask for together."""
    asked = set(frames.numbers(count))
    before = [] if earlier is None else earlier.frames
    known = set(manifests.numbers_of_ranges(before, count))
    if asked <= known:
        return before
    return [frames.to_text()] if known <= asked else [*before, frames.to_text()]


def _missing_frames(footage: Footage, numbers: Sequence[int]) -> list[FrameEntry]:
    why = dict.fromkeys(footage.mattes.missing(numbers), "no matte")
    why.update({number: f"no file {name}" for number, name in footage.capture.info.missing.items()})
    return [FrameEntry(number=number, failure=why[number]) for number in sorted(set(why) & set(numbers))]


def _made_frames(run: _Run, jobs: int, scheduler: str | None) -> list[FrameEntry]:
    """Make the frames that are not on disk; log each once its files are in place."""
    made: list[FrameEntry] = []
    entries = _frames_in_processes(run, jobs, scheduler)
    try:
        for entry in entries:
            run.log.append(entry)
            made.append(entry)
            progress.step()
    except KeyboardInterrupt:
        left = len(run.numbers) - len(run.resumed) - len(made)
        raise KeyboardInterrupt(
            f"{len(made)} frames were finished and {left} are left in {run.request.folder.root}; run the "
            "same command again to go on"
        ) from None
    finally:
        entries.close()
        run.log.close()
    return made


def _frames_in_processes(run: _Run, jobs: int, scheduler: str | None) -> Generator[FrameEntry]:
    """Yield the frames that are not on disk, each once its files are in place."""
    blocks = [block for block in blocks_of(run.numbers) if not run.on_disk.issuperset(block)]
    items: list[Block] = [(block, run.on_disk.intersection(block)) for block in blocks]
    if not items:
        return
    from vntoolkit.pipeline.frame_blocks import FrameBlockProcessor

    if scheduler is None:
        from vntoolkit.pipeline.processes import map_in_processes

        begin = partial(FrameBlockProcessor, run.request, run.known)
        yield from map_in_processes(begin, items, min(jobs, len(items)))
        return
    from vntoolkit.pipeline.cluster import map_on_cluster

    begin = partial(FrameBlockProcessor, run.request.from_anywhere(), run.known)
    yield from map_on_cluster(begin, items, scheduler, jobs)
    # every block is written, so what is half-written was left by workers that died, here or elsewhere
    remove_leftovers(run.request.folder.root, lambda process: process != os.getpid())


def blocks_of(numbers: Sequence[int]) -> list[range]:
    """Cut the frame numbers of a run, in order, into blocks of equal steps."""
    blocks: list[range] = []
    for number in numbers:
        last = blocks[-1] if blocks else range(0)
        step = number - last[-1] if len(last) else 1
        if len(last) == 1 or (1 < len(last) < BLOCK_FRAMES and step == last.step):
            blocks[-1] = range(last[0], number + 1, step)
        else:
            blocks.append(range(number, number + 1))
    return blocks


def _ended(
    run: _Run,
    footage: Footage,
    frames: FrameRange,
    made: list[FrameEntry],
    warnings: list[FindingEntry],
    seconds: float,
) -> ReconstructionSummary:
    """Write what the frames took, how good they are and what was wrong; return what the run did."""
    from vntoolkit.diagnosis.backdrop import LARGE_ERROR_DEG, spread_deg

    root, info = run.request.folder.root, footage.capture.info
    entries = run.log.entries()
    of_run = [entries[n] for n in run.numbers if n in entries]
    done = [entry for entry in of_run if not entry.failure]
    if any(entry.contact_mm2 is not None for entry in entries.values()):
        write_contacts(root, run.log)
    spent = [entry.seconds for entry in done]
    timings = {"frame_s": float(np.median(spent)) if spent else 0.0, "wall_s": round(seconds, 3)}
    errors = [entry.error_deg for entry in done if entry.error_deg is not None]
    error_deg = round(float(np.percentile(errors, _WORST, method="higher")), 2) if errors else None
    own, worst = [], _worst_map(run, done)
    if worst is not None:
        subject = worst.mask
        if (backdrop := _backdrop(run, done, worst)) is not None:
            own.append(backdrop.finding)
            error_deg, subject = round(backdrop.subject_deg, 2), backdrop.subject
        spread = spread_deg(worst, subject)
        if error_deg is not None and error_deg > max(LARGE_ERROR_DEG, spread):
            logger.warning(
                "the expected error of the normals, which nine of ten stay within, is %.0f degrees in the "
                "median of the worst frames, and nine of ten normals lie within %.0f of their mean: they "
                "tell no more than a flat surface. Noise, gloss, near lamps or another colour than the rig's "
                "do so; `vntoolkit doctor` names what it finds, `vntoolkit report` shows where",
                error_deg, spread,
            )  # fmt: skip
    if of_run and all(entry.shows_nothing for entry in of_run):
        raise BadCapture(of_run[0].failure)
    failed = [entry for entry in made if entry.failure]
    declared, came = info.promised_frame_count, info.frame_count
    lost = len(frames.numbers(declared)) - len(frames.numbers(came))
    loss = (
        f"the video is cut off: it declares {declared} frames, {came} came; what came is kept: copy the file "
        f"again, or accept it with --frames 0:{came}"
    )
    summary = ReconstructionSummary(
        folder=root,
        frames=len(run.numbers),
        resumed=len(run.resumed),
        done=len(made) - len(failed),
        skipped=tuple(sorted([*run.missing, *failed], key=lambda entry: entry.number)),
        seconds=seconds,
        lost=lost,
        loss=loss if lost else "",
        error_deg=error_deg,
        found_lamps=run.known.light_colours is not None,
    )
    findings = _not_among(run.known.findings, warnings)
    findings += [
        FindingEntry(check="skipped", level="warning", text=f"skipped: {entry.failure}", frame=entry.number)
        for entry in of_run
        if entry.failure and not entry.shows_nothing
    ]
    if empty := [entry.number for entry in of_run if entry.shows_nothing]:
        from vntoolkit.diagnosis.subject import finding_from_empty_frames

        own.append(finding_from_empty_frames(empty, len(of_run)))
    judge(own)
    findings = [*(finding.entry for finding in own), *findings]
    if summary.loss:
        findings.append(FindingEntry(check="cut-off", level="warning", text=summary.loss))
    ended = {"finished": manifests.now_utc(), "timings": timings, "error_deg": error_deg}
    write_manifest(root, run.manifest.model_copy(update=ended | {"findings": findings}))
    return summary


def _worst_map(run: _Run, done: Sequence[FrameEntry]) -> "NormalMap | None":
    """Read the normals of the frame of the largest expected error; None where there are none."""
    errors = [entry.error_deg or 0.0 for entry in done]
    return _normals_of(run, done[int(np.argmax(errors))]) if max(errors, default=0.0) > 0.0 else None


def _normals_of(run: _Run, entry: FrameEntry) -> "NormalMap | None":
    from vntoolkit.io.maps_and_meshes.maps import read_normal_map

    folder, number = run.request.folder, entry.number
    return read_normal_map(folder.file("normals", number)) if folder.has(number, "normals") else None


def _backdrop(run: _Run, done: Sequence[FrameEntry], worst: "NormalMap") -> "Backdrop | None":
    """Find a backdrop that counts as subject; write a mask.

    It stands in the frame that shows most, too; in the worst one, what has hardly entered looks alike.
    """
    from vntoolkit.diagnosis.backdrop import MASK_NAME, backdrop_in

    request = run.request
    if request.mask is not None or request.matting.key is not None or request.is_of_gel:
        return None
    fullest = _normals_of(run, max(done, key=lambda entry: entry.valid_share))
    if fullest is None or backdrop_in(fullest) is None or (backdrop := backdrop_in(worst)) is None:
        return None
    from vntoolkit.io.maps_and_meshes.masks import write_mask

    write_mask(request.folder.root / MASK_NAME, backdrop.subject)
    return backdrop


def write_contacts(root: Path, log: FrameLog) -> None:
    """Write contact.csv: area and depth of what touches the gel, a line a frame."""
    rows = [
        f"{entry.number},{entry.contact_mm2:.3f},{entry.contact_depth_mm:.4f}"
        for entry in log.entries().values()
        if entry.contact_mm2 is not None
    ]
    write_text(root / "contact.csv", "\n".join(["frame,area_mm2,depth_mm", *rows]) + "\n")


def manifest_of_request(request: Request, footage: Footage, frames: FrameRange) -> Manifest:
    """Return the manifest of a run that begins now, before anything is found; hashes all input files."""
    info, extra = footage.capture.info, {}
    declared = info.promised_frame_count
    if request.mask is not None:
        extra["mask"] = entry_of_files(request.mask, footage.mattes.files)
    if request.background is not None:
        extra["background"] = entry_of_files(request.background, find_capture_files(request.background).files)
    return Manifest(
        input=manifests.InputEntry(
            source=request.source,
            files=hashed(info.files),
            width=info.width,
            height=info.height,
            frame_count=info.frame_count,
            frame_rate_hz=info.frame_rate_hz,
            numbers=list(info.numbers),
            declared_frame_count=declared if declared > info.frame_count else None,
            times_s=list(info.times_s),
        ),
        extra_files=extra,
        rig=entry_from_rig(request.rig),
        options=request.shaping_options(),
        frames=frames.to_text(),
        versions=library_versions(),
        started=manifests.now_utc(),
    )


# What a run warns of is kept beside being said: nothing goes to the terminal alone.


@contextmanager
def recorded_warnings(found: list[FindingEntry]) -> Iterator[None]:
    """Add to `found` what the package warns of in the block, each once; its check is the file's name."""
    recorder = _Recorder(found)
    package = logging.getLogger("vntoolkit")
    package.addHandler(recorder)
    try:
        yield
    finally:
        package.removeHandler(recorder)


class _Recorder(logging.Handler):
    def __init__(self, found: list[FindingEntry]) -> None:
        super().__init__(logging.WARNING)
        self.found = found

    def emit(self, record: logging.LogRecord) -> None:
        text = " ".join(record.getMessage().split())
        if text not in {finding.text for finding in self.found}:
            check = record.name.rpartition(".")[2].replace("_", "-")
            self.found.append(FindingEntry(check=check, level="warning", text=text))


def _not_among(known: Sequence[FindingEntry], others: Sequence[FindingEntry]) -> list[FindingEntry]:
    texts = {finding.text for finding in known}
    return [finding for finding in others if finding.text not in texts]

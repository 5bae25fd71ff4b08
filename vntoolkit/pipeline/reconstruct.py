"""Reconstruction of a capture: normals, depth, meshes; resumable, in one process or many."""

import contextlib
import logging
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.diagnosis.finding import Finding, judge
from vntoolkit.diagnosis.inspection import Examination, examine_capture
from vntoolkit.errors import BadCapture, BadInput, VntError
from vntoolkit.io.atomic import remove_numbered, require_apart, sole_writer, write_text
from vntoolkit.io.footage.captures import Capture, CaptureInfo
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.mattes import Mattes, require_mattes
from vntoolkit.io.footage.sequence import text_of_names
from vntoolkit.io.results import manifest as manifests
from vntoolkit.io.results.frame_log import FRAMES_NAME, FrameEntry, FrameLog
from vntoolkit.io.rigs import entry_from_rig
from vntoolkit.materials.labelling import LabelState, MaterialLabeller
from vntoolkit.materials.mixtures import near_seams
from vntoolkit.materials.relighting import relit
from vntoolkit.options.footage import Gaps, MatteOptions, SensorOptions
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import MaterialSearch
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import with_near_lamps
from vntoolkit.pipeline.block_work import Block, BlockWorker, ReconstructionJob
from vntoolkit.pipeline.cluster import require_scheduler, run_blocks_on_cluster
from vntoolkit.pipeline.found_lamps import with_found_lamps
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.measured_materials import (
    MeasuredMaterials,
    measured_materials,
    refitted_materials,
    seeks_materials,
)
from vntoolkit.pipeline.options import SENSOR_PREFIX, option_values
from vntoolkit.pipeline.outputs import FRAME_FILES
from vntoolkit.pipeline.processes import shared_out

logger = logging.getLogger(__name__)
Started = Callable[[int, int], None]
Finished = Callable[[FrameEntry], None]
Workers = Callable[[ReconstructionJob, list[Block]], Generator[FrameEntry]]
BLOCK_FRAMES = 16
_LARGE_ERROR_DEG = 20.0  # in the median, as of pixels that one light hardly reaches
_DIGITS_OF_NEARNESS = 4
_DIGITS_OF_BLUR = 2
_SEAM_PX = 2  # to either side of a seam, where pixels are not judged: blur mixes two materials in them


@dataclass(frozen=True, kw_only=True)
class ReconstructionSummary:
    """What a run did: frames asked for, found on disk already, newly done, and skipped with their reasons.

    lost: frames asked for that the video declares but does not hold. declared, came: frames that it
    declares, and that can be read. error_deg: expected error of the normals, the median over the
    pixels and then over the frames asked for; None where it is not known. found_lamps: whether the lamps'
    colours, which the rig does not hold, were found in the subject's shadows.
    """

    folder: Path
    frames: int
    resumed: int
    done: int
    skipped: tuple[FrameEntry, ...]
    seconds: float
    lost: int = 0
    declared: int = 0
    came: int = 0
    error_deg: float | None = None
    found_lamps: bool = False

    @property
    def loss(self) -> str:
        """What a video that is cut off lost, in one line; empty where nothing is lost."""
        if not self.lost:
            return ""
        return (
            f"the video is cut off: it declares {self.declared} frames, {self.came} came; what came is kept: "
            f"copy the file again, or accept it with --frames 0:{self.came}"
        )


def reconstruct(
    job: ReconstructionJob,
    *,
    frames: FrameRange | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    overwrite: bool = False,
    on_start: Started = lambda total, done: None,
    on_frame: Finished = lambda record: None,
) -> ReconstructionSummary:
    """Reconstruct the chosen frames of a capture into `job.folder`; go on where an earlier run stopped.

    jobs: worker processes on this machine. scheduler: address of a Dask scheduler whose workers do the work
    instead, or "local" for `jobs` workers of one that is started here; the output is the same to the byte.
    on_start is called once with the number of frames and how many are on disk already, on_frame after each
    further one. Raises the kinds of `VntError` that bad input deserves, before anything is written where
    that can be known, and `CannotWrite` while another run is at work in the folder.
    """
    frames, root = frames or FrameRange(), job.folder.root
    if jobs < 1:
        raise BadInput(f"jobs: expected 1 or more, got {jobs}")
    started = time.perf_counter()
    capture = job.open_capture()
    job.rig.require_background(job.background is not None)
    job.rig.require_size(capture.info.width, capture.info.height, job.source)
    given = job.rig.response.light_colours
    numbers = frames.numbers(capture.info.frame_count)
    asked = frames.numbers(capture.info.promised_frame_count)
    mattes = job.open_mattes(capture)
    if job.gaps is Gaps.REFUSE:
        require_mattes(mattes, (n for n in capture.present if n in numbers), job.mask)
    inputs = (*capture.info.files, *mattes.files, job.background)
    require_apart(inputs, (root / name for name in FRAME_FILES))
    if scheduler is not None:
        require_scheduler(scheduler)
    if capture.info.left_out:
        names = text_of_names([path.name for path in capture.info.left_out])
        logger.warning("%s: left out, since the frames are named otherwise: %s", job.source, names)
    missing = _missing_frames(capture, mattes, numbers)
    examined = Examination(findings=[])
    if not seeks_materials(job):
        examined = _require_plausible(job, capture, mattes, numbers)
    with sole_writer(root):
        job, manifest, log = _prepared(job, capture, mattes, frames, overwrite, examined)
        on_disk = {number for number in log.done() if job.folder.has(number, *job.folders)}
        on_start(len(numbers), len(on_disk & set(numbers)))
        for record in missing:
            log.append(record)
            on_frame(record)
        records = _run(job, numbers, on_disk, _workers(jobs, scheduler), log, on_frame)
        seconds = time.perf_counter() - started
        error_deg = _finish(root, manifest, log, numbers, seconds)
    failed = [record for record in records if record.failure]
    skipped = tuple(sorted([*missing, *failed], key=lambda record: record.number))
    return ReconstructionSummary(
        folder=root,
        frames=len(numbers),
        resumed=len(on_disk & set(numbers)),
        done=len(records) - len(failed),
        skipped=skipped,
        seconds=seconds,
        lost=len(asked) - len(numbers),
        declared=capture.info.promised_frame_count,
        came=capture.info.frame_count,
        error_deg=error_deg,
        found_lamps=given is None and job.rig.response.light_colours is not None,
    )


def _prepared(
    job: ReconstructionJob,
    capture: Capture,
    mattes: Mattes,
    frames: FrameRange,
    overwrite: bool,
    examined: Examination,
) -> tuple[ReconstructionJob, manifests.Manifest, FrameLog]:
    """Settle what a run does and write its manifest into a folder that is free. examined: told so far."""
    root = job.folder.root
    numbers = frames.numbers(capture.info.frame_count)
    resumes = manifests.has_manifest(root) and not overwrite
    earlier = manifests.read_manifest(root) if resumes else None
    job = _with_lamps(job, capture, mattes, numbers, earlier)
    job, measured = resolve_options(job, capture, mattes, numbers, earlier)
    if seeks_materials(job):
        state = LabelState() if measured.seen is None else measured.seen.state
        examined = _require_plausible(job, capture, mattes, numbers, state)
    job = _with_blur(_with_near_lamps(job, examined, earlier), examined, earlier)
    materials = measured.entries
    if earlier is None and measured.seen is not None and job.rig.response.variation is not None:
        materials = refitted_materials(job, capture, mattes, numbers, measured.seen)
        job = _of_materials(job, materials)
    manifest = manifest_of_run(job, capture, mattes, frames, materials, examined.findings)
    if resumes:
        manifests.require_resumable(root, manifest)
    if overwrite:
        clear(root)
    manifests.write_manifest(root, manifest)
    return job, manifest, FrameLog(root)


def _with_lamps(
    job: ReconstructionJob,
    capture: Capture,
    mattes: Mattes,
    numbers: range,
    earlier: manifests.Manifest | None,
) -> ReconstructionJob:
    """Return the job with the lamps' colours where shadows tell them; as an earlier run found them."""
    if earlier is None:
        return with_found_lamps(job, capture, mattes, numbers)
    response, stored = job.rig.response, earlier.rig.response
    if response.light_colours is not None or stored is None or stored.light_colours is None:
        return job
    kept = {name: getattr(stored, name) for name in ("light_colours", "light_doubts_deg")}
    return replace(job, rig=replace(job.rig, response=replace(response, **kept)))


def _missing_frames(capture: Capture, mattes: Mattes, numbers: range) -> list[FrameEntry]:
    why = dict.fromkeys(mattes.missing(numbers), "no matte")
    why.update({number: f"no file {name}" for number, name in capture.info.missing.items()})
    return [FrameEntry(number=number, failure=why[number]) for number in sorted(why) if number in numbers]


def clear(root: Path) -> None:
    """Remove what the manifest and the log of a folder tell that `reconstruct` wrote, and nothing else."""
    if not manifests.has_manifest(root):
        return
    numbers = set(FrameLog(root).entries())
    with contextlib.suppress(VntError):  # a manifest that is no longer readable
        numbers.update(range(manifests.read_manifest(root).input.frame_count))
    for name, suffix in FRAME_FILES.items():
        remove_numbered(root / name, suffix, numbers)
    (root / FRAMES_NAME).unlink(missing_ok=True)
    (root / "contact.csv").unlink(missing_ok=True)
    (root / manifests.MANIFEST_NAME).unlink()


def _workers(jobs: int, scheduler: str | None) -> Workers:
    if scheduler is None:
        return lambda job, blocks: shared_out(partial(_begin, job), blocks, min(jobs, len(blocks)))
    return partial(run_blocks_on_cluster, scheduler=scheduler, workers=jobs)


def _run(
    job: ReconstructionJob,
    numbers: range,
    on_disk: set[int],
    workers: Workers,
    log: FrameLog,
    on_frame: Finished,
) -> list[FrameEntry]:
    open_blocks = [block for block in blocks_of(numbers) if not on_disk.issuperset(block)]
    records: list[FrameEntry] = []
    if not open_blocks:
        return records
    running = workers(job, [(block, frozenset(on_disk.intersection(block))) for block in open_blocks])
    try:
        for record in running:
            log.append(record)
            records.append(record)
            on_frame(record)
    except KeyboardInterrupt:
        left = len(numbers) - len(on_disk & set(numbers)) - len(records)
        raise KeyboardInterrupt(
            f"{len(records)} frames were finished and {left} are left in {job.folder.root}; "
            "run the same command again to go on"
        ) from None
    finally:
        running.close()
        log.close()
    return records


def _require_plausible(
    job: ReconstructionJob, capture: Capture, mattes: Mattes, numbers: range,
    state: LabelState | None = None,
) -> Examination:  # fmt: skip
    """Log and return what the footage tells of mistakes; raise `FatalFinding` for one that ruins normals.

    state: what the first frame told of its materials; None where an earlier run measured them.
    """
    rig = job.rig if job.calibrated is None else replace(job.rig, transfer=job.calibrated)
    try:
        mask, numbers = mattes.judged(capture, numbers)
        examined = examine_capture(capture, rig, mask, numbers, _in_one_material(job, mask, state))
    except BadCapture as problem:  # a bad frame is reported when its turn comes
        logger.debug("plausibility not checked: %s", problem)
        return Examination(findings=[])
    judge(examined.findings, job.allow)
    return examined


def _with_near_lamps(
    job: ReconstructionJob, examined: Examination, earlier: manifests.Manifest | None
) -> ReconstructionJob:
    """Return the job with M changing over the picture as the lamps are near; as an earlier run found it."""
    nearness = round(examined.nearness, _DIGITS_OF_NEARNESS)
    if earlier is not None:
        stored = earlier.options.get("lamps.nearness")
        nearness = stored if isinstance(stored, float) else 0.0
    if not nearness or job.rig.response.variation is not None or _was_pressed(job):
        return job
    size = (job.rig.camera.width, job.rig.camera.height)
    response = with_near_lamps(job.rig.response, nearness, size)
    return replace(job, rig=replace(job.rig, response=response), nearness=nearness)


def _with_blur(
    job: ReconstructionJob, examined: Examination, earlier: manifests.Manifest | None
) -> ReconstructionJob:
    """Return the job with the blur that expected errors count; as an earlier run found it."""
    blur_px = round(examined.blur_px, _DIGITS_OF_BLUR)
    if earlier is not None:
        stored = earlier.options.get("lens.blur_px")
        blur_px = stored if isinstance(stored, float) else 0.0
    return replace(job, blur_px=blur_px)


def _in_one_material(
    job: ReconstructionJob, mask: Mask | None, state: LabelState | None = None
) -> Callable[[LinearFrame], LinearFrame] | None:
    """Return what makes a frame look as if its subject were of the rig's material; None where it is."""
    if not job.reflectances:
        return None
    central, known = job.rig.response.central, (np.array(job.reflectances), np.array(job.pigments))
    labeller = MaterialLabeller(response=central, reflectances=known[0])
    told = LabelState(statistics=None if state is None else state.statistics)
    processor = FrameProcessor(job.rig, job.options, mask)

    def judged(frame: LinearFrame) -> LinearFrame:
        # A backdrop's noise looks like dark paint. It would give the subject's rim a wrong label.
        subject = processor.lit_subject(frame)
        labels, _ = labeller.labels(processor.by_strength(frame), subject, told)
        # lengths alone tell paint here: a surface without paint would fit any M; none is thought to be 1
        seen = relit(frame, central, labels, *known, mask=subject)
        return replace(seen, clipped=seen.clipped | near_seams(labels, _SEAM_PX))

    return judged


def _finish(
    root: Path, manifest: manifests.Manifest, log: FrameLog, numbers: range, seconds: float
) -> float | None:
    """Write what the frames took and how good they are; return the expected error in degrees."""
    entries = log.entries()
    done = [entries[n] for n in numbers if n in entries and not entries[n].failure]
    if any(entry.contact_mm2 is not None for entry in entries.values()):
        write_contacts(root, log)
    spent = [entry.seconds for entry in done]
    timings = {"frame_s": float(np.median(spent)) if spent else 0.0, "wall_s": round(seconds, 3)}
    errors = [entry.error_deg for entry in done if entry.error_deg is not None]
    error_deg = round(float(np.median(errors)), 2) if errors else None
    if error_deg is not None and error_deg > _LARGE_ERROR_DEG:
        logger.warning(
            "half of the normals may be off by more than %.0f degrees, their expected error (usual: below "
            "%.0f): noise, gloss, near lamps or another colour than the rig's; `vntoolkit doctor` names "
            "what it finds, `vntoolkit report` shows where",
            error_deg, _LARGE_ERROR_DEG,
        )  # fmt: skip
    ended = {"finished": manifests.now_utc(), "timings": timings, "error_deg": error_deg}
    manifests.write_manifest(root, manifest.model_copy(update=ended))
    return error_deg


def write_contacts(root: Path, log: FrameLog) -> None:
    """Write contact.csv: area and depth of what touches the gel, a line a frame."""
    rows = [
        f"{entry.number},{entry.contact_mm2:.3f},{entry.contact_depth_mm:.4f}"
        for entry in log.entries().values()
        if entry.contact_mm2 is not None
    ]
    write_text(root / "contact.csv", "\n".join(["frame,area_mm2,depth_mm", *rows]) + "\n")


# Before the first frame: options that rig and footage decide, and the manifest.


def resolve_options(
    job: ReconstructionJob,
    capture: Capture,
    mattes: Mattes,
    numbers: range,
    earlier: manifests.Manifest | None,
) -> tuple[ReconstructionJob, MeasuredMaterials]:
    """Return the job with the options that depend on rig and footage resolved, and the materials.

    earlier: manifest of the run that this one goes on with, None for none; what that run measured and chose
    is kept. Raises `BadInput` for a mask of another size and a reference frame that is not there,
    `BadCapture` for a first frame that shows nothing; nothing is written.
    """
    options = job.options
    there = (number for number in capture.present if number in numbers and not mattes.missing([number]))
    first = next(there, None)
    if first is None:
        raise BadInput(
            f"{job.source}: the files or mattes of all frames {numbers[0]} to {numbers[-1]} are missing"
        )
    pressed = _was_pressed(job)
    if pressed:  # a gel was calibrated itself, and nothing throws a shadow on it
        options = replace(options, materials=MaterialSearch.CALIBRATED, shadows=ShadowMethod.NONE)
    reference = options.reference_frame
    if reference is None:
        stored = None if earlier is None else earlier.options.get("reference_frame")
        reference = stored if isinstance(stored, int) else first
    elif reference >= capture.info.frame_count:
        raise BadInput(f"reference frame: the capture has only {capture.info.frame_count} frames")
    job = replace(job, options=replace(options, reference_frame=reference))
    if pressed:
        return job, MeasuredMaterials(entries=[])
    if earlier is not None and earlier.options.get("materials") == option_values(job.options)["materials"]:
        albedo = earlier.options.get("inversion.relative_albedo")
        albedo = albedo if isinstance(albedo, float) else None
        measured = MeasuredMaterials(entries=list(earlier.materials), relative_albedo=albedo)
    else:
        measured = measured_materials(job, capture, mattes, numbers)
    if measured.relative_albedo is not None:
        inversion = replace(options.inversion, relative_albedo=measured.relative_albedo)
        job = replace(job, options=replace(job.options, inversion=inversion))
    return _of_materials(job, measured.entries), measured


def _of_materials(job: ReconstructionJob, materials: Sequence[manifests.MaterialEntry]) -> ReconstructionJob:
    reflectances = tuple(entry.reflectance for entry in materials)
    pigments = tuple(entry.pigment or (0.0, 0.0, 0.0) for entry in materials)
    errors_deg = tuple(entry.error_deg for entry in materials)
    return replace(job, reflectances=reflectances, pigments=pigments, errors_deg=errors_deg)


def _was_pressed(job: ReconstructionJob) -> bool:
    fitted = job.rig.quality is not None and job.rig.quality.method == "presses"
    return job.rig.gel is not None or fitted


def manifest_of_run(
    job: ReconstructionJob,
    capture: Capture,
    mattes: Mattes,
    frames: FrameRange,
    materials: list[manifests.MaterialEntry],
    findings: list[Finding],
) -> manifests.Manifest:
    """Return the manifest of a run that begins now; reads and hashes all input files."""
    info = capture.info
    extra = {}
    if job.mask is not None:
        extra["mask"] = manifests.entry_of_files(job.mask, mattes.files)
    if job.background is not None:
        extra["background"] = manifests.entry_of_files(job.background, (job.background,))
    return manifests.Manifest(
        input=manifests.InputEntry(
            source=job.source,
            files=manifests.hashed(info.files),
            width=info.width,
            height=info.height,
            frame_count=info.frame_count,
            frame_rate_hz=info.frame_rate_hz,
            numbers=list(info.numbers),
            declared_frame_count=_declared(info),
            times_s=list(info.times_s),
        ),
        extra_files=extra,
        rig=entry_from_rig(job.rig),
        options=_options_that_shape(job),
        materials=materials,
        findings=[manifests.FindingEntry(check=f.check, level=f.level.value, text=f.text) for f in findings],
        frames=frames.to_text(),
        outputs=job.folders,
        versions=manifests.library_versions(),
        started=manifests.now_utc(),
    )


def _options_that_shape(job: ReconstructionJob) -> dict[str, Any]:
    """Return what results depend on; sensor and mattes only where they are not left at their defaults."""
    values = option_values(job.options, without=("to", "on_error"))
    # by value: options from the command line are of classes of their own
    for given, default, prefix in (
        (job.sensor, SensorOptions(), SENSOR_PREFIX), (job.matting, MatteOptions(), "matte.")
    ):  # fmt: skip
        own = option_values(given, prefix)
        values.update(own if own != option_values(default, prefix) else {})
    if job.nearness:
        values["lamps.nearness"] = job.nearness
    if job.blur_px:
        values["lens.blur_px"] = job.blur_px
    return values


def _declared(info: CaptureInfo) -> int | None:
    return info.promised_frame_count if info.promised_frame_count > info.frame_count else None


# Blocks of consecutive frames, which go to the processes.


def _begin(job: ReconstructionJob, threads: int | None) -> Callable[[Block], Iterator[FrameEntry]]:
    worker = BlockWorker(job if threads is None else replace(job, threads=min(job.threads, threads)))
    return lambda block: worker.run(*block)


def blocks_of(numbers: range) -> list[range]:
    """Cut the frame numbers of a run into blocks, in order."""
    starts = range(0, len(numbers), BLOCK_FRAMES)
    return [numbers[start : start + BLOCK_FRAMES] for start in starts]

"""What a run settles before its first frame, once for a whole folder, and the record that it keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Mask
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.captures import Capture
from vntoolkit.io.files import source_file
from vntoolkit.io.frame_range import FrameRange
from vntoolkit.io.manifest import InputEntry, Manifest, hashed, library_versions, now_utc
from vntoolkit.io.rig_schema import SourceEntry
from vntoolkit.io.rigs import entry_from_rig
from vntoolkit.normals.inversion import relative_albedo_from_frame
from vntoolkit.pipeline.block_work import ReconstructionJob
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.pipeline.option_values import option_values
from vntoolkit.shadows.detector import ShadowMethod


def settled_job(
    job: ReconstructionJob, capture: Capture, numbers: range, earlier: Mapping[str, Any]
) -> ReconstructionJob:
    """Return the job with the options that rig and footage decide, so that every frame is done alike.

    earlier: options of the run that this one goes on with, empty for none; what that run measured and chose
    is kept. Raises `BadInput` for a mask of another size and a reference frame that is not there,
    `BadCapture` for a first frame that shows nothing; nothing is written.
    """
    mask = job.read_mask(capture)
    options = job.options
    if _was_pressed(job):  # a gel was calibrated itself, and nothing throws a shadow on it
        options = replace(options, match_albedo=False, shadows=ShadowMethod.NONE)
    reference = options.reference_frame
    if reference is None:
        stored = earlier.get("reference_frame")
        reference = stored if isinstance(stored, int) else numbers[0]
    elif reference >= capture.info.frame_count:
        raise BadInput(f"reference frame: the capture has only {capture.info.frame_count} frames")
    job = replace(job, options=replace(options, reference_frame=reference))
    if not options.match_albedo:
        return job
    albedo = earlier.get("inversion.relative_albedo")
    if not isinstance(albedo, float):
        albedo = _measured_albedo(job, capture, numbers[0], mask)
    return replace(
        job, options=replace(job.options, inversion=replace(options.inversion, relative_albedo=albedo))
    )


def _was_pressed(job: ReconstructionJob) -> bool:
    return job.rig.quality is not None and job.rig.quality.method == "presses"


def _measured_albedo(job: ReconstructionJob, capture: Capture, number: int, mask: Mask | None) -> float:
    """Measure how bright the subject is against the calibration material."""
    processor = FrameProcessor(job.rig, job.options, mask, capture.background)
    first = next(capture.encoded_frames(number, number + 1))
    try:
        albedo = relative_albedo_from_frame(processor.linear(first), job.rig.response, mask)
    except BadInput as error:
        raise BadCapture(f"{first.name}: {error}") from error
    return float(np.format_float_positional(albedo, precision=4, fractional=False))


def manifest_of_run(job: ReconstructionJob, capture: Capture, frames: FrameRange) -> Manifest:
    """Return the record of a run of a settled job that begins now; all input files are read and hashed."""
    info = capture.info
    extra = {
        name: _source_entry(path)
        for name, path in (("mask", job.mask), ("background", job.background))
        if path is not None
    }
    outputs = {"normals": ["normals"], "depth": ["normals", "depth"], "mesh": ["normals", "depth", "mesh"]}
    return Manifest(
        input=InputEntry(
            source=job.source,
            files=hashed(info.files),
            width=info.width,
            height=info.height,
            frame_count=info.frame_count,
            frame_rate_hz=info.frame_rate_hz,
        ),
        extra_files=extra,
        rig=entry_from_rig(job.rig),
        options=option_values(job.options, without=("to", "on_error")),  # they shape no value
        frames=frames.to_text(),
        outputs=outputs[job.options.to.value] + (["shadows"] if job.has_labels else []),
        versions=library_versions(),
        started=now_utc(),
    )


def _source_entry(path: Path) -> SourceEntry:
    record = source_file(path)
    return SourceEntry(file=record.file, sha256=record.sha256)

"""Results to files for other programs: one animated file, or one file a frame, whole or not there."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import require_writable_folder, write_text
from vntoolkit.io.files import read_text
from vntoolkit.io.frame_range import FrameRange
from vntoolkit.io.glb import write_glb
from vntoolkit.io.json_text import parse_json
from vntoolkit.io.usd import write_usd_meshes, write_usd_sequence
from vntoolkit.pipeline.export_frames import frame_export, numbers_with_mesh, own_mesh
from vntoolkit.pipeline.export_options import (
    ExportedSurface,
    ExportFormat,
    ExportOptions,
    FileLengths,
    file_lengths,
)
from vntoolkit.pipeline.opened_result import OpenedResult, TrackedSurface, open_result
from vntoolkit.pipeline.option_values import option_values

_RECORD = "export.json"
_SUFFIXES = ("", ".ply", ".obj", ".glb", ".npz", ".png")  # of a frame's file; none of a frame's folder
Advance = Callable[[], None]


@dataclass(frozen=True, kw_only=True)
class ExportJob:
    """What to hand on. folder: of `reconstruct`. out: file or folder, None for folder/export/….

    footage, background: for `diligent`, as for `open_result`.
    """

    folder: Path
    options: ExportOptions
    out: Path | None = None
    frames: FrameRange | None = None
    footage: str = ""
    background: Path | None = None


@dataclass(frozen=True, kw_only=True)
class ExportSummary:
    """Where it went; frames in it, and how many of them were there already."""

    out: Path
    frames: int
    kept: int


def export(
    job: ExportJob,
    *,
    overwrite: bool = False,
    on_start: Callable[[int, int], None] = lambda total, done: None,
    on_frame: Advance = lambda: None,
) -> ExportSummary:
    """Hand a reconstruction on in another format.

    A single file appears when it is whole. In a folder every file does; the same command again goes on where
    it stopped, and writes again what has changed since. Raises `BadInput`.
    """
    result = open_result(job.folder, frames=job.frames, footage=job.footage, background=job.background)
    track = _track_of(result, job.options)
    if job.options.to is ExportFormat.USD or (job.options.to is ExportFormat.GLB and track is not None):
        return _export_animation(job, result, track, on_start, on_frame)
    return _export_folder(job, result, track, overwrite, on_start, on_frame)


def _track_of(result: OpenedResult, options: ExportOptions) -> TrackedSurface | None:
    if options.surface is ExportedSurface.FRAMES:
        return None
    if result.track is None and options.surface is ExportedSurface.TRACKED:
        raise BadInput(f"{result.folder.root}: holds no tracked surface; run `vntoolkit track` first")
    return result.track


def _export_animation(
    job: ExportJob,
    result: OpenedResult,
    track: TrackedSurface | None,
    on_start: Callable[[int, int], None],
    on_frame: Advance,
) -> ExportSummary:
    options, rate = job.options, result.manifest.input.frame_rate_hz
    suffix = ".glb" if options.to is ExportFormat.GLB else ".usdc"
    out = job.out or result.folder.root / "export" / f"surface{suffix}"
    if out.suffix.lower() not in ((".glb",) if suffix == ".glb" else (".usdc", ".usd")):
        raise BadInput(f"{out}: expected the name of a file that ends in {suffix}")
    lengths = file_lengths(options, result.length_unit)
    numbers = numbers_with_mesh(result, track)
    require_writable_folder(out.parent)  # and remove what a killed run left there
    on_start(len(numbers), 0)

    def passing(number: int, thing: Any) -> Any:
        on_frame()
        return thing

    if track is None:
        own = (passing(n, _scaled(own_mesh(result, n), lengths)) for n in numbers)
        count = write_usd_meshes(
            out, own, frame_rate_hz=rate, metres_per_unit=lengths.metres_per_unit, up=options.up
        )
        return ExportSummary(out=out, frames=count, kept=0)
    rows = [track.numbers.index(n) for n in numbers]
    moving = (passing(n, track.sequence.vertices[n] * lengths.factor) for n in rows)
    template = track.sequence.template
    if options.to is ExportFormat.GLB:
        count = write_glb(out, template, moving, frame_rate_hz=rate)
    else:
        count = write_usd_sequence(
            out, template, moving, frame_rate_hz=rate, metres_per_unit=lengths.metres_per_unit, up=options.up
        )
    return ExportSummary(out=out, frames=count, kept=0)


def _scaled(mesh: Mesh, lengths: FileLengths) -> Mesh:
    return replace(mesh, vertices=mesh.vertices * lengths.factor)


def _export_folder(
    job: ExportJob,
    result: OpenedResult,
    track: TrackedSurface | None,
    overwrite: bool,
    on_start: Callable[[int, int], None],
    on_frame: Advance,
) -> ExportSummary:
    out = job.out or result.folder.root / "export" / job.options.to.value
    writer = frame_export(result, track, job.options)
    if out.suffix and out.suffix.lower() == writer.suffix:
        raise BadInput(f"{out}: expected the name of a folder, for one {writer.suffix} a frame")
    numbers = writer.numbers()
    record = {"version": 1, "options": option_values(job.options), "result_sha256": result.digest}
    if not overwrite:
        _require_same(out, record)
    require_writable_folder(out)
    if overwrite:
        _clear(out)
    write_text(out / _RECORD, json.dumps(record, indent=2) + "\n")
    kept = {number for number in numbers if writer.is_current(out, number)}
    on_start(len(numbers), len(kept))
    for number in numbers:
        if number not in kept:
            writer.write(out, number)
            on_frame()
    writer.finish(out)
    return ExportSummary(out=out, frames=len(numbers), kept=len(kept))


def _require_same(out: Path, record: Mapping[str, Any]) -> None:
    """Refuse to mix files of other options or of another result into a folder."""
    path = out / _RECORD
    if path.exists() and parse_json(read_text(path), str(path)) != record:
        raise BadInput(
            f"{out}: holds an export with other options or of another result; add --overwrite to replace it, "
            "or choose another --out"
        )


def _clear(out: Path) -> None:
    """Remove the frames of an earlier export, whatever their format, and nothing else."""
    if not (out / _RECORD).exists():
        return
    for path in out.iterdir():
        if path.stem.isdigit() and len(path.stem) == 6 and path.suffix in _SUFFIXES:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    (out / "track.npz").unlink(missing_ok=True)
    (out / _RECORD).unlink()

"""`vntoolkit export`: convert results to the formats of other programs."""

import shlex
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import ClassVar

from vntoolkit.cli.output import print_next, print_next_program, say
from vntoolkit.cli.verb import verb
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.export import CleanOptions, ExportFormat, ExportFormatName, ExportOptions
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.shared import FrameOptions, MovedFootageOptions
from vntoolkit.pipeline.export import ExportJob
from vntoolkit.pipeline.export import export as run

_SHAPES = (".ply", ".obj", ".stl", ".glb", ".usd", ".usdc")  # that other programs open


@dataclass(frozen=True, kw_only=True)
class ExportArguments(FrameOptions, MovedFootageOptions, ExportOptions, CleanOptions, ReadingLimits):
    """What `export` takes."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("cleaning",)

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote."""
    to: ExportFormat | ExportFormatName  # type: ignore[assignment]
    clean: bool = False
    """Remove small pieces of the meshes and close small holes (pymeshlab). --most-faces and the like imply
    it."""
    out: OptionalFile = named(None)
    """The file (usd, glb) or folder to write; default FOLDER/export/…."""
    background: OptionalFile = named(None)
    """The background image that the reconstruction subtracted."""
    overwrite: bool = False
    """Replace an export with other options in the folder."""


@verb(ExportArguments)
def export(asked: ExportArguments) -> Path:
    """Convert a reconstruction to the formats of other programs.

    Only --to diligent reads the footage again and needs --footage and --background. The same command again
    continues an interrupted run and writes what has changed since.
    """
    cleaning = asked.part(CleanOptions)
    cleans = asked.clean or cleaning != CleanOptions()
    job = ExportJob(
        folder=Path(asked.folder),
        options=replace(asked.part(ExportOptions), cleaning=cleaning if cleans else None),
        out=asked.out,
        frames=asked.frames,
        footage=asked.footage,
        background=asked.background,
    )
    summary = run(job, overwrite=asked.overwrite)
    kept = f", {summary.kept} of them from before" if summary.kept else ""
    which = {True: " of the tracked mesh", False: " of each frame's own mesh", None: ""}[summary.is_tracked]
    say(f"{summary.out}: {summary.frames} frames{which}{kept}")
    files = [summary.out] if summary.out.is_file() else sorted(summary.out.iterdir())
    if job.options.to is ExportFormat.PROFILE:
        from vntoolkit.report.figures import write_profile

        for path in files:
            if path.suffix == ".csv":
                write_profile(path.with_suffix(".png"), path)
    if job.options.to is ExportFormat.RRD:
        say(f"next: rerun {shlex.quote(str(summary.out))}")
        return summary.out
    shapes = [path for path in files if path.suffix.lower() in _SHAPES]
    if shapes:
        print_next_program(shapes[0])
    else:
        print_next("report", str(asked.folder))
    return summary.out

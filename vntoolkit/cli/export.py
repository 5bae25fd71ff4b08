"""`vntoolkit export`: convert results to the formats of other programs."""

import shlex
from pathlib import Path

from vntoolkit.cli.output import print_next, print_next_program, say
from vntoolkit.cli.verb import verb
from vntoolkit.options.export import ExportArguments, ExportFormat
from vntoolkit.pipeline.export import export as run

_SHAPES = (".ply", ".obj", ".stl", ".glb", ".usd", ".usdc")  # that other programs open


@verb(ExportArguments)
def export(asked: ExportArguments) -> Path:
    """Convert a reconstruction to the formats of other programs.

    Only --to diligent reads the footage again and needs --footage and --background. The same command again
    continues an interrupted run and writes what has changed since.
    """
    summary = run(asked)
    kept = f", {summary.kept} of them from before" if summary.kept else ""
    which = {True: " of the tracked mesh", False: " of each frame's own mesh", None: ""}[summary.is_tracked]
    say(f"{summary.out}: {summary.frames} frames{which}{kept}")
    files = [summary.out] if summary.out.is_file() else sorted(summary.out.iterdir())
    if asked.to is ExportFormat.PROFILE:
        from vntoolkit.report.figures import write_profile

        for path in files:
            if path.suffix == ".csv":
                write_profile(path.with_suffix(".png"), path)
    if asked.to is ExportFormat.RRD:
        say(f"next: rerun {shlex.quote(str(summary.out))}")
        return summary.out
    shapes = [path for path in files if path.suffix.lower() in _SHAPES]
    if shapes:
        print_next_program(shapes[0])
    else:
        print_next("report", str(asked.folder))
    return summary.out

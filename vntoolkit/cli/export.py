"""`vntoolkit export`: convert results to the formats of other programs."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vntoolkit.cli.flags import Flags, Footage, Frames, Overwrite, verb
from vntoolkit.cli.output import ProgressBars, print_next, print_next_program
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.options.export import CleanOptions, ExportOptions
from vntoolkit.pipeline.export import ExportJob
from vntoolkit.pipeline.export import export as run

_SHAPES = (".ply", ".obj", ".glb", ".usd", ".usdc")  # that other programs open


@verb("max_megapixels", "max_vertices")
def export(
    folder: Path,
    *,
    options: Annotated[ExportOptions, Flags(without=("cleaning",))],
    clean: Annotated[bool, Parameter(negative=())] = False,
    cleaning: Annotated[CleanOptions | None, Flags(renamed={"most_faces": "faces"})] = None,
    out: Path | None = None,
    frames: Frames = "::",
    footage: Footage = "",
    background: Path | None = None,
    overwrite: Overwrite = False,
) -> None:
    """Convert a reconstruction to the formats of other programs.

    Only --to diligent reads the footage again and needs --footage and --background. The same command again
    continues an interrupted run and writes what has changed since.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote.
    clean
        Remove small pieces of the meshes and close small holes (pymeshlab). --faces and the like imply it.
    out
        The file (usd, glb) or folder to write; default FOLDER/export/….
    background
        The background image that the reconstruction subtracted.
    overwrite
        Replace an export with other options in the folder.
    """
    job = ExportJob(
        folder=folder,
        options=replace(options, cleaning=cleaning or (CleanOptions() if clean else None)),
        out=out,
        frames=FrameRange.from_text(frames),
        footage=footage,
        background=background,
    )
    with ProgressBars() as bars:
        summary = run(job, overwrite=overwrite, on_start=partial(bars.begin, "export"), on_frame=bars.step)
    kept = f", {summary.kept} of them from before" if summary.kept else ""
    which = {True: " of the tracked mesh", False: " of each frame's own mesh", None: ""}[summary.is_tracked]
    print(f"{summary.out}: {summary.frames} frames{which}{kept}")
    files = [summary.out] if summary.out.is_file() else sorted(summary.out.iterdir())
    shapes = [path for path in files if path.suffix.lower() in _SHAPES]
    if shapes:
        print_next_program(shapes[0])
    else:
        print_next("report", folder)

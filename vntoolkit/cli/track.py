"""`vntoolkit track`: register all frames of a reconstruction to one mesh."""

from functools import partial
from pathlib import Path
from statistics import median
from typing import Annotated

from cyclopts import Parameter

from vntoolkit.cli.flags import Flags, Footage, Overwrite, verb
from vntoolkit.cli.output import ProgressBars, print_next
from vntoolkit.errors import BadInput
from vntoolkit.io.results.seams import read_seams
from vntoolkit.options.tracking import CheckerboardOptions, TrackingOptions
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.texture import write_texture
from vntoolkit.pipeline.track import TrackJob
from vntoolkit.pipeline.track import track as run


@verb("max_megapixels", "max_vertices")
def track(
    folder: Path,
    *,
    seams: Path | None = None,
    template: int | None = None,
    out: Path | None = None,
    lost_px: float = 4.0,
    refine_albedo: Annotated[bool, Parameter(negative=(), show=False)] = False,
    footage: Footage = "",
    background: Path | None = None,
    overwrite: Overwrite = False,
    tracking: Annotated[TrackingOptions | None, Flags()] = None,
    board: Annotated[CheckerboardOptions | None, Flags()] = None,
) -> None:
    """Register the frames of a reconstruction to one mesh of fixed topology, and draw a checkerboard on it.

    Its texture is gathered from the footage, which is read again for that. The same command again continues
    an interrupted run.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote, with normals and depth.
    seams
        JSON file of polylines on the template image. The surface is cut along them, as at mouth and eyes.
    template
        Number of the template frame. Default: the first. It is tracked forwards and backwards.
    out
        The folder to write; default FOLDER/track.
    lost_px
        A vertex is called lost where its expected error is above this, in pixels.
    background
        The background image that the reconstruction subtracted, for the colours of the texture.
    overwrite
        Replace the tracks that the folder holds.
    """
    if refine_albedo:
        raise BadInput(
            "--refine-albedo is gone, since normals were hardly better for it; leave it out, or calibrate "
            "with one photograph per lamp (--single-light), so that `reconstruct` tells paint from relief"
        )
    job = TrackJob(
        folder=folder,
        options=tracking or TrackingOptions(),
        template=template,
        seams=() if seams is None else read_seams(seams),
        out=out,
        lost_px=lost_px,
        footage=footage,
        background=background,
    )
    with ProgressBars() as bars:
        summary = run(job, overwrite=overwrite, on_start=partial(bars.begin, "track"), on_frame=bars.step)
    files = write_checkerboard(folder, job.target, board)
    held = f", {len(summary.missing)} missing and held" if summary.missing else ""
    resumed = f", {summary.resumed} of them from before" if summary.resumed else ""
    print(f"{summary.folder}: {summary.vertices} vertices, {summary.frames} frames{resumed}{held}")
    if summary.visible:
        middle, least = median(summary.visible), min(summary.visible)
        print(f"reported visible: {middle:.1%} of the vertices, {least:.1%} in the worst frame")
    print(f"{files.video}, {files.sheet.name}")
    made = write_texture(folder, job.target, footage=footage, background=background)
    shown = made.texture.albedo or made.texture.normal
    print(f"{shown}: {made.covered:.1%} of the surface from {made.frames} frames, the rest filled")
    print_next("dress", job.target, "--motion", "data/walk.bvh", "--out", "cloth.usdc")

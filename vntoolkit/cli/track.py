"""`vntoolkit track`: register all frames of a reconstruction to one mesh."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from vntoolkit.cli.flags import Overwrite, flags_from, limits_on
from vntoolkit.cli.output import ProgressBars
from vntoolkit.errors import BadInput
from vntoolkit.io.results.seams import read_seams
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.track import TrackJob
from vntoolkit.pipeline.track import track as run
from vntoolkit.tracking.checkerboard import CheckerboardOptions
from vntoolkit.tracking.options import (
    Confidence,
    DriftCorrection,
    DriftOptions,
    FlowOptions,
    Regulariser,
    Tears,
    TrackingOptions,
)
from vntoolkit.tracking.published import Tracker, options_of

if TYPE_CHECKING:
    DriftFlags: TypeAlias = DriftOptions | None
    FlowFlags: TypeAlias = FlowOptions | None
    BoardFlags: TypeAlias = CheckerboardOptions | None
else:
    DriftFlags = flags_from(DriftOptions, correction="drift", every="drift_every", levels="drift_levels")
    FlowFlags = flags_from(FlowOptions, method="flow", window_px="flow_window", levels="flow_levels")
    BoardFlags = flags_from(CheckerboardOptions)


@limits_on("max_megapixels", "max_vertices")
def track(
    folder: Path,
    *,
    method: Tracker = Tracker.DEFAULT,
    regulariser: Regulariser | None = None,
    smoothing_length: float | None = None,
    data_share: float | None = None,
    confidence: Confidence | None = None,
    seams: Path | None = None,
    tears: Tears | None = None,
    template: int | None = None,
    out: Path | None = None,
    overwrite: Overwrite = False,
    drift: DriftFlags = None,
    flow: FlowFlags = None,
    board: BoardFlags = None,
) -> None:
    """Register the frames of a reconstruction to one mesh of fixed topology, and draw a checkerboard on it.

    The same command again continues an interrupted run.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote, with normals and depth.
    method
        Name of a whole method. The options below change parts of it. Only the default corrects drift.
    regulariser
        How the motion is regularised.
    smoothing_length
        Length over which motion is smoothed, in edges of the mesh. Laplacian coordinates keep waves longer
        than about five times this length.
    data_share
        Weight α of the data term for the translation regulariser, 0 to 1.
    confidence
        How vertices are treated where the frame does not match the template.
    seams
        JSON file of polylines on the template image. The surface is cut along them, as at mouth and eyes.
    tears
        Where else the template is cut: where its normals show an occlusion, or nowhere.
    template
        Number of the template frame. Default: the first. It is tracked forwards and backwards.
    out
        The folder to write; default FOLDER/track.
    overwrite
        Replace the tracks that the folder holds.
    """
    options = _options(method, regulariser, smoothing_length, data_share, confidence, drift, flow)
    options = options if tears is None else replace(options, tears=tears)
    job = TrackJob(
        folder=folder,
        options=options,
        template=template,
        seams=() if seams is None else read_seams(seams),
        out=out,
    )
    with ProgressBars() as bars:
        summary = run(job, overwrite=overwrite, on_start=partial(bars.begin, "track"), on_frame=bars.step)
    files = write_checkerboard(folder, job.target, board)
    held = f", {len(summary.missing)} missing and held" if summary.missing else ""
    resumed = f", {summary.resumed} of them from before" if summary.resumed else ""
    print(f"{summary.folder}: {summary.vertices} vertices, {summary.frames} frames{resumed}{held}")
    print(f"{files.video}, {files.sheet.name}")


def _options(
    method: Tracker,
    regulariser: Regulariser | None,
    smoothing_length: float | None,
    data_share: float | None,
    confidence: Confidence | None,
    drift: DriftOptions | None,
    flow: FlowOptions | None,
) -> TrackingOptions:
    base = options_of(method)
    if drift is not None and method is not Tracker.DEFAULT:
        raise BadInput(
            f"--method {method.value} corrects no drift: omit --drift and its options, or omit --method"
        )
    if flow is not None and method is Tracker.NO_REGISTRATION:
        raise BadInput(f"--method {method.value} uses no flow: omit --flow and its options")
    chosen = regulariser or base.regulariser
    drift = drift or base.drift
    weighted = chosen is Regulariser.LAPLACIAN and drift.correction is DriftCorrection.TEMPLATE
    return replace(
        base,
        regulariser=chosen,
        smoothing_length=base.smoothing_length if smoothing_length is None else smoothing_length,
        data_share=base.data_share if data_share is None else data_share,
        confidence=confidence or (base.confidence if weighted else Confidence.NONE),
        drift=drift,
        flow=flow or base.flow,
    )

"""`vntoolkit evaluate tracks`: registered meshes against the simulator's vertices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from vntoolkit.cli.flags import flags_from
from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import PICTURE, require_output
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.track_error import TrackError, TrackErrorOptions
from vntoolkit.pipeline.evaluate_tracks import evaluate_tracks, write_track_errors
from vntoolkit.report.track_plot import write_error_plot

if TYPE_CHECKING:
    ErrorFlags: TypeAlias = TrackErrorOptions | None
else:
    ErrorFlags = flags_from(TrackErrorOptions)

_LINES = 12  # of a table on the screen; the file has all frames


@limits_on("max_vertices")
def tracks(
    folder: Path,
    *others: Path,
    truth: Path,
    every: int = 10,
    out: Path | None = None,
    plot: Path | None = None,
    options: ErrorFlags = None,
) -> None:
    """Print the end-point error in pixels by frame: of all vertices, and of those not declared lost.

    Every vertex is judged whose true point can be seen in that frame. `astray` is the share of them that is
    off by more than 4 pixels, `lost` the share that the tracker itself declares lost; the last two columns
    leave these out, and mean nothing without that share.

    Parameters
    ----------
    folder
        The folder that `vntoolkit track` wrote (or the one that holds its folder track).
    others
        More of them, to compare.
    truth
        The folder that `vntoolkit simulate` wrote.
    every
        Judge every n-th frame, and the last.
    out
        Also write all judged frames as a tab-separated table; of several folders, one table each, NAME.tsv in
        this folder.
    plot
        Also draw the error against the frame, .png or .svg.
    """
    if every < 1:
        raise BadInput(f"every: expected 1 or more, got {every}")
    folders = {_name(each): each for each in (folder, *others)}
    if len(folders) <= len(others):
        raise BadInput("evaluate tracks: two of the folders have the same name; give each its own")
    tables = {} if out is None else {name: out / f"{name}.tsv" if others else out for name in folders}
    for table in tables.values():
        require_output(table)
    require_output(plot, PICTURE)
    results = {}
    for name, each in folders.items():
        target = each / "track" if (each / "track").is_dir() else each
        results[name] = evaluate_tracks(target, truth, every, options)
    for name, errors in results.items():
        if name in tables:
            write_track_errors(tables[name], errors)
        _print_table(name, errors)
    if plot is not None:
        write_error_plot(plot, results)
        print(plot)


def _name(folder: Path) -> str:
    resolved = folder.resolve()
    return resolved.parent.name if resolved.name == "track" else resolved.name


def _print_table(name: str, errors: list[TrackError]) -> None:
    step = max(1, -(-(len(errors) - 1) // _LINES))
    print(name)
    print("       of all vertices in sight           of those not declared lost")
    print("frame  median px   95 % px  astray    lost  median px   95 % px")
    for error in [*errors[:-1:step], errors[-1]]:
        print(
            f"{error.frame:5d}  {error.median_px:9.2f} {error.p95_px:9.2f} {100 * error.astray:6.1f}% "
            f"{100 * error.lost:6.1f}%  {error.found_median_px:9.2f} {error.found_p95_px:9.2f}"
        )

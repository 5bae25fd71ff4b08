"""`vntoolkit evaluate tracks`: a registered mesh against the simulator's vertices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from vntoolkit.cli.flags import flags_from
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.track_error import TrackErrorOptions
from vntoolkit.pipeline.evaluate_tracks import evaluate_tracks, write_track_errors

if TYPE_CHECKING:
    ErrorFlags: TypeAlias = TrackErrorOptions | None
else:
    ErrorFlags = flags_from(TrackErrorOptions)

_LINES = 12  # of the table on the screen; the file has all frames


def tracks(
    folder: Path,
    *,
    truth: Path,
    every: int = 10,
    out: Path | None = None,
    options: ErrorFlags = None,
) -> None:
    """Print the end-point error in pixels by frame: median, 95 %, and the share of lost vertices.

    Parameters
    ----------
    folder
        The folder that `vntoolkit track` wrote (or the one that holds its folder track).
    truth
        The folder that `vntoolkit simulate` wrote.
    every
        Judge every n-th frame, and the last.
    out
        Also write all judged frames as a tab-separated table.
    """
    if every < 1:
        raise BadInput(f"every: expected 1 or more, got {every}")
    target = folder / "track" if (folder / "track").is_dir() else folder
    errors = evaluate_tracks(target, truth, every, options)
    if out is not None:
        write_track_errors(out, errors)
    step = max(1, -(-(len(errors) - 1) // _LINES))
    print("frame  median px   95 % px   lost")
    for error in [*errors[:-1:step], errors[-1]]:
        print(f"{error.frame:5d}  {error.median_px:9.2f} {error.p95_px:9.2f} {100 * error.lost:5.1f}%")

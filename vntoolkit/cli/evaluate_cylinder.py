"""`vntoolkit evaluate cylinder`: a sequence's normals against one fitted cylinder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from vntoolkit.cli.flags import flags_from
from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import require_output
from vntoolkit.cli.progress import progress_bar
from vntoolkit.cli.shared_flags import Footage, Frames
from vntoolkit.cli.tables import print_table, write_json
from vntoolkit.evaluation.cylinder_fit import CylinderOptions
from vntoolkit.io.frame_range import FrameRange
from vntoolkit.pipeline.evaluate_cylinder import CylinderEvaluation
from vntoolkit.pipeline.evaluate_cylinder import evaluate_cylinder as run
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.report.error_figures import write_error_over_time

if TYPE_CHECKING:
    CylinderFlags: TypeAlias = CylinderOptions | None
else:
    CylinderFlags = flags_from(CylinderOptions)

_LINES = 10  # of the table on the screen; the file has all frames


@limits_on("max_megapixels")
def cylinder(
    folder: Path,
    *,
    truth: Path | None = None,
    frames: Frames = "::",
    footage: Footage = "",
    out: Path | None = None,
    options: CylinderFlags = None,
) -> CylinderEvaluation:
    """Fit one cylinder to a reconstruction of a moving cylinder; measure its normals against it (Figure 7).

    Writes cylinder.json and cylinder.png.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote.
    truth
        The folder that `vntoolkit simulate` wrote: judges the fit itself too.
    out
        Folder to write; default: `evaluation` in the given folder.
    """
    target = out or folder / "evaluation"
    require_output(target / "cylinder.json")
    result = open_result(folder, frames=FrameRange.from_text(frames), footage=footage)
    with progress_bar("cylinder", 2 * len(result.numbers)) as advance:
        found = run(result, truth, options, lambda _number: advance(1))
    write_json(target / "cylinder.json", found)
    times = np.array([error.frame for error in found.frames]) / found.frame_rate_hz
    mean, std = (np.array([getattr(e, name) for e in found.frames]) for name in ("mean_deg", "std_deg"))
    title = f"{found.mean_deg:.2f} ± {found.std_deg:.2f} degrees over all frames"
    write_error_over_time(target / "cylinder.png", times, mean, std, title)
    _print(found)
    print(f"{target}: cylinder.json, cylinder.png")
    return found


def _print(found: CylinderEvaluation) -> None:
    columns = ["frame", "pixels", "mean", "std"]
    with_truth = found.frames[0].truth is not None
    if with_truth:
        columns += ["true mean", "true std", "axis off", "radius off %"]
    step = max(1, -(-len(found.frames) // _LINES))
    rows = []
    for error in found.frames[::step]:
        row = [str(error.frame), str(error.pixels), f"{error.mean_deg:.2f}", f"{error.std_deg:.2f}"]
        if error.truth is not None:
            t = error.truth
            row += [f"{t.normals_mean_deg:.2f}", f"{t.normals_std_deg:.2f}"]
            row += [f"{t.axis_deg:.2f}", f"{t.radius_percent:+.2f}"]
        rows.append(row)
    print_table("degrees between normals and the fitted cylinder", columns, rows)
    print(
        f"{len(found.frames)} frames: {found.mean_deg:.2f} ± {found.std_deg:.2f} degrees (paper: 8.67 ± 4.29)"
    )
    truths = [error.truth for error in found.frames if error.truth is not None]
    if truths:
        axis = [t.axis_deg for t in truths]
        radius = [abs(t.radius_percent) for t in truths]
        print(
            f"the fit against the truth: axis {np.median(axis):.2f} degrees (worst {max(axis):.2f}), "
            f"radius {np.median(radius):.2f} % (worst {max(radius):.2f})"
        )

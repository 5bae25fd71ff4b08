"""`vntoolkit evaluate normals`: angles between two normal maps, or two folders of them."""

from __future__ import annotations

from pathlib import Path

from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import require_output
from vntoolkit.cli.progress import progress_bar
from vntoolkit.cli.tables import print_table, write_json
from vntoolkit.evaluation.angular_error import AngularError
from vntoolkit.io.conventions import NormalConvention
from vntoolkit.pipeline.evaluate_normals import compare_normal_files, pairs_of
from vntoolkit.report.error_figures import write_cumulative_errors, write_error_map

_LINES = 10  # of the table on the screen; the file has all frames
COLUMNS = ["", "pixels", "mean", "median", "std", "95 %", "< 5°", "< 10°", "< 20°"]


@limits_on("max_megapixels")
def normals(
    measured: Path,
    reference: Path,
    *,
    out: Path = Path("evaluation"),
    measured_convention: NormalConvention | None = None,
    reference_convention: NormalConvention | None = None,
) -> None:
    """Print the angles in degrees between two normal maps, or between two folders of them frame by frame.

    Writes normals.json, the map of the worst frame's errors (normals_map.png) and the cumulative curve
    (normals_curve.png).

    Parameters
    ----------
    measured
        A normal map, EXR or PNG, or a folder of them, such as `vntoolkit reconstruct` writes.
    reference
        What it is compared with; a folder may be that of `vntoolkit simulate`. Paired by file names.
    out
        Folder to write.
    measured_convention
        Axes of the measured map; default: what the file states, else x right, y up, z to the viewer.
    reference_convention
        Axes of the reference.
    """
    require_output(out / "normals.json")
    pairs = pairs_of(measured, reference)
    with progress_bar("normals", len(pairs)) as advance:
        found = compare_normal_files(
            pairs, (measured_convention, reference_convention), lambda _name: advance(1)
        )
    content = {"measured": measured, "reference": reference}
    write_json(out / "normals.json", {**content, "overall": found.overall, "frames": found.frames})
    title = f"{found.worst}: mean {found.frames[found.worst].mean_deg:.2f}°"
    write_error_map(out / "normals_map.png", found.worst_deg, found.worst_mask, title, "degrees")
    title = f"{measured.name} against {reference.name}"
    write_cumulative_errors(out / "normals_curve.png", {"all frames": found.curve_deg}, title, "degrees")
    step = max(1, -(-len(found.frames) // _LINES))
    rows = [error_row(name, error) for name, error in list(found.frames.items())[::step]]
    if len(found.frames) > 1:
        rows.append(error_row("all", found.overall))
    print_table("degrees between the normals", COLUMNS, rows)
    print(f"{out}: normals.json, normals_map.png, normals_curve.png")


def error_row(name: str, error: AngularError) -> list[str]:
    """Format one row of `COLUMNS`."""
    angles = (error.mean_deg, error.median_deg, error.std_deg, error.p95_deg)
    shares = (error.below_5, error.below_10, error.below_20)
    return [name, str(error.pixels), *(f"{a:.2f}" for a in angles), *(f"{100 * s:.1f}%" for s in shares)]

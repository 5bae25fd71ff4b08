"""`vntoolkit evaluate integration`: the integrators on surfaces whose depth is known."""

from __future__ import annotations

from pathlib import Path

from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import require_output
from vntoolkit.cli.progress import progress_bar
from vntoolkit.cli.tables import print_table, write_json
from vntoolkit.pipeline.evaluate_integration import objects_in, real_object_errors, surface_cases
from vntoolkit.report.error_figures import write_cumulative_errors, write_error_map


@limits_on("max_megapixels")
def integration(*, data: Path | None = None, size: int = 256, out: Path = Path("evaluation")) -> None:
    """Print the depth errors of every integrator on analytic surfaces, and on real objects where given.

    Writes integration.json, the errors' curves on the torn surface (integration_curve.png) and the map of the
    last integrator's (integration_map.png).

    Parameters
    ----------
    data
        Folder of real objects, one folder each: normal_map.png, mask.png, K.txt, depth_gt.npz (millimetres).
    size
        Side of the analytic surfaces in pixels.
    out
        Folder to write.
    """
    require_output(out / "integration.json")
    objects = [] if data is None else objects_in(data)
    cases = surface_cases(size)
    rows, curves, last = [], {}, None
    with progress_bar("integration", len(cases) + len(objects)) as advance:
        for case in cases:
            error = case.measure()
            rows.append(error)
            if case.is_torn:
                curves[error.integrator] = error.distances_percent[error.mask]
                last = error
            advance(1)
        real = []
        for folder in objects:
            real += real_object_errors(folder)
            advance(1)
    plain = [{"surface": r.surface, "integrator": r.integrator, **r.numbers} for r in rows]
    write_json(out / "integration.json", {"surfaces": plain, "objects": real})
    columns = ["surface", "integrator", "mean", "rms", "largest"]
    table = [
        [r.surface, r.integrator, *(f"{r.numbers[n]:.2e}" for n in ("mean", "rms", "largest"))] for r in rows
    ]
    print_table("depth error, % of the surface's range", columns, table, names=2)
    if real:
        table = [[e.name, e.integrator, f"{e.mean_mm:.3f}", f"{e.median_mm:.3f}"] for e in real]
        print_table(
            "depth error on real objects, mm", ["object", "integrator", "mean", "median"], table, names=2
        )
    write_cumulative_errors(out / "integration_curve.png", curves, "torn surface", "error, % of the range")
    if last is not None:
        title = f"{last.surface}, {last.integrator}"
        write_error_map(
            out / "integration_map.png", last.distances_percent, last.mask, title, "% of the range"
        )
    print(f"{out}: integration.json, integration_curve.png, integration_map.png")

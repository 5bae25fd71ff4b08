"""`vntoolkit demo`: run the whole chain on a simulated capture and write a report."""

from pathlib import Path
from typing import Annotated

from vntoolkit.cli.flags import Flags, Jobs, Overwrite, verb
from vntoolkit.cli.output import ProgressBars, print_next
from vntoolkit.options.simulation import DemoOptions
from vntoolkit.pipeline.demo import DemoFolder, run_demo
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.pipeline.truth_comparison import compare_frame_with_truth
from vntoolkit.report.report import write_report
from vntoolkit.report.truth_section import truth_section


@verb()
def demo(
    *,
    out: Path = Path("demo"),
    jobs: Jobs = 1,
    overwrite: Overwrite = False,
    options: Annotated[DemoOptions | None, Flags()] = None,
) -> None:
    """Simulate a board and a dancer's sweater, calibrate, reconstruct, and compare with the truth.

    Takes a minute on two cores; where set-up has not compiled the loops, 20 s more the first time. An
    interrupted run continues where it stopped.

    Parameters
    ----------
    out
        The folder to write: board, rig.json, sweater, reconstruction and report.html.
    overwrite
        Replace what the folder holds.
    """
    folder = DemoFolder(root=out)
    with ProgressBars() as bars:
        run_demo(folder, options, jobs=jobs, overwrite=overwrite, on_progress=bars.reach)
    result = open_result(folder.reconstruction)
    page = write_report(
        folder.reconstruction, out / "report.html", extra=[truth_section(result, folder.garment)]
    )
    middle = compare_frame_with_truth(result, folder.garment, result.numbers[len(result.numbers) // 2])
    print(
        f"normals are {middle.normals.median_deg:.1f} degrees from the truth "
        f"(median of frame {middle.number})"
    )
    print(f"meshes, one per frame: {folder.reconstruction / 'mesh'}")
    print(f"report: {page}")
    print_next("view", folder.reconstruction)

"""`vntoolkit demo`: run the whole chain on a simulated capture and write a report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from vntoolkit.cli.output import print_next, say
from vntoolkit.cli.verb import verb
from vntoolkit.options.base import File, within
from vntoolkit.options.shared import JobOptions
from vntoolkit.pipeline.demo import GARMENT, RECONSTRUCTION, run_demo
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.pipeline.truth_comparison import compare_with_truth
from vntoolkit.report.report import write_report
from vntoolkit.report.truth_section import truth_section


@dataclass(frozen=True, kw_only=True)
class DemoArguments(JobOptions):
    """What `demo` takes."""

    out: File = Path("demo")
    """The folder to write: board, rig.json, sweater, reconstruction and report.html."""
    overwrite: bool = False
    """Replace what the folder holds."""
    frames: Annotated[int, within(1, 1000, "1 to 1000 frames")] = 12
    """Frames of the garment that are filmed and reconstructed."""


@verb(DemoArguments)
def demo(asked: DemoArguments) -> OpenedResult:
    """Simulate a board and a dancer's sweater, calibrate, reconstruct, and compare with the truth.

    Takes a minute on two cores; where set-up has not compiled the loops, 20 s more the first time. An
    interrupted run continues where it stopped.
    """
    root = Path(asked.out)
    run_demo(root, asked.frames, jobs=asked.jobs, overwrite=asked.overwrite)
    made, truth = root / RECONSTRUCTION, root / GARMENT
    result = read_result(made)
    page = write_report(made, root / "report.html", extra=[truth_section(result, truth)])
    (middle,) = compare_with_truth(result, truth, [result.numbers[len(result.numbers) // 2]])
    say(
        f"normals are {middle.normals.median_deg:.1f} degrees from the truth "
        f"(median of frame {middle.number})"
    )
    say(f"meshes, one per frame: {made / 'mesh'}")
    say(f"report: {page}")
    print_next("view", made)
    return result

"""`vntoolkit demo`: run the whole chain on a simulated capture and write a report."""

from dataclasses import dataclass
from pathlib import Path

from vntoolkit.cli.output import ProgressBars, print_next, say
from vntoolkit.cli.verb import command, verb
from vntoolkit.options.base import File
from vntoolkit.options.shared import JobOptions
from vntoolkit.options.simulation import DemoOptions
from vntoolkit.pipeline.demo import DemoFolder, run_demo
from vntoolkit.pipeline.opened_result import OpenedResult, open_result
from vntoolkit.pipeline.truth_comparison import compare_frame_with_truth
from vntoolkit.report.report import write_report
from vntoolkit.report.truth_section import truth_section


@dataclass(frozen=True, kw_only=True)
class DemoArguments(DemoOptions, JobOptions):
    """What `demo` takes."""

    out: File = Path("demo")
    """The folder to write: board, rig.json, sweater, reconstruction and report.html."""
    overwrite: bool = False
    """Replace what the folder holds."""


def _shown(asked: DemoArguments) -> tuple[DemoFolder, OpenedResult, Path]:
    folder = DemoFolder(root=Path(asked.out))
    with ProgressBars() as bars:
        options = asked.part(DemoOptions)
        run_demo(folder, options, jobs=asked.jobs, overwrite=asked.overwrite, on_progress=bars.reach)
    result = open_result(folder.reconstruction)
    extra = [truth_section(result, folder.garment)]
    return folder, result, write_report(folder.reconstruction, folder.root / "report.html", extra=extra)


@verb(DemoArguments)
def demo(asked: DemoArguments) -> OpenedResult:
    """Simulate a board and a dancer's sweater, calibrate, reconstruct, and compare with the truth.

    Takes a minute on two cores; where set-up has not compiled the loops, 20 s more the first time. An
    interrupted run continues where it stopped.
    """
    return _shown(asked)[1]


@command(demo)
def demo_command(asked: DemoArguments) -> None:
    """Print how far the normals are from the truth, and where the results are."""
    folder, result, page = _shown(asked)
    middle = compare_frame_with_truth(result, folder.garment, result.numbers[len(result.numbers) // 2])
    say(
        f"normals are {middle.normals.median_deg:.1f} degrees from the truth "
        f"(median of frame {middle.number})"
    )
    say(f"meshes, one per frame: {folder.reconstruction / 'mesh'}")
    say(f"report: {page}")
    print_next("view", folder.reconstruction)

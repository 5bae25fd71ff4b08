"""`vntoolkit report`: write an HTML page on the quality of a reconstruction."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from vntoolkit.cli.output import PAGE, print_next, require_output, say
from vntoolkit.cli.verb import verb
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.footage import ReadingLimits
from vntoolkit.options.pages import ReportOptions
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.report import report as pages


@dataclass(frozen=True, kw_only=True)
class ReportArguments(ReportOptions, ReadingLimits):
    """What `write_report` takes."""

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote."""
    out: OptionalFile = named(None)
    """The page to write; default FOLDER/report.html."""
    json: bool = False
    """Print findings, frames and options as JSON instead of writing a page. In Python the page is written."""


def _shown(asked: ReportArguments, run: Callable[[ReportArguments], Path]) -> None:
    """Print the page's name and what comes next."""
    folder = Path(asked.folder)
    if asked.json:
        print(json.dumps(pages.content_of_report(read_result(folder)), indent=1))
        return
    say(run(asked))
    if (folder / "track").is_dir():
        print_next("export", folder, "--to", "usd")
    elif (folder / "depth").is_dir() and read_manifest(folder).input.frame_count > 1:
        print_next("track", folder)
    else:
        print_next("export", folder, "--to", "obj" if (folder / "depth").is_dir() else "png")


@verb(ReportArguments, show=_shown)
def write_report(asked: ReportArguments) -> Path:
    """Write one self-contained HTML page on a reconstruction: pictures, calibration, statistics, warnings."""
    require_output(asked.out, PAGE)
    return pages.write_report(Path(asked.folder), asked.out, asked.part(ReportOptions))

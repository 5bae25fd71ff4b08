"""`vntoolkit report`: write an HTML page on the quality of a reconstruction."""

from json import dumps
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vntoolkit.cli.flags import Flags, verb
from vntoolkit.cli.output import PAGE, print_next, require_output
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.options.pages import ReportOptions
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.report.report import content_of_report, write_report


@verb("max_megapixels", "max_vertices")
def report(
    folder: Path,
    *,
    out: Path | None = None,
    json: Annotated[bool, Parameter(negative=())] = False,
    options: Annotated[ReportOptions | None, Flags()] = None,
) -> None:
    """Write one self-contained HTML page on a reconstruction: warnings, pictures, calibration, statistics.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote.
    out
        The page to write; default FOLDER/report.html.
    json
        Print findings, frames and options as JSON instead.
    """
    require_output(out, PAGE)
    if json:
        print(dumps(content_of_report(open_result(folder)), indent=1))
        return
    print(write_report(folder, out, options))
    if (folder / "track").is_dir():
        print_next("export", folder, "--to", "usd")
    elif (folder / "depth").is_dir() and read_manifest(folder).input.frame_count > 1:
        print_next("track", folder)
    else:
        print_next("export", folder, "--to", "obj" if (folder / "depth").is_dir() else "png")

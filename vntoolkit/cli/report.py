"""`vntoolkit report`: write an HTML page on the quality of a reconstruction."""

from pathlib import Path
from typing import Annotated

from vntoolkit.cli.flags import Flags, verb
from vntoolkit.cli.output import PAGE, print_next, require_output
from vntoolkit.io.results.manifest import read_manifest
from vntoolkit.options.pages import ReportOptions
from vntoolkit.report.report import write_report


@verb("max_megapixels", "max_vertices")
def report(
    folder: Path, *, out: Path | None = None, options: Annotated[ReportOptions | None, Flags()] = None
) -> None:
    """Write one self-contained HTML page on a reconstruction: pictures, calibration, statistics, warnings.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote.
    out
        The page to write; default FOLDER/report.html.
    """
    require_output(out, PAGE)
    print(write_report(folder, out, options))
    if (folder / "track").is_dir():
        print_next("export", folder, "--to", "usd")
    elif (folder / "depth").is_dir() and read_manifest(folder).input.frame_count > 1:
        print_next("track", folder)
    else:
        print_next("export", folder, "--to", "obj" if (folder / "depth").is_dir() else "png")

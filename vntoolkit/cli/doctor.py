"""`vntoolkit doctor`: are the libraries there, and what in this footage will ruin normals?"""

from __future__ import annotations

import platform
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vntoolkit import __version__
from vntoolkit.cli.flags import limits_on
from vntoolkit.native import OPEN3D_LIBRARIES, PYMESHLAB_LIBRARIES, missing_packages

if TYPE_CHECKING:
    from vntoolkit.diagnosis.inspection import CaptureReport

# distribution -> what it does here
_LIBRARIES = {
    "numpy": "arrays",
    "scipy": "solvers, cosine transforms",
    "numba": "compiled kernels",
    "av": "video in and out",
    "opencv-contrib-python-headless": "images, boards, flow",
    "OpenEXR": "normal and depth maps",
    "open3d": "meshes, ray casting",
    "pymeshlab": "mesh cleaning and distance",
    "pycolmap": "camera poses of a head",
    "usd-core": "animated meshes",
    "viser": "the viewer",
    "matplotlib": "figures",
}
_COLOURS = {"note": "cyan", "warning": "yellow", "fatal": "red"}


@limits_on("max_megapixels")
def doctor(
    source: str | None = None,
    /,
    *,
    rig: Path | None = None,
    mask: Path | None = None,
    transfer: str | None = None,
) -> int:
    """Check the installation, or look over footage for what ruins normals.

    Parameters
    ----------
    source
        Video, image, folder of images, or pattern. Without it the libraries are checked.
    rig
        Check the size, the channel order and the transfer curve against this rig.json.
    mask
        Where the surface is; used with the rig.
    transfer
        Curve of the footage: linear, srgb, bt709 or gamma:G. Default: the rig's, else linear.
    """
    if source is None:
        return _check_libraries(Console())
    from vntoolkit.diagnosis.inspection import Severity, inspect_capture
    from vntoolkit.io.footage.captures import CaptureOptions
    from vntoolkit.io.maps_and_meshes.label_images import read_mask
    from vntoolkit.io.rigs import read_rig
    from vntoolkit.photometry.transfer import Transfer

    the_rig = None if rig is None else read_rig(rig)
    options = CaptureOptions() if the_rig is None else CaptureOptions(transfer=the_rig.transfer)
    if transfer is not None:
        options = replace(options, transfer=Transfer.from_text(transfer))
    the_mask = None if mask is None else read_mask(mask)
    report = inspect_capture(source, options, rig=the_rig, mask=the_mask)
    _print_report(Console(emoji=False), source, report)
    return int(any(finding.severity is Severity.FATAL for finding in report.findings))


def _check_libraries(console: Console) -> int:
    table = Table(title=f"vntoolkit {__version__}, Python {platform.python_version()}", title_justify="left")
    for heading in ("library", "version", "for"):
        table.add_column(heading)
    absent = []
    for name, purpose in _LIBRARIES.items():
        try:
            table.add_row(name, version(name), purpose)
        except PackageNotFoundError:
            absent.append(name)
            table.add_row(name, "[red]absent", purpose)
    console.print(table)
    packages = sorted(set(missing_packages({**OPEN3D_LIBRARIES, **PYMESHLAB_LIBRARIES})))
    if absent:
        console.print(f"[red]missing[/] Python libraries: pip install {' '.join(absent)}", soft_wrap=True)
    if packages:
        console.print(
            f"[red]missing[/] system libraries: sudo apt-get install {' '.join(packages)}", soft_wrap=True
        )
    if not absent and not packages:
        console.print("[green]all there[/]: libraries and system libraries")
    return int(bool(absent or packages))


def _print_report(console: Console, source: str, report: CaptureReport) -> None:
    info = report.info
    table = Table(title=escape(source), show_header=False, title_justify="left")
    table.add_column(style="bold")
    table.add_column()
    rate = f", {info.frame_rate_hz:g} per second" if info.kind.value == "video" else ""
    table.add_row("kind", info.kind.value)
    table.add_row("frames", f"{info.frame_count}{rate}")
    table.add_row("size", f"{info.width} × {info.height} pixels")
    bits = "float" if info.bits == 32 else f"{info.bits} bits per channel as read"
    table.add_row("stored as", f"{info.codec}, {info.pixel_format}, chroma {info.chroma}, {bits}")
    table.add_row("looked at", f"frames {', '.join(map(str, report.examined))}")
    table.add_row("clipped", f"{report.clipped_share:.2%} of the pixels")
    table.add_row("dark", f"{report.dark_share:.2%} of the pixels below 1 % of full scale")
    table.add_row("brightest", f"{report.brightest:.0%} of full scale (99th percentile)")
    console.print(table)
    for finding in report.findings:
        colour = _COLOURS[finding.severity.value]
        console.print(
            f"[{colour}]{finding.severity.value:>8}[/]  {escape(finding.text)}",
            highlight=False,
            soft_wrap=True,
        )
    if not report.findings:
        console.print("[green]nothing found[/] that would ruin normals")

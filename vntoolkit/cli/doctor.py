"""`vntoolkit doctor`: check the libraries, or check footage for faults that spoil normals."""

from __future__ import annotations

import os
import platform
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from vntoolkit import __version__, libraries
from vntoolkit.cli.output import print_next, unused
from vntoolkit.cli.verb import verb
from vntoolkit.errors import BadCapture, BadInput, escaped
from vntoolkit.options.base import OptionalFile, as_path, named
from vntoolkit.options.footage import Gaps, MatteOptions, PictureLimits, SensorOptions
from vntoolkit.options.shared import BackgroundOptions
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.shipped import with_guide

if TYPE_CHECKING:
    from vntoolkit.diagnosis.inspection import CaptureReport

# (distribution, module that is imported, what it does here): every dependency of the package
_LIBRARIES = (
    ("numpy", "numpy", "arrays"),
    ("scipy", "scipy.sparse.linalg", "solvers"),
    ("numba", "numba", "compiled kernels"),
    ("av", "av", "video in and out"),
    ("opencv-contrib-python-headless", "cv2", "images, boards, flow"),
    ("tifffile", "tifffile", "deep images"),
    ("rawpy", "rawpy", "camera raw files"),
    ("OpenEXR", "OpenEXR", "normal and depth maps"),
    ("pillow", "PIL.Image", "image headers"),
    ("open3d", "open3d", "meshes, ray casting"),
    ("pymeshlab", "pymeshlab", "mesh cleaning, distance"),
    ("pycolmap", "pycolmap", "camera poses"),
    ("usd-core", "pxr.UsdSkel", "animated meshes"),
    ("matplotlib", "matplotlib.figure", "figures"),
    ("reportlab", "reportlab.pdfgen.canvas", "the board as PDF"),
    ("jinja2", "jinja2", "pages"),
    ("pydantic", "pydantic", "rig.json"),
    ("cyclopts", "cyclopts", "the command line"),
    ("rich", "rich", "tables"),
)
_LONGEST_S = 180.0  # to import one library; from a cold disk Open3D takes twenty seconds
_TRY_VIDEO = f"from {__name__} import try_video; try_video()"
_COLOURS = {"note": "cyan", "warning": "yellow", "fatal": "red"}


@dataclass(frozen=True, kw_only=True)
class DoctorArguments(BackgroundOptions, MatteOptions, SensorOptions, PictureLimits):
    """What `inspect_footage` takes."""

    source: str | os.PathLike[str] | None = field(default=None, kw_only=False)
    """A video, an image, a folder of images, or a pattern. Without it, the libraries are checked."""
    rig: OptionalFile = named(None)
    """Check size, M, channel order, lamps and transfer curve of this rig.json against the footage."""
    mask: OptionalFile = named(None)
    """White where the subject is: an image, or a video, a folder or a pattern with a matte for each frame.
    Used together with --rig."""
    transfer: str | None = None
    """Curve of the footage: linear, srgb, bt709, gamma:G, pq, hlg, slog3, vlog, clog3 or logc3. Default: the
    rig's, else the one that the file states, else linear."""


def _shown(asked: DoctorArguments, run: Callable[[DoctorArguments], CaptureReport]) -> int:
    """Print what was found; 1 where something is broken or fatal."""
    if asked.source is None:
        return _check_libraries(Console())
    from vntoolkit.diagnosis.finding import Level

    report = run(asked)
    _print_report(Console(emoji=False), str(asked.source), report)
    fatal = any(finding.level is Level.FATAL for finding in report.findings)
    rig = Path(asked.rig or "rig.json")
    if not fatal and rig.is_file():
        print_next("reconstruct", str(asked.source), "--rig", rig, "--out", unused("result"))
    elif not fatal:
        print_next("board", "--out", "board.pdf")
    return int(fatal)


@verb(DoctorArguments, show=_shown)
def inspect_footage(asked: DoctorArguments) -> CaptureReport:
    """Check the installation, or check footage for faults that spoil normals."""
    from vntoolkit.diagnosis.inspection import inspect_capture
    from vntoolkit.io.footage.captures import CaptureOptions
    from vntoolkit.io.rigs import read_rig

    if asked.source is None:
        raise BadInput("inspect_footage: expected a video, an image, a folder of images, or a pattern")
    background = as_path(asked.background)
    options = CaptureOptions(
        gaps=Gaps.SKIP,
        transfer=None if asked.transfer is None else Transfer.from_text(asked.transfer),
        sensor=asked.part(SensorOptions),
        background=None if asked.key is not None else background,
    )
    return inspect_capture(
        str(asked.source),
        options,
        rig=None if asked.rig is None else read_rig(asked.rig),
        mask=asked.mask,
        matting=asked.part(MatteOptions),
        plate=background,
    )


@dataclass(frozen=True, kw_only=True)
class _Trial:
    """How a process of its own fared; fault is empty where it did well."""

    fault: str = ""
    missing: dict[str, str] = field(default_factory=dict)  # shared library -> package, or "" if unknown


def _check_libraries(console: Console) -> int:
    """Import each library and read a video back; a library that crashes takes only its own process along."""
    title = f"vntoolkit {__version__}, Python {platform.python_version()}"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for heading in ("library", "works", "version", "for"):
        table.add_column(heading, no_wrap=True)
    programs = [f"import {module}" for _, module, _ in _LIBRARIES]
    programs.append(_TRY_VIDEO)
    with console.status("importing every library"), ThreadPoolExecutor(max_workers=2) as pool:
        trials = list(pool.map(_try, programs))
    lines = []
    missing = libraries.missing_libraries({**libraries.OPEN3D_LIBRARIES, **libraries.PYMESHLAB_LIBRARIES})
    for (name, _, purpose), trial in zip(_LIBRARIES, trials, strict=False):
        shown, its_version = _installed(name)
        table.add_row(shown, "[red]no" if trial.fault else "yes", its_version, purpose)
        missing |= trial.missing
        if its_version == "absent":
            lines.append(f"{shown}: is not installed; pip install {shown}")
        elif trial.fault:
            step = "" if trial.missing else f"; pip install --force-reinstall {shown}"
            lines.append(f"{shown}: {trial.fault}{step}")
    table.add_row("a video", "[red]no" if trials[-1].fault else "yes", "", "written and read back")
    if trials[-1].fault:
        lines.append(f"a video cannot be written and read back: {trials[-1].fault}")
    if missing:
        lines.append(f"this system lacks {', '.join(missing)}: {libraries.remedy(missing)}")
    console.print(table)
    for line in lines:
        console.print(f"[red]broken[/] {escape(line)}", highlight=False, soft_wrap=True)
    if not lines:
        console.print("[green]complete[/]: every library can be imported, and a video opens")
        print_next("demo")
    return int(bool(lines))


def _installed(name: str) -> tuple[str, str]:
    """Return a distribution's name and version."""
    if name == "open3d":
        return libraries.open3d_distribution()
    try:
        return name, version(name)
    except PackageNotFoundError:
        return name, "absent"


def _try(program: str) -> _Trial:
    # -P: files of the folder that one happens to be in are no libraries
    command = [sys.executable, "-P", "-c", program]
    try:
        done = subprocess.run(command, capture_output=True, timeout=_LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return _Trial(fault=f"did not end within {_LONGEST_S:g} s")
    text = (done.stdout + done.stderr).decode(errors="replace").strip()
    missing = libraries.libraries_named_in(text)
    if missing:
        return _Trial(fault=f"needs {', '.join(missing)}", missing=missing)
    if done.returncode < 0:
        return _Trial(fault=f"was ended by {signal.Signals(-done.returncode).name}")
    if done.returncode:
        return _Trial(fault=text.splitlines()[-1] if text else f"exit status {done.returncode}")
    return _Trial()


def try_video() -> None:
    """Write a small lossless video and read it back; raise what goes wrong."""
    import numpy as np

    from vntoolkit.io.footage.video import VideoReader, write_video

    frames = np.random.default_rng(0).integers(0, 256, (3, 24, 32, 3), dtype=np.uint8)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "noise.mkv"
        write_video(path, list(frames), 25)
        found = np.stack([frame.values for frame in VideoReader(path).frames()])
    if not np.array_equal(found, frames):
        raise BadCapture("a lossless video came back with other values than were written")


def _stated_and_done(report: CaptureReport) -> list[tuple[str, str, str]]:
    """Return (fact, what the file states of it, what is done) of a capture."""
    info, curve = report.info, report.transfer.to_text()
    done = "read as linear" if curve == "linear" else f"{curve} is undone"
    if info.stated_transfer not in ("", curve):
        done += ", as --transfer or the rig says"
    rows = [("transfer curve", info.stated_transfer or "nothing", done)]
    if info.taken_yuv:
        rows.append(("YUV matrix", info.stated_yuv, f"converted by {info.taken_yuv}"))
    if info.chroma == "Bayer":
        rows.append(("mosaic", info.pixel_format, "demosaiced, without white balance or camera matrix"))
    turned = ("turned", f"{info.orientation}; the rig's size is the upright picture's")
    rows.append(("camera", *(turned if info.orientation else ("upright, or nothing stated", "nothing"))))
    if info.kind.value == "video":
        rows.append(("lines", "not interlaced", "nothing"))
        uneven = ("uneven", "exports show every frame at its time")
        even = ("not to be used" if info.unusable_times else "even", f"played at {info.frame_rate_hz:g} Hz")
        rows.append(("times", *(uneven if info.times_s else even)))
        declared = f"{info.promised_frame_count}"
        lost = f"{info.frame_count} came; the loss is said, with exit status 1"
        same = info.promised_frame_count == info.frame_count
        rows.append(("frames declared", declared, "all came" if same else lost))
    return rows


def _print_report(console: Console, source: str, report: CaptureReport) -> None:
    info = report.info
    plain: dict[str, Any] = {"title_justify": "left", "box": None, "pad_edge": False}
    table = Table(title=escape(escaped(source)), show_header=False, **plain)
    table.add_column(style="bold")
    table.add_column()
    rate = "" if info.frame_rate_hz is None else f", {info.frame_rate_hz:g} per second"
    table.add_row("kind", info.kind.value)
    missing = f", of which {len(info.missing)} are missing" if info.missing else ""
    table.add_row("frames", f"{info.frame_count}{missing}{rate}")
    table.add_row("size", f"{info.width} × {info.height} pixels")
    bits = "float" if info.bits == 32 else f"{info.bits} bits per channel as read"
    table.add_row("stored as", f"{info.codec}, {info.pixel_format}, chroma {info.chroma}, {bits}")
    table.add_row("examined", f"frames {', '.join(map(str, report.examined))}")
    table.add_row("clipped", f"{report.clipped_share:.2%} of the pixels")
    table.add_row("dark", f"{report.dark_share:.2%} of the pixels below 1 % of full scale")
    table.add_row("brightest", f"{report.brightest:.0%} of full scale (99th percentile)")
    console.print(table)
    stated = Table(title="what the file states, and what is done with it", **plain)
    for heading in ("of", "stated", "done"):
        stated.add_column(heading)
    for row in _stated_and_done(report):
        stated.add_row(*(escape(escaped(fact)) for fact in row))
    console.print(stated)
    for finding in report.findings:
        colour = _COLOURS[finding.level.value]
        console.print(
            f"[{colour}]{finding.level.value:>8}[/]  {escape(with_guide(finding.text))}",
            highlight=False,
            soft_wrap=True,
        )
    if not report.findings:
        console.print("[green]no fault found[/]")

"""`vntoolkit circles`: look at the contact circles of presses, and correct them by hand."""

import contextlib
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar

from vntoolkit.cli.given import curve_from_text, rectification_from_corners
from vntoolkit.cli.output import ProgressBars, print_next
from vntoolkit.cli.verb import command, verb
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import sole_writer
from vntoolkit.options.base import File, Source
from vntoolkit.options.footage import ReadingLimits, SensorOptions
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.options.shared import CornerOptions, CurveOptions
from vntoolkit.pipeline.calibrate_presses import PressJob
from vntoolkit.pipeline.press_circles import PressCircles
from vntoolkit.report.circles_page import CirclesViewer


@dataclass(frozen=True, kw_only=True)
class CirclesArguments(CornerOptions, CurveOptions, SensorOptions, ViewerOptions, ReadingLimits):
    """What `find_circles` takes."""

    WITHOUT: ClassVar[tuple[str, ...]] = ("max_vertices",)

    source: Source = field(kw_only=False)
    """A folder or pattern of images, one for each press."""
    background: File
    """Image of the untouched gel."""
    out: File
    """The folder of labels: NAME.txt for NAME.jpg, u v contact_radius in pixels of the rectified image."""
    pixel_mm: float | None = None
    """Side of a pixel of the rectified picture in millimetres; needed with --corners."""
    page: bool = True
    """Serve the page. With --no-page the circles are found and written only."""


@contextlib.contextmanager
def _found(asked: CirclesArguments) -> Iterator[PressCircles]:
    """Find and write the circles; yield them while nobody else writes there."""
    if asked.corners is not None and asked.pixel_mm is None:
        raise BadInput("circles: --corners and --size-mm need --pixel-mm")
    job = PressJob(
        source=str(asked.source),
        background=Path(asked.background),
        labels=Path(asked.out),
        transfer=curve_from_text(asked.transfer),
        sensor=asked.part(SensorOptions),
        rectification=rectification_from_corners(asked.corners, asked.size_mm, asked.pixel_mm or 1.0),
    )
    with sole_writer(Path(asked.out)):
        with ProgressBars() as bars:
            found = PressCircles(job, partial(bars.reach, "read presses"))
        yield found


@verb(CirclesArguments)
def find_circles(asked: CirclesArguments) -> PressCircles:
    """Find the contact circles of presses, and correct them, and the gel's corners, on a page in the browser.

    The circles are written as labels for `calibrate presses --labels`. Labels that the folder holds are taken
    as they are; a picture without one shows no press. In Python no page is served.
    """
    with _found(asked) as found:
        return found


@command(find_circles)
def circles(asked: CirclesArguments) -> None:
    """Serve the page until Ctrl-C; print what was found."""
    with _found(asked) as found:
        if asked.page:
            shown = CirclesViewer(found, asked.part(ViewerOptions))
            print(f"{shown.address} (Ctrl-C ends)", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                threading.Event().wait()
            shown.close()
    _report(Path(asked.out), found)
    view = found.rectification
    words = ["--background", str(asked.background), "--labels", str(asked.out)]
    if view is not None:
        words += ["--corners", *(f"{at:g}" for at in view.corners_px)]
        words += ["--size-mm", f"{view.width_mm:g}", f"{view.height_mm:g}"]
    scale = "0.03" if asked.pixel_mm is None else f"{asked.pixel_mm:g}"
    ball = ["--ball-radius-mm", "2", "--pixel-mm", scale]
    print_next("calibrate", "presses", str(asked.source), *words, *ball, "--out", "gel.json")


def _report(out: Path, found: PressCircles) -> None:
    by_hand = sum(press.by == "hand" for press in found.presses)
    without = [press.name for press in found.presses if press.circle is None]
    print(f"{out}: {len(found.presses) - len(without)} circles, {by_hand} corrected by hand")
    if without:
        names = ", ".join(without[:5]) + (" …" if len(without) > 5 else "")
        print(f"  without a circle  {len(without)} images: {names}")

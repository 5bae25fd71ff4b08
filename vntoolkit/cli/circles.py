"""`vntoolkit circles`: look at the contact circles of presses, and correct them by hand."""

import contextlib
import threading
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vntoolkit.cli import flags
from vntoolkit.cli.output import ProgressBars, print_next
from vntoolkit.errors import BadInput
from vntoolkit.io.results.folder import write_lock
from vntoolkit.options.footage import SensorOptions
from vntoolkit.options.pages import ViewerOptions
from vntoolkit.pipeline.calibrate_presses import PressJob
from vntoolkit.pipeline.press_circles import PressCircles
from vntoolkit.report.circles_page import CirclesViewer


@flags.verb("max_megapixels")
def circles(
    source: str,
    /,
    *,
    background: Path,
    out: Path,
    corners: flags.Corners = None,
    size_mm: flags.SizeMm = None,
    pixel_mm: float | None = None,
    transfer: flags.Curve = None,
    sensor: flags.Sensor = None,
    page: Annotated[bool, Parameter(negative="--no-page")] = True,
    viewer: Annotated[ViewerOptions | None, flags.Flags()] = None,
) -> None:
    """Find the contact circles of presses, and correct them, and the gel's corners, on a page in the browser.

    The circles are written as labels for `calibrate presses --labels`. Labels that the folder holds are taken
    as they are; a picture without one shows no press.

    Parameters
    ----------
    source
        A folder or pattern of images, one for each press.
    background
        Image of the untouched gel.
    out
        The folder of labels: NAME.txt for NAME.jpg, u v contact_radius in pixels of the rectified image.
    pixel_mm
        Side of a pixel of the rectified picture in millimetres; needed with --corners.
    page
        Serve the page. With --no-page the circles are found and written only.
    """
    if corners is not None and pixel_mm is None:
        raise BadInput("circles: --corners and --size-mm need --pixel-mm")
    job = PressJob(
        source=source,
        background=background,
        labels=out,
        transfer=flags.curve_from_text(transfer),
        sensor=sensor or SensorOptions(),
        rectification=flags.rectification_from_flags(corners, size_mm, pixel_mm or 1.0),
    )
    with write_lock(out):
        with ProgressBars() as bars:
            found = PressCircles(job, partial(bars.reach, "read presses"))
        if page:
            shown = CirclesViewer(found, viewer)
            print(f"{shown.address} (Ctrl-C ends)", flush=True)
            with contextlib.suppress(KeyboardInterrupt):
                threading.Event().wait()
            shown.close()
    _report(out, found)
    view = found.rectification
    words: list[str | Path] = ["--background", background, "--labels", out]
    if view is not None:
        words += ["--corners", *(f"{at:g}" for at in view.corners_px)]
        words += ["--size-mm", f"{view.width_mm:g}", f"{view.height_mm:g}"]
    scale = "0.03" if pixel_mm is None else f"{pixel_mm:g}"
    ball = ["--ball-radius-mm", "2", "--pixel-mm", scale]
    print_next("calibrate", "presses", source, *words, *ball, "--out", "gel.json")


def _report(out: Path, found: PressCircles) -> None:
    by_hand = sum(press.by == "hand" for press in found.presses)
    without = [press.name for press in found.presses if press.circle is None]
    print(f"{out}: {len(found.presses) - len(without)} circles, {by_hand} corrected by hand")
    if without:
        names = ", ".join(without[:5]) + (" …" if len(without) > 5 else "")
        print(f"  without a circle  {len(without)} images: {names}")

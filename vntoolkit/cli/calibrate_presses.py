"""`vntoolkit calibrate presses` and `vntoolkit rectify`: tactile sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from cyclopts import Parameter

from vntoolkit.calibration.presses import PressOptions
from vntoolkit.calibration.varying import VariationOptions
from vntoolkit.cli.calibrate import report_rig
from vntoolkit.cli.flags import flags_from
from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import JSON, require_output
from vntoolkit.cli.progress import ProgressBars
from vntoolkit.cli.shared_flags import Curve, Overwrite
from vntoolkit.errors import BadInput
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.io.captures import CaptureOptions, open_capture
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.pipeline import calibrate_presses as pipeline

if TYPE_CHECKING:
    PressFlags: TypeAlias = PressOptions
    VariationFlags: TypeAlias = VariationOptions | None
else:
    PressFlags = flags_from(PressOptions)
    VariationFlags = flags_from(VariationOptions)

_List = Parameter(consume_multiple=True, negative=())
Corners: TypeAlias = Annotated[tuple[float, float, float, float, float, float, float, float] | None, _List]
SizeMm: TypeAlias = Annotated[tuple[float, float] | None, _List]
SizePx: TypeAlias = Annotated[tuple[int, int] | None, _List]


@limits_on("max_megapixels")
def presses(
    source: str,
    /,
    *,
    out: Path,
    background: Path,
    labels: Path,
    options: PressFlags,
    corners: Corners = None,
    size_mm: SizeMm = None,
    label_size: SizePx = None,
    transfer: Curve = "linear",
    variation: VariationFlags = None,
) -> None:
    """Calibrate a tactile sensor on a ball of known size, pressed into its gel again and again.

    Reconstruct with the same background: --background subtracts it.

    Parameters
    ----------
    source
        A folder or pattern of images, one press each.
    out
        The rig.json to write.
    background
        Image of the untouched gel.
    labels
        Folder of text files, NAME.txt for NAME.jpg: u v contact_radius in pixels of the rectified image.
    corners
        u v of the gel's top left, top right, bottom left and bottom right corner in the image, to rectify it.
    size_mm
        Width and height of the rectangle between these corners in millimetres.
    label_size
        Width and height of the image that the labels refer to; default: the rectified one.
    """
    require_output(out, JSON)
    press_options = replace(options, variation=variation or VariationOptions())
    job = pipeline.PressJob(
        source=source,
        background=background,
        labels=labels,
        transfer=Transfer.from_text(transfer),
        rectification=rectification_from_flags(corners, size_mm, options.pixel_mm),
        label_size=label_size,
    )
    with ProgressBars() as bars:
        rig, _ = pipeline.calibrate_presses(job, press_options, partial(bars.reach, "read presses"))
    write_rig(out, rig)
    report_rig(out, rig, f"presses of {source}")


@limits_on("max_megapixels")
def rectify(
    source: str,
    /,
    *,
    out: Path,
    corners: Corners,
    size_mm: SizeMm,
    pixel_mm: float,
    transfer: Curve = "linear",
    overwrite: Overwrite = False,
) -> None:
    """Resample footage of a plane seen at an angle onto square pixels of known size.

    Parameters
    ----------
    source
        A video, an image, a folder of images, or a pattern.
    out
        The folder to write, 16-bit PNG in the same transfer curve.
    corners
        u v of the rectangle's top left, top right, bottom left and bottom right corner in the image.
    size_mm
        Width and height of the rectangle in millimetres.
    pixel_mm
        Side of a pixel of the result in millimetres.
    overwrite
        Replace the images that the folder holds.
    """
    rectification = rectification_from_flags(corners, size_mm, pixel_mm)
    assert rectification is not None  # both flags are required
    capture = open_capture(source, CaptureOptions(transfer=Transfer.from_text(transfer)))
    with ProgressBars() as bars:
        count = pipeline.rectify_capture(
            capture, rectification, out, partial(bars.reach, "rectify"), overwrite=overwrite
        )
    width, height = rectification.size
    print(f"{out}: {count} images of {width}×{height}, {pixel_mm:g} mm a pixel")


def rectification_from_flags(
    corners: tuple[float, ...] | None, size_mm: tuple[float, float] | None, pixel_mm: float
) -> Rectification | None:
    """The rectification that --corners, --size-mm and --pixel-mm ask for, or None without them."""
    if corners is None and size_mm is None:
        return None
    if corners is None or size_mm is None:
        raise BadInput("rectification: --corners and --size-mm belong together")
    return Rectification(
        corners_px=tuple(corners), width_mm=size_mm[0], height_mm=size_mm[1], pixel_mm=pixel_mm
    )

"""What numbers that a verb is given stand for: the corners of a gel."""

import dataclasses

from vntoolkit.errors import BadInput
from vntoolkit.geometry.rectification import Rectification
from vntoolkit.options.shared import CornerOptions
from vntoolkit.photometry.rig import Rig


def rig_with_corners(rig: Rig, asked: CornerOptions, filmed_px: tuple[int, int]) -> Rig:
    """Return a gel's rig with the corners of --corners in footage of this size, in place of its own."""
    if asked.corners is None and asked.size_mm is None:
        return rig
    if rig.gel is None:
        raise BadInput("--corners: expected the rig of a tactile gel, of `vntoolkit calibrate presses`")
    own, pixel_mm = rig.gel.rectification, 1000.0 / float(rig.camera.matrix[0, 0])
    if asked.size_mm is None and own is not None:
        asked = CornerOptions(corners=asked.corners, size_mm=(own.width_mm, own.height_mm))
    view = rectification_from_corners(asked, pixel_mm)
    assert view is not None
    if view.size != (rig.camera.width, rig.camera.height):
        wanted = f"{rig.camera.width * pixel_mm:g} {rig.camera.height * pixel_mm:g}"
        raise BadInput(f"--size-mm: expected {wanted}, the part of the gel that the rig was calibrated on")
    return dataclasses.replace(rig, gel=dataclasses.replace(rig.gel, rectification=view, filmed_px=filmed_px))


def rectification_from_corners(asked: CornerOptions, pixel_mm: float | None) -> Rectification | None:
    """Return the rectification of --corners, --size-mm and --pixel-mm, or None without them.

    Without --pixel-mm a pixel is as large as in the picture as filmed, in the mean.
    """
    corners, size_mm = asked.corners, asked.size_mm
    if corners is None and size_mm is None:
        return None
    if corners is None or size_mm is None:
        raise BadInput("rectification: expected both --corners and --size-mm, got one of them")
    if pixel_mm is None:
        return Rectification.as_filmed(corners, *size_mm)
    return Rectification(corners_px=corners, width_mm=size_mm[0], height_mm=size_mm[1], pixel_mm=pixel_mm)

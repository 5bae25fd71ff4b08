"""The motion of a gel's material in every frame of a reconstruction, as maps and as a table."""

from pathlib import Path

import numpy as np

from vntoolkit.arrays import ByteArray, Float32Array
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_text
from vntoolkit.io.maps_and_meshes.exr import ExrCompression, read_exr, write_exr
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.tactile.motion import Membrane, MembraneMotion
from vntoolkit.tactile.motion_maps import GelMotion, motion_over_picture

_MM = 1000.0  # per metre
_COLUMNS = "frame,shear_x_mm,shear_y_mm,twist_deg,seen_share"
_MOVED = ("dx_mm", "dy_mm")


def write_gel_motion(source: OpenedResult, membrane: Membrane, target: Path) -> None:
    """Write motion/000000.exr of every frame, and motion.csv, a line a frame, into `target`.

    An EXR has the channels dx_mm, dy_mm (x right, y down), divergence, curl_deg and error_mm, half, as of
    `GelMotion`. Shear and twist are empty where nothing that is seen touches.
    """
    pixel_mm = _MM / float(source.camera.matrix[0, 0])
    moved: MembraneMotion | None = None
    rows = [_COLUMNS]
    for number in source.frames_to_track:
        if not source.folder.has(number, "depth", "contact"):
            continue
        moved = membrane.follow(paint_of_gel(source, membrane, number), moved)
        contact = read_mask(source.folder.file("contact", number))
        motion = motion_over_picture(membrane, moved, contact, pixel_mm)
        channels = dict(zip(_MOVED, np.moveaxis(motion.displacement_mm, -1, 0), strict=True)) | {
            "divergence": motion.divergence,
            "curl_deg": motion.curl_deg,
            "error_mm": motion.error_mm,
        }
        halves = {name: values.astype(np.float16) for name, values in channels.items()}
        write_exr(motion_file(target, number), halves, compression=ExrCompression.ZIP)
        rows.append(_row(number, motion))
    write_text(target / "motion.csv", "\n".join(rows) + "\n")


def paint_of_gel(source: OpenedResult, membrane: Membrane, number: int) -> ByteArray:
    """The membrane's picture of a frame, from the footage."""
    return membrane.picture(source.linear(number).rgb + membrane.untouched)


def motion_file(target: Path, number: int) -> Path:
    """The map of a frame in a folder that `track` wrote."""
    return target / "motion" / f"{number:06d}.exr"


def read_displacement_mm(target: Path, number: int) -> Float32Array | None:
    """Read the motion (h, w, 2) of a frame's material, NaN where lost; None where `track` wrote none."""
    path = motion_file(target, number)
    if not path.exists():
        return None
    channels, _ = read_exr(path)
    if missing := {*_MOVED, "error_mm"} - set(channels):
        raise BadInput(f"{path}: expected the channels dx_mm, dy_mm and error_mm, {min(missing)} is missing")
    moved = np.stack([channels[name] for name in _MOVED], axis=-1).astype(np.float32)
    moved[~np.isfinite(channels["error_mm"])] = np.nan
    return moved


def _row(number: int, motion: GelMotion) -> str:
    told = (*(motion.shear_mm or (None, None)), motion.twist_deg)
    numbers = ["" if value is None else f"{value:.4f}" for value in told]
    return ",".join([str(number), *numbers, f"{motion.seen.mean():.3f}"])

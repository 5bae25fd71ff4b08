"""What a file states about its pictures, in one object, and the one place that refuses what is not read."""

import shlex
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array
from vntoolkit.errors import BadCapture
from vntoolkit.io.footage.orientation import Orientation

# H.273's transfer characteristics, of video and of PNG; BT.601, xvYCC and BT.2020 share BT.709's curve.
TRANSFER_NAMES = {
    1: "bt709", 4: "gamma:2.2", 5: "gamma:2.8", 6: "bt709", 7: "smpte240m", 8: "linear", 9: "log 100:1",
    10: "log 316:1", 11: "bt709", 12: "bt1361", 13: "srgb", 14: "bt709", 15: "bt709", 16: "pq",
    17: "smpte428", 18: "hlg",
}  # fmt: skip
IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg", ".bmp", ".exr", ".webp")
# Camera raw files that LibRaw reads.
RAW_SUFFIXES = (
    ".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".raf", ".orf", ".rw2", ".pef", ".srw",
    ".3fr", ".fff", ".iiq", ".kdc", ".dcr", ".erf", ".mef", ".mos", ".mrw", ".rwl", ".x3f",
)  # fmt: skip
_SQUARE = 0.01  # stretched by less, a normal turns by less than 0.3 degrees; tags round by less
# x and y of red, green, blue and white: BT.709 and sRGB
BT709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


@dataclass(frozen=True, kw_only=True)
class Stated:
    """What a file states beside size and samples; what it does not state is what is expected.

    transfer: curve, as `Transfer` reads it, or another name, which is not read; empty for none. orientation:
    what turns the picture upright. pixel_aspect: width of a pixel over its height. pictures: pages, parts,
    views or frames that the file holds. colours: how they are stored; empty for RGB or grey.
    chromaticities: x and y of red, green, blue and white. focal_px: focal length, as `CaptureInfo` has it.
    """

    transfer: str = ""
    orientation: Orientation = Orientation.UPRIGHT
    pixel_aspect: float = 1.0
    pictures: int = 1
    colours: str = ""
    chromaticities: tuple[float, ...] = BT709
    focal_px: float | None = None


def require_heeded(stated: Stated, name: str, what: str = "pictures") -> None:
    """Raise `BadCapture`, in one line with its name and a remedy, for what no reader undoes.

    what: that `stated.pictures` counts.
    """
    if stated.pictures != 1:
        raise BadCapture(
            f"{name}: holds {stated.pictures} {what}, expected one picture a file; save each as one of its "
            "own, and give the one that is meant, or their folder"
        )
    if stated.colours:
        raise BadCapture(
            f"{name}: is stored as {stated.colours}, expected RGB, grey with black as zero, or YUV of "
            "BT.601, BT.709 or BT.2020; save it so"
        )
    if not abs(stated.pixel_aspect - 1) < _SQUARE:
        path = Path(name)
        square, is_image = path.with_name(path.stem + "_square"), path.suffix.lower() in IMAGE_SUFFIXES
        to = f"{square.name}{path.suffix}" if is_image else f"-c:v ffv1 {square.name}.mkv"
        raise BadCapture(
            f"{name}: states pixels {stated.pixel_aspect:.4g} times as wide as high, expected square ones; "
            f"stretch it first: ffmpeg -i {shlex.quote(path.name)} -vf scale=iw*sar:ih,setsar=1 {to}"
        )


def require_as_first(frame_has: str, own: object, first: object, what: str) -> None:
    """Raise `BadCapture` where a frame has another size or transfer curve than the first one of its capture.

    frame_has: the message up to what it has.
    """
    if own != first:
        raise BadCapture(f"{frame_has} {own}, the first one {first}: a capture has one {what}")


def aspect_of_density(across: float, down: float) -> float:
    """Return a pixel's width over its height from pixels in a length; 1 where these are not said."""
    return float(down / across) if across > 0 and down > 0 else 1.0


def full_scale(samples: Array) -> float:
    """Return the value of full scale of integer or float samples."""
    return 1.0 if samples.dtype == np.float32 else float(np.iinfo(samples.dtype).max)


def require_opaque(alpha: Array, name: str) -> None:
    """Raise `BadCapture` where an alpha channel lets the ground through: the colour there is undefined."""
    see_through = int(np.count_nonzero(alpha < full_scale(alpha)))
    if see_through:
        bits = "floating-point" if alpha.dtype == np.float32 else f"{alpha.dtype.itemsize * 8}-bit"
        raise BadCapture(
            f"{name}: the {bits} alpha channel is not opaque at {see_through} pixels, and colour under it is "
            "undefined; save without alpha and give the outline as --mask"
        )

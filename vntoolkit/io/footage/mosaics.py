"""Frames as the sensor recorded them: camera raw files, and Bayer mosaics that are stored as grey."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from vntoolkit.arrays import Array, ByteArray, Int64Array, UInt16Array
from vntoolkit.errors import BadCapture, BadInput
from vntoolkit.io.files import opened, require_pixels
from vntoolkit.io.footage.stated import RAW_SUFFIXES
from vntoolkit.options.footage import Bayer, Demosaic

_FULL = 65535
_CFA_PATTERN, _BLACK_REPEAT, _BLACK_LEVEL, _ACTIVE_AREA = 33422, 50713, 50714, 50829  # tags of DNG
_TURNS = {3: "turned by 180°", 5: "turned by 270°", 6: "turned by 90°"}  # LibRaw's flip


# OpenCV names a pattern by the pixels from the second row and column on.
_OPENCV_NAMES = {Bayer.RGGB: "BG", Bayer.BGGR: "RG", Bayer.GRBG: "GB", Bayer.GBRG: "GR"}


@dataclass(frozen=True, kw_only=True)
class RawHeader:
    """Kind of raw file, size of the picture as read, the sensor's saturation, and what turns it upright."""

    kind: str
    width: int
    height: int
    saturation: int
    orientation: str


def is_raw(path: Path | str) -> bool:
    """Tell whether a file's name is that of a camera raw file."""
    return Path(path).suffix.lower() in RAW_SUFFIXES


def read_raw(
    path: Path | str,
    demosaic: Demosaic = Demosaic.BILINEAR,
    *,
    max_megapixels: float | None = None,
    error: type[BadInput] = BadCapture,
) -> tuple[UInt16Array, RawHeader]:
    """Read a camera raw file as linear, upright (h, w, 3) RGB of the sensor, 65535 = its saturation.

    Black level and saturation are the file's; there is no white balance, no camera matrix and no curve.
    Raises `error` with one line.
    """
    rawpy = _rawpy(error)
    algorithms = rawpy.DemosaicAlgorithm
    with opened(path, error) as stream:
        try:
            with rawpy.RawPy() as raw:
                raw.open_buffer(stream)
                sizes = raw.sizes
                require_pixels(sizes.width, sizes.height, max_megapixels, str(path), error)
                raw.unpack()
                saturation = int(raw.white_level or 0)
                black = _black_levels(stream, raw.black_level_per_channel)
                _fill_plateau(raw.raw_image, raw.raw_colors, saturation)
                picture = raw.postprocess(
                    demosaic_algorithm=algorithms.AHD if demosaic is Demosaic.EDGE else algorithms.LINEAR,
                    half_size=demosaic is Demosaic.HALF,
                    gamma=(1, 1),
                    no_auto_bright=True,
                    adjust_maximum_thr=0.0,  # else full scale would follow the picture
                    user_black=0,
                    user_cblack=black.tolist(),
                    # LibRaw scales all channels from the lowest black level to the saturation
                    user_wb=list((saturation - black.min()) / np.maximum(saturation - black, 1)),
                    output_color=rawpy.ColorSpace.raw,
                    output_bps=16,
                )
        except (rawpy.LibRawError, ValueError, OSError) as problem:
            reason = " ".join(str(problem).replace("b'", "").strip("'").split()).lower()
            raise error(
                f"{path}: cannot be read as a camera raw file ({reason}); it is damaged or unknown"
            ) from problem
    if picture.ndim != 3 or picture.shape[2] != 3:
        raise error(f"{path}: holds {picture.shape[-1]} colours a pixel, expected red, green and blue")
    header = RawHeader(
        kind=Path(path).suffix[1:].upper(),
        width=picture.shape[1],
        height=picture.shape[0],
        saturation=saturation,
        orientation=_TURNS.get(sizes.flip, ""),
    )
    return np.ascontiguousarray(picture), header


def _black_levels(stream: BinaryIO, found: Sequence[int]) -> Int64Array:
    """Return (4,) the black of red, green of red's rows, blue, and green of blue's rows.

    found: by LibRaw. Where a DNG's picture begins at an odd row or column, LibRaw goes on to an even one, and
    gives the levels of one colour to another: they are read here.
    """
    levels = np.array(found, np.int64)
    if len(set(found)) == 1:
        return levels
    import tifffile

    stream.seek(0)
    with contextlib.suppress(tifffile.TiffFileError, ValueError, KeyError), tifffile.TiffFile(stream) as tiff:
        for page in (
            each for first in tiff.pages for each in (first, *(getattr(first, "pages", None) or ()))
        ):
            area = page.tags.valueof(_ACTIVE_AREA, (0, 0))
            if _BLACK_LEVEL in page.tags and (area[0] % 2 or area[1] % 2):
                rows, columns = page.tags.valueof(_BLACK_REPEAT, (1, 1))
                stated = np.resize(page.tags.valueof(_BLACK_LEVEL), (rows, columns))
                cell = np.tile(stated, (2 // rows, 2 // columns)).ravel()
                colours = np.frombuffer(page.tags.valueof(_CFA_PATTERN), np.uint8).reshape(2, 2)
                row_of_red = int((colours == 0).any(axis=1).argmax())
                greens = np.array([[1, 1], [3, 3]] if row_of_red == 0 else [[3, 3], [1, 1]])
                levels[np.where(colours == 1, greens, colours).ravel()] = cell
    return levels


def _fill_plateau(samples: UInt16Array | None, colours: ByteArray | None, saturation: int) -> None:
    """Raise the samples at which the sensor stops to the saturation that the file states, where it is higher.

    More samples at the largest value than in the last sixty-fourth below it are a plateau: light thins out.
    It is the sensor's stop, and no even patch of the scene, where others lead up to it or all colours end
    there. A value below LibRaw's three quarters of the saturation (its `adjust_maximum_thr`) is the scene's.
    colours: which one each sample has.
    """
    if samples is None or samples.ndim != 2 or colours is None:  # red, green and blue at each pixel
        return
    samples[samples >= saturation] = _FULL  # LibRaw's product may round full scale down
    top = int(samples.max())
    if not 0.75 * saturation < top < saturation:
        return
    stop = samples == top
    below = (samples >= top - top // 64) & ~stop
    ends_in_all = all(stop[colours == colour].any() for colour in np.unique(colours)) and not stop.all()
    if np.count_nonzero(stop) > np.count_nonzero(below) and (below.any() or ends_in_all):
        samples[stop] = _FULL


def rgb_from_mosaic(
    mosaic: Array, bayer: Bayer, demosaic: Demosaic = Demosaic.BILINEAR, name: str = "mosaic"
) -> Array:
    """Return (h, w, 3) RGB of an (h, w) mosaic, uint8 or uint16; by `HALF` (h // 2, w // 2, 3)."""
    if mosaic.ndim != 2 or mosaic.dtype not in (np.uint8, np.uint16) or min(mosaic.shape) < 2:
        kind = f"{mosaic.shape} {mosaic.dtype}"
        raise BadCapture(f"{name}: expected a Bayer mosaic of 8 or 16 bits, 2×2 pixels or more, got {kind}")
    if demosaic is Demosaic.HALF:
        height, width = mosaic.shape[0] // 2 * 2, mosaic.shape[1] // 2 * 2
        cells = [mosaic[row:height:2, column:width:2] for row in (0, 1) for column in (0, 1)]
        by_colour = {colour: [cells[k] for k in range(4) if bayer.value[k] == colour] for colour in "rgb"}
        first, second = by_colour["g"]
        green = (first.astype(np.uint32) + second + 1) // 2
        planes = (by_colour["r"][0], green.astype(mosaic.dtype), by_colour["b"][0])
        return np.stack(planes, axis=-1)
    import cv2  # here, so that options can be read where OpenCV is broken

    ending = "_EA" if demosaic is Demosaic.EDGE else ""
    code = getattr(cv2, f"COLOR_Bayer{_OPENCV_NAMES[bayer]}2RGB{ending}")
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(mosaic), code))


def _rawpy(error: type[BadInput]) -> Any:
    try:
        import rawpy
    except ImportError as problem:  # of a Mac with an Intel processor, for which there is no wheel
        raise error(
            "camera raw files need the library rawpy: pip install rawpy, or convert them to linear TIFF"
        ) from problem
    return rawpy

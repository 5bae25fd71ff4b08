"""Decoded images; frames as the sensor recorded them: raw files, and Bayer mosaics stored as grey."""

import contextlib
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from vntoolkit.arrays import Array, ByteArray, FloatArray, UInt16Array
from vntoolkit.errors import BadCapture
from vntoolkit.io.files import opened, require_pixels, silenced_native_output
from vntoolkit.io.footage.orientation import Orientation
from vntoolkit.io.footage.stated import RAW_SUFFIXES, Stated
from vntoolkit.libraries import require_installed
from vntoolkit.options.footage import Bayer, Demosaic

_FULL = 65535
_DAMAGES = (ValueError, OSError, TypeError, KeyError, IndexError, AttributeError, OverflowError, struct.error)
# tags of DNG, and values of theirs
_CFA_SIZE, _CFA_LAYOUT, _ACTIVE_AREA = 33421, 50711, 50829
_BLACK_REPEAT, _LEVELS = 50713, (50714, 50716, 50715, 50717)  # black, and what rows and columns add; white
_MOSAIC, _COLOURS = 32803, 34892  # photometric: one colour a pixel, or all
_FRACTIONS, _FLOATING = (5, 10), 3
_EXIF_BY_FLIP = {3: 3, 5: 8, 6: 6}  # LibRaw's names of turns


# OpenCV names a pattern by the pixels from the second row and column on.
_OPENCV_NAMES = {Bayer.RGGB: "BG", Bayer.BGGR: "RG", Bayer.GRBG: "GB", Bayer.GBRG: "GR"}


@dataclass(frozen=True, kw_only=True)
class ImageHeader:
    """How an image file stores its picture.

    format: its name. width, height: as stored, pixels; of a camera raw file as read. channels: alpha
    included. bits: per sample. chroma: subsampling (JPEG, WebP), or `Bayer`. stated: what else it states.
    mosaic_at: byte of a TIFF that states a Bayer mosaic, 0 for none. bayer: its pattern, None for none or one
    that is not stated. planar: the channels of a TIFF are stored apart. saturation: of a raw file's sensor.
    """

    format: str
    width: int
    height: int
    channels: int
    bits: int
    floating: bool = False
    chroma: str = "4:4:4"
    stated: Stated = field(default_factory=Stated)
    mosaic_at: int = 0
    bayer: Bayer | None = None
    planar: bool = False
    saturation: int | None = None

    @property
    def text(self) -> str:
        """The format in words."""
        if self.saturation is not None:
            return f"{self.format}, saturation {self.saturation}"
        return f"{self.format} {self.bits}-bit{' float' if self.floating else ''}"


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedImage:
    """Encoded values as stored: colours (h, w, 1 or 3), RGB, upright; alpha (h, w), None for none."""

    colours: Array
    alpha: Array | None
    header: ImageHeader

    @property
    def rgb(self) -> Array:
        """The colours as (h, w, 3); grey is repeated."""
        grey = self.colours.shape[2] == 1
        return np.repeat(self.colours, 3, axis=2) if grey else np.ascontiguousarray(self.colours)


def is_raw(path: Path | str) -> bool:
    """Tell whether a file's name is that of a camera raw file."""
    return Path(path).suffix.lower() in RAW_SUFFIXES


def read_raw(
    path: Path | str,
    demosaic: Demosaic = Demosaic.BILINEAR,
    *,
    max_megapixels: float | None = None,
) -> DecodedImage:
    """Read a camera raw file as linear, upright (h, w, 3) RGB of the sensor, 65535 = its saturation.

    Black level and saturation are the file's; there is no white balance, no camera matrix and no curve.
    Raises `BadCapture`.
    """
    # on a Mac with an Intel processor there is none
    require_installed("rawpy", "rawpy", "camera raw files need rawpy, or conversion to linear TIFF")
    import rawpy

    algorithms = rawpy.DemosaicAlgorithm
    with opened(path, BadCapture) as stream:
        try:
            with silenced_native_output(), rawpy.RawPy() as raw:  # LibRaw prints of damage
                raw.open_buffer(stream)
                sizes = raw.sizes
                require_pixels(sizes.width, sizes.height, max_megapixels, str(path))
                raw.unpack()
                saturation = int(raw.white_level or 0)
                black, stated = np.array(raw.black_level_per_channel), _levels_of_dng(stream, path)
                scaled: dict[str, Any] = {}
                if raw.raw_type is rawpy.RawType.Flat:  # else red, green and blue are there at each pixel
                    _fill_plateau(raw.raw_image, raw.raw_colors, saturation)
                if stated is not None:
                    _scale_to_levels(raw.raw_image, stated, saturation)
                    black, scaled = np.zeros(4, np.int64), {"user_sat": _FULL}
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
                    **scaled,
                )
        except (rawpy.LibRawError, *_DAMAGES) as problem:
            reason = " ".join(str(problem).replace("b'", "").strip("'").split()).lower()
            raise BadCapture(
                f"{path}: cannot be read as a camera raw file ({reason}); it is damaged or unknown"
            ) from problem
    if picture.ndim != 3 or picture.shape[2] != 3:
        raise BadCapture(f"{path}: holds {picture.shape[-1]} colours a pixel, expected red, green and blue")
    turn = Orientation.from_exif(_EXIF_BY_FLIP.get(sizes.flip, 1))
    header = ImageHeader(
        format=Path(path).suffix[1:].upper(),
        width=picture.shape[1],
        height=picture.shape[0],
        channels=3,
        bits=16,
        chroma="Bayer",
        stated=Stated(transfer="linear", orientation=turn),
        saturation=saturation,
    )
    return DecodedImage(colours=picture, alpha=None, header=header)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Levels:
    """Levels of a DNG's samples, in the rectangle of the sensor from (top, left) to (bottom, right).

    black: (h, w, c) of c samples a pixel, which repeats from the first pixel on. down, across: what is added
    to it in each row and column. white: (c,) or (1,); None for the saturation that LibRaw finds.
    """

    area: tuple[int, int, int, int] | None
    black: FloatArray
    down: FloatArray
    across: FloatArray
    white: FloatArray | None


def _levels_of_dng(stream: BinaryIO, path: Path | str) -> _Levels | None:
    """Return the levels of a DNG; None where they are all one, and for another kind of raw file.

    LibRaw reads black levels of cells of 2×2 pixels, from an even row and column on, and one white level.
    Raises `BadCapture` for an arrangement of colour filters that it takes for another one.
    """
    import tifffile

    if Path(path).suffix.lower() != ".dng":
        return None
    stream.seek(0)
    with contextlib.suppress(tifffile.TiffFileError), tifffile.TiffFile(stream) as tiff:
        main: list[Any] = list(tiff.pages)
        pages = [each for first in main for each in (first, *(getattr(first, "pages", None) or ()))]
        page = next((each for each in pages if each.photometric in (_MOSAIC, _COLOURS)), None)
        if page is None:
            return None
        tags = page.tags
        height, width = tags.valueof(_CFA_SIZE, (2, 2))
        if (height, width) not in ((2, 2), (6, 6)) or tags.valueof(_CFA_LAYOUT, 1) != 1:
            raise BadCapture(
                f"{path}: its colour filters repeat every {width}×{height} pixels, or their rows are "
                "staggered; expected a Bayer or X-Trans pattern: have the camera save binned or RGB pixels"
            )
        cell = tags.valueof(_BLACK_REPEAT, (1, 1))
        levels, down, across, white = (_values(tags, code) for code in _LEVELS)
        one = not (np.ptp(levels) or np.ptp(white) or down.any() or across.any())
        if one or page.sampleformat == _FLOATING:  # which LibRaw turns into integers of its own scale
            return None
        return _Levels(
            area=tags.valueof(_ACTIVE_AREA),
            black=np.broadcast_to(levels.reshape(*cell, -1), (*cell, page.samplesperpixel)),
            down=down,
            across=across,
            white=white if page.photometric == _COLOURS and white.all() else None,
        )
    return None


def _values(tags: Any, code: int) -> FloatArray:
    """Return the numbers of a tag, which may be fractions; 0 where it is missing."""
    tag = tags.get(code)
    values = np.atleast_1d(np.array(0 if tag is None else tag.value, np.float64))
    return values[::2] / values[1::2] if tag is not None and tag.dtype in _FRACTIONS else values


def _scale_to_levels(samples: UInt16Array, levels: _Levels, saturation: int) -> None:
    """Scale (h, w) or (h, w, c) samples so that 0 is the black level of each, and `_FULL` the white one."""
    height, width = samples.shape[:2]
    top, left, bottom, right = levels.area or (0, 0, height, width)
    bottom, right = min(bottom, height), min(right, width)
    white = saturation if levels.white is None else levels.white
    stack = np.atleast_3d(samples)[..., : levels.black.shape[2]]
    across = np.resize(levels.across, (right - left, 1))
    for row in range(top, bottom):
        cells = levels.black[(row - top) % len(levels.black)]
        black = np.resize(cells, (right - left, cells.shape[1])) + across
        black += levels.down[(row - top) % len(levels.down)]
        light = (stack[row, left:right] - black) / np.maximum(white - black, 1)
        stack[row, left:right] = np.rint(_FULL * light.clip(0, 1))


def _fill_plateau(samples: UInt16Array, colours: ByteArray, saturation: int) -> None:
    """Raise the samples at which the sensor stops to the saturation that the file states, where it is higher.

    More samples at the largest value than in the last sixty-fourth below it are a plateau: light thins out.
    It is the sensor's stop, and no even patch of the scene, where others lead up to it or all colours end
    there. A value below LibRaw's three quarters of the saturation (its `adjust_maximum_thr`) is the scene's.
    colours: which one each sample has.
    """
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

"""The depth of a touch on a tactile gel as a picture: in colours, with their scale in millimetres on it."""

from functools import lru_cache

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from vntoolkit.arrays import ByteArray
from vntoolkit.geometry.maps import DepthMap

_COLOURS = "viridis"  # darker is nearer to rest, in grey print too
_LEAST_MM = 0.1  # at which a scale ends: less is drift
_MM = 1000.0  # per metre
_BAR, _LINE, _LETTERS, _PAPER = (90, 8), 18, 13, 20  # pixels at 320 px, and the grey behind the letters


def scale_end_mm(deepest_mm: float) -> float:
    """Return where a scale that holds a depth ends: 0.1, 0.2, 0.5, 1, 2, 5 … mm."""
    deepest = max(deepest_mm, _LEAST_MM)
    power = 10.0 ** np.floor(np.log10(deepest))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power > deepest * (1 - 1e-9)))


def picture_of_dents(depth_map: DepthMap, end_mm: float, ground: int = 255) -> ByteArray:
    """Return depth below the gel at rest (h, w, 3), from 0 to `end_mm` and beyond; the scale is at its foot.

    depth_map: metres, negative in a dent. ground: grey value where it is invalid.
    """
    share = np.clip(depth_map.depth * np.float32(-_MM / end_mm), 0.0, 1.0)
    picture = _colours().take((255 * share + 0.5).astype(np.uint8), axis=0)
    picture[~depth_map.mask] = ground
    scale = _scale(max(1, round(max(depth_map.shape) / 320)), end_mm)[: len(picture), : picture.shape[1]]
    picture[len(picture) - len(scale) :, : scale.shape[1]] = scale
    return picture


@lru_cache(1)
def _colours() -> ByteArray:
    """(256, 3)."""
    from matplotlib import colormaps

    return np.rint(255 * colormaps[_COLOURS](np.arange(256))[:, :3]).astype(np.uint8)


@lru_cache(4)
def _scale(zoom: int, end_mm: float) -> ByteArray:
    """A bar of the colours between its ends, (h, w, 3)."""
    font, last = ImageFont.load_default(_LETTERS * zoom), f"{end_mm:g} mm"
    width, height, line = _BAR[0] * zoom, _BAR[1] * zoom, _LINE * zoom
    left, gap = round(font.getlength("0")), 4 * zoom
    whole = 4 * gap + left + width + round(font.getlength(last))
    picture = np.full((line, whole, 3), _PAPER, np.uint8)
    bar = left + 2 * gap
    top = (line - height) // 2
    picture[top : top + height, bar : bar + width] = _colours()[np.linspace(0, 255, width).astype(int)]
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for x, text in ((gap, "0"), (bar + width + gap, last)):
        pen.text((x, line / 2), text, fill="white", font=font, anchor="lm")
    return np.array(image)

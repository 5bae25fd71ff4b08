"""What a video stores per pixel, and its way to RGB without losing bits."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.io.deep_yuv import rgb_from_deep_yuv

_UNSPECIFIED = 2  # AVCOL_SPC_UNSPECIFIED
_SWS_ITU709, _SWS_ITU601 = 1, 5
# Codecs whose decoded frame equals what was encoded, whatever their settings.
LOSSLESS_CODECS = frozenset({"ffv1", "huffyuv", "ffvhuff", "utvideo", "rawvideo", "png", "qtrle", "magicyuv"})


@dataclass(frozen=True, kw_only=True)
class PixelFormat:
    """FFmpeg's name, bits per sample, chroma subsampling (`4:4:4` for RGB), and whether it is RGB or grey."""

    name: str
    bits: int
    chroma: str
    is_rgb: bool
    is_grey: bool = False

    @classmethod
    def from_av(cls, video_format: Any) -> PixelFormat:
        """Read it off an `av.VideoFormat`."""
        grey = len(video_format.components) < 3 and not video_format.is_rgb
        chroma = {(16, 16): "4:4:4", (8, 16): "4:2:2", (8, 8): "4:2:0", (4, 16): "4:1:1", (16, 8): "4:4:0"}
        width, height = video_format.chroma_width(16), video_format.chroma_height(16)
        return cls(
            name=str(video_format.name),
            bits=max(int(component.bits) for component in video_format.components),
            chroma="grey" if grey else chroma.get((width, height), f"{width}/16 × {height}/16"),
            is_rgb=bool(video_format.is_rgb),
            is_grey=grey,
        )

    @property
    def decoded_bits(self) -> int:
        """Significant bits of the RGB samples that `rgb_from_video_frame` returns.

        Planar RGB keeps its own depth; what is converted from more than 8 bits of YUV fills 16.
        """
        if self.bits <= 8:
            return 8
        return self.bits if self.is_planar_rgb else 16

    @property
    def is_planar_rgb(self) -> bool:
        """True for the formats whose planes are numpy arrays already, at their own depth."""
        return self.name.startswith("gbrp") and self.name.endswith("le")


def rgb_from_video_frame(frame: Any, pixel_format: PixelFormat, *, hd: bool) -> npt.NDArray[Any]:
    """Return (h, w, 3) RGB, uint8 or uint16, of a decoded frame.

    The YUV matrix and range are those that the stream states; where it states no matrix, BT.709 for a picture
    of 720 lines or more (`hd`) and BT.601 below, as players do. Rounding is accurate and chroma is
    interpolated at full resolution, so that 4:4:4 is exact to one level.
    """
    from av.video.reformatter import Interpolation

    if pixel_format.name in ("rgb24", "rgb48le") or (pixel_format.is_planar_rgb and pixel_format.bits > 8):
        return frame.to_ndarray()
    is_yuv = not pixel_format.is_rgb and not pixel_format.is_grey
    accurate = Interpolation.BICUBIC | Interpolation.ACCURATE_RND
    accurate |= Interpolation.FULL_CHR_H_INT | Interpolation.FULL_CHR_H_INP
    if is_yuv and pixel_format.bits > 8:
        full = frame.reformat(format=f"yuv444p{pixel_format.bits}le", interpolation=accurate, threads=1)
        return rgb_from_deep_yuv(full, frame, pixel_format.bits, hd=hd)
    target = "rgb24" if pixel_format.decoded_bits == 8 else "rgb48le"
    arguments: dict[str, Any] = {"threads": 1}
    if is_yuv:
        arguments["interpolation"] = accurate
        if frame.colorspace == _UNSPECIFIED:
            arguments["src_colorspace"] = _SWS_ITU709 if hd else _SWS_ITU601
    return np.ascontiguousarray(frame.reformat(format=target, **arguments).to_ndarray())

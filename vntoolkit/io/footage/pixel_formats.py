"""Pixel formats of video, and their conversion to RGB at full bit depth."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from vntoolkit.arrays import Array, Matrix3, Vector3
from vntoolkit.io.footage.luma_detail import LumaDetail
from vntoolkit.native import njit
from vntoolkit.options.footage import Bayer

_UNSPECIFIED = 2  # AVCOL_SPC_UNSPECIFIED
_SWS_ITU709, _SWS_ITU601 = 1, 5
# Codecs whose decoded frame equals what was encoded, whatever their settings.
LOSSLESS_CODECS = frozenset({"ffv1", "huffyuv", "ffvhuff", "utvideo", "rawvideo", "png", "qtrle", "magicyuv"})
_LIMITED_RANGE, _FULL_RANGE = 1, 2  # AVCOL_RANGE_MPEG, AVCOL_RANGE_JPEG
# AVCOL_SPC_* to the matrix's name and its luma weights (K_R, K_B).
_MATRICES = {
    1: ("BT.709", 0.2126, 0.0722), 4: ("FCC", 0.30, 0.11), 5: ("BT.601", 0.299, 0.114),
    6: ("BT.601", 0.299, 0.114), 7: ("SMPTE 240M", 0.212, 0.087), 9: ("BT.2020", 0.2627, 0.0593),
    10: ("BT.2020", 0.2627, 0.0593),
}  # fmt: skip
_OTHER_MATRICES = {
    8: "YCgCo", 11: "SMPTE 2085", 12: "chromaticity-derived", 13: "chromaticity-derived", 14: "ICtCp",
    15: "IPT-C2", 16: "YCgCo-Re", 17: "YCgCo-Ro",
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class PixelFormat:
    """FFmpeg's name, bits per sample, chroma subsampling (`4:4:4` for RGB), and whether it is RGB or grey.

    bayer: pattern of a mosaic, whose samples are one a pixel, as grey is. has_alpha: beside the colours.
    """

    name: str
    bits: int
    chroma: str
    is_rgb: bool
    is_grey: bool = False
    bayer: Bayer | None = None
    has_alpha: bool = False

    @classmethod
    def from_av(cls, video_format: Any) -> "PixelFormat":
        """Read it off an `av.VideoFormat`."""
        name = str(video_format.name)
        if name.startswith("bayer_"):
            bits = 16 if name.endswith(("16le", "16be")) else 8
            bayer = Bayer(name[len("bayer_") : len("bayer_") + 4])
            return cls(name=name, bits=bits, chroma="Bayer", is_rgb=False, is_grey=True, bayer=bayer)
        grey = len(video_format.components) < 3 and not video_format.is_rgb
        chroma = {(16, 16): "4:4:4", (8, 16): "4:2:2", (8, 8): "4:2:0", (4, 16): "4:1:1", (16, 8): "4:4:0"}
        width, height = video_format.chroma_width(16), video_format.chroma_height(16)
        return cls(
            name=name,
            bits=max(int(component.bits) for component in video_format.components),
            chroma="grey" if grey else chroma.get((width, height), f"{width}/16 × {height}/16"),
            is_rgb=bool(video_format.is_rgb),
            is_grey=grey,
            has_alpha=any(component.is_alpha for component in video_format.components),
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
    def has_coarse_chroma(self) -> bool:
        """True for planes of YUV, chroma with fewer pixels than luma, that are numpy arrays already."""
        suffix = "" if self.bits == 8 else f"{self.bits}le"
        coarse = self.chroma in ("4:2:0", "4:2:2", "4:4:0", "4:1:1")
        digits = self.chroma.replace(":", "")
        return coarse and self.name in (f"yuv{digits}p{suffix}", f"yuvj{digits}p{suffix}")

    @property
    def is_planar_rgb(self) -> bool:
        """True for the formats whose planes are numpy arrays already, at their own depth."""
        return self.name.startswith("gbrp") and self.name.endswith("le")


def yuv_conversion(context: Any, pixel_format: PixelFormat, *, hd: bool) -> tuple[str, str]:
    """Return matrix and range of an opened stream, as it states them and as they are taken."""
    if pixel_format.is_rgb or pixel_format.is_grey:
        return "", ""
    matrix, stated_range = int(context.colorspace), int(context.color_range)
    is_full = stated_range == _FULL_RANGE or pixel_format.name.startswith("yuvj")
    span = "full" if is_full else "limited"
    name = _MATRICES[matrix][0] if matrix in _MATRICES else ""
    text = ", ".join(filter(None, (name, f"{span} range" if stated_range or is_full else "")))
    taken = name or ("BT.709" if hd else "BT.601")
    return text or "nothing", f"{taken}, {span} range"


def unread_colours(context: Any, pixel_format: PixelFormat) -> str:
    """Return the name of the colours that an opened stream states, where they are not read; else nothing."""
    is_limited = int(context.color_range) == _LIMITED_RANGE
    if pixel_format.is_rgb:
        return "RGB of limited range" if is_limited else ""
    return "" if pixel_format.is_grey else _OTHER_MATRICES.get(int(context.colorspace), "")


def rgb_from_video_frame(
    frame: Any,
    pixel_format: PixelFormat,
    *,
    hd: bool,
    takes_codes: bool = False,
    detail: LumaDetail | None = None,
) -> Array:
    """Return (h, w, 3) RGB, uint8 or uint16, of a decoded frame.

    The YUV matrix and range are those that the stream states; where it states no matrix, BT.709 for a picture
    of 720 lines or more (`hd`) and BT.601 below, as players do. Rounding is accurate and chroma is
    interpolated at full resolution, so that 4:4:4 is exact to one level. takes_codes: full scale of YUV is
    the largest code, whatever the range; the samples are uint16. detail: sharpens chroma that has fewer
    pixels by the luma; the samples are uint16.
    """
    from av.video.reformatter import Interpolation

    bits = pixel_format.bits
    if pixel_format.name in ("rgb24", "rgb48le") or (pixel_format.is_planar_rgb and bits > 8):
        return frame.to_ndarray()
    is_yuv = not pixel_format.is_rgb and not pixel_format.is_grey
    how: dict[str, Any] = {"threads": 1}
    if is_yuv:
        how["interpolation"] = Interpolation.BICUBIC | Interpolation.ACCURATE_RND
        how["interpolation"] |= Interpolation.FULL_CHR_H_INT | Interpolation.FULL_CHR_H_INP
    if is_yuv and (bits > 8 or takes_codes or detail is not None):
        # to half a level; FFmpeg's own conversion, three times as fast, puts the white of 10 bits at 65283
        # instead of 65535, so clipped pixels would pass as sound
        matrix, offset = _rgb_from_stored(frame, bits, hd=hd, takes_codes=takes_codes)
        if detail is not None:
            planes = _planes(frame, bits)
            planes[1:] = detail.chroma(planes, matrix, offset)
        else:
            whole = f"yuv444p{bits}le" if bits > 8 else "yuv444p"
            planes = _planes(frame.reformat(format=whole, **how), bits)
        return _rgb_from_planes(*planes, matrix, offset)
    if is_yuv and frame.colorspace == _UNSPECIFIED:
        how["src_colorspace"] = _SWS_ITU709 if hd else _SWS_ITU601
    target = "rgb24" if pixel_format.decoded_bits == 8 else "rgb48le"
    return np.ascontiguousarray(frame.reformat(format=target, **how).to_ndarray())


def mosaic_from_video_frame(frame: Any, pixel_format: PixelFormat) -> Array:
    """Return the (h, w) samples of a grey frame or a Bayer mosaic, uint8 or uint16, as stored."""
    order = ">" if pixel_format.name.endswith("be") else "<"
    samples = _plane(frame, 0, np.dtype(np.uint8 if pixel_format.bits == 8 else f"{order}u2"))
    return samples.astype(samples.dtype.newbyteorder("="))


def _rgb_from_stored(source: Any, bits: int, *, hd: bool, takes_codes: bool) -> tuple[Matrix3, Vector3]:
    """Return the affine map from a frame's YUV codes to RGB 0 to 1, as the frame states it."""
    colour_space = int(source.colorspace)
    if colour_space not in _MATRICES:
        colour_space = 1 if hd else 5
    full_range = int(source.color_range) == _FULL_RANGE or source.format.name.startswith("yuvj")
    matrix, offset = _rgb_from_yuv(*_MATRICES[colour_space][1:], bits=bits, full_range=full_range)
    if takes_codes and not full_range:  # black is code 16 and white 235 of 8 bits, and alike of more
        top = 2**bits - 1
        matrix, offset = matrix * (219 * 2 ** (bits - 8) / top), (offset * 219 + 16) * (2 ** (bits - 8) / top)
    return matrix, offset


def _rgb_from_yuv(k_red: float, k_blue: float, *, bits: int, full_range: bool) -> tuple[Matrix3, Vector3]:
    """Return the affine map from stored YUV to RGB 0 to 1 (ITU-R BT.709-6, items 3 and 4)."""
    k_green = 1.0 - k_red - k_blue
    yuv_from_rgb = np.array(
        [
            [k_red, k_green, k_blue],
            np.array([-k_red, -k_green, 1 - k_blue]) / (2 * (1 - k_blue)),
            np.array([1 - k_red, -k_green, -k_blue]) / (2 * (1 - k_red)),
        ]
    )
    step = 2 ** (bits - 8)
    luma, chroma, black = (2**bits - 1, 2**bits - 1, 0) if full_range else (219 * step, 224 * step, 16 * step)
    matrix = np.linalg.inv(yuv_from_rgb) / np.array([luma, chroma, chroma])
    return matrix, -matrix @ np.array([black, 128 * step, 128 * step], dtype=np.float64)


def _planes(frame: Any, bits: int) -> list[Array]:
    return [_plane(frame, k, np.dtype(np.uint8 if bits == 8 else np.uint16)) for k in range(3)]


def _plane(frame: Any, index: int, kind: np.dtype[Any]) -> Array:
    plane = frame.planes[index]
    rows = np.frombuffer(plane, kind).reshape(-1, plane.line_size // kind.itemsize)
    return rows[: plane.height, : plane.width]


@njit
def _rgb_from_planes(luma, blue, red, matrix, offset):  # type: ignore[no-untyped-def]  # pragma: no cover
    matrix, offset = matrix * 65535.0, offset * 65535.0
    rgb = np.empty((*luma.shape, 3), dtype=np.uint16)
    for v in range(rgb.shape[0]):
        for u in range(rgb.shape[1]):
            y, cb, cr = float(luma[v, u]), float(blue[v, u]), float(red[v, u])
            for c in range(3):
                value = matrix[c, 0] * y + matrix[c, 1] * cb + matrix[c, 2] * cr + offset[c] + 0.5
                rgb[v, u, c] = np.uint16(min(max(value, 0.0), 65535.0))
    return rgb

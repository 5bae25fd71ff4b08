"""Pictures as PNG, JPEG or WebP by OpenCV, and their shrinking for pages."""

from pathlib import Path

import cv2
import numpy as np

from vntoolkit.arrays import Array, ByteArray
from vntoolkit.errors import BadInput
from vntoolkit.io.atomic import write_bytes


def write_png(path: Path | str, pixels: Array, *, compression_level: int = 1) -> None:
    """Write (h, w), (h, w, 3) RGB or (h, w, 4) RGBA, uint8 or uint16, atomically.

    compression_level: 0 (fast, large) to 9.
    """
    if pixels.dtype not in (np.uint8, np.uint16):
        raise BadInput(f"{path}: a PNG holds 8- or 16-bit integers, got {pixels.dtype}")
    if pixels.ndim not in (2, 3) or pixels.size == 0 or (pixels.ndim == 3 and pixels.shape[2] not in (3, 4)):
        raise BadInput(f"{path}: expected an image of (h, w), (h, w, 3) or (h, w, 4), got {pixels.shape}")
    write_bytes(path, _encoded(pixels, ".png", [cv2.IMWRITE_PNG_COMPRESSION, compression_level], str(path)))


def encoded_image(pixels: ByteArray, suffix: str = ".png", *, quality: int = 88) -> bytes:
    """Return the bytes of an image file, `.png`, `.jpg` or `.webp`, of uint8 pixels.

    pixels: (h, w), (h, w, 3) RGB or (h, w, 4) RGBA. quality: 0 to 100, of a JPEG or WebP.
    """
    flags = {
        ".png": [cv2.IMWRITE_PNG_COMPRESSION, 9],
        ".jpg": [cv2.IMWRITE_JPEG_QUALITY, quality],
        ".webp": [cv2.IMWRITE_WEBP_QUALITY, quality],
    }
    if suffix not in flags or pixels.dtype != np.uint8:
        raise BadInput(
            f"image: expected 8 bits and one of {', '.join(flags)}, got {pixels.dtype}, '{suffix}'"
        )
    return _encoded(pixels, suffix, flags[suffix], "image")


def _encoded(pixels: Array, suffix: str, flags: list[int], name: str) -> bytes:
    """Return the bytes of an image file of grey, RGB or RGBA pixels; raise `BadInput`."""
    try:
        ok, content = cv2.imencode(suffix, in_other_order(pixels), flags)
    except cv2.error:  # of an empty image, or one larger than the format allows
        ok = False
    if not ok:
        raise BadInput(f"{name}: OpenCV cannot encode an image of shape {pixels.shape} as {suffix}")
    return bytes(content.tobytes())


def in_other_order(pixels: Array) -> Array:
    """Return RGB or RGBA as OpenCV's BGR or BGRA, or these as those; fewer channels as they are."""
    if pixels.ndim < 3 or pixels.shape[2] < 3:
        return pixels
    order = cv2.COLOR_RGB2BGR if pixels.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    return np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), order))


def resized_image(pixels: ByteArray, largest_px: int, *, smooth: bool = True) -> ByteArray:
    """Return the picture shrunk so that no side exceeds `largest_px`; labels want smooth=False."""
    factor = largest_px / max(pixels.shape[:2])
    if factor >= 1:
        return pixels
    size = (max(1, round(pixels.shape[1] * factor)), max(1, round(pixels.shape[0] * factor)))
    method = cv2.INTER_AREA if smooth else cv2.INTER_NEAREST
    return np.asarray(cv2.resize(np.ascontiguousarray(pixels), size, interpolation=method), dtype=np.uint8)

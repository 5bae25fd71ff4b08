"""What reading a changed file must give, and whether it does; codes, curves and profiles to change it by."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import ImageCms

from vntoolkit.errors import BadInput
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.maps_and_meshes.masks import read_mask

H, W = 24, 32
Rng = np.random.Generator
SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
# Linear light of codes 0 to 1, by name; the formulas of IEC 61966-2-1 and ITU-R BT.709.
CURVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "linear": lambda x: x,
    "srgb": lambda x: np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4),
    "bt709": lambda x: np.where(x < 0.081, x / 4.5, ((x + 0.099) / 1.099) ** (1 / 0.45)),
    "gamma:1.8": lambda x: x**1.8,
    "gamma:2.2": lambda x: x**2.2,
    "odd": lambda x: x**2 * (3 - 2 * x),
}


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """What reading `path` must give: `rgb`, linear, all over the picture or (h, w, 3); or a refusal.

    refused: a pattern of the line. mask: the footage is a matte, and this the mask. clipped: share of pixels.
    border_px: of the picture, that is not compared.
    """

    path: Path
    rgb: Any = None
    refused: str = ""
    mask: np.ndarray | None = None
    clipped: float | None = None
    tolerance: float = 0.006
    background: Path | None = None
    border_px: int = 0


def fault_of(change: Change) -> str:
    """Return what is wrong with the way a changed file is read; empty for nothing."""
    try:
        if change.mask is not None:
            found: Any = read_mask(change.path)
            return "" if (found == change.mask).all() else f"{found.sum()} pixels of {change.mask.sum()}"
        frames = list(open_capture(change.path, CaptureOptions(background=change.background)).frames())
    except BadInput as problem:
        said = str(problem)
        right = bool(change.refused) and re.search(change.refused, said) is not None and "\n" not in said
        return "" if right else f"refused: {said}, expected {change.refused or change.rgb}"
    if change.refused:
        return f"read as {frames[0].rgb[H // 2, W // 2]}, expected a refusal: {change.refused}"
    rgb, clipped = frames[0].rgb, frames[0].clipped.mean()
    if np.ndim(change.rgb) == 3 and rgb.shape != np.shape(change.rgb):
        return f"read as {rgb.shape}, expected {np.shape(change.rgb)}"
    inside = slice(change.border_px, -change.border_px or None)
    error = np.abs(rgb - np.asarray(change.rgb))[inside, inside].max()
    if not error <= change.tolerance:
        return f"off by {error:.4f}, read as {rgb[H // 2, W // 2]}, expected {np.ravel(change.rgb)[:3]}"
    if change.clipped is not None and abs(clipped - change.clipped) > 0.08:
        return f"{clipped:.2f} of the pixels are clipped, expected {change.clipped:.2f}"
    return ""


def random_code(rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """A picture (h, w, 3) of one random value of 8 bits, and that value, 0 to 1."""
    value = rng.integers(30, 226, 3)
    return np.tile(value, (H, W, 1)).astype(np.uint8), value / 255


def chosen(rng: Rng, names: Any) -> Any:
    return list(names)[int(rng.integers(len(names)))]


def profile_of(rng: Rng, curve: str) -> bytes:
    """The sRGB profile with another curve: as a table, as an exponent or as parameters."""
    tags = {}
    for k in range(struct.unpack(">I", SRGB[128:132])[0]):
        name, at, size = struct.unpack_from(">4sII", SRGB, 132 + 12 * k)
        tags[name] = SRGB[at : at + size]
    codes = np.linspace(0, 1, int(chosen(rng, (256, 1024, 4096))))
    table = np.rint(65535 * CURVES[curve](codes)).astype(">u2")
    ways = [b"curv" + bytes(4) + struct.pack(">I", len(table)) + table.tobytes()]
    fixed = {
        "srgb": (3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045),
        "bt709": (3, 1 / 0.45, 1 / 1.099, 0.099 / 1.099, 1 / 4.5, 0.081),
        "gamma:1.8": (0, 1.8), "gamma:2.2": (0, 2.2),
    }.get(curve)  # fmt: skip
    if fixed is not None:
        kind, *values = fixed
        numbers = struct.pack(f">{len(values)}i", *(round(65536 * value) for value in values))
        ways.append(b"para" + bytes(4) + struct.pack(">HH", kind, 0) + numbers)
    if curve.startswith("gamma"):
        ways.append(b"curv" + bytes(4) + struct.pack(">IH", 1, round(256 * float(curve[6:]))))
    for name in (b"rTRC", b"gTRC", b"bTRC"):
        tags[name] = chosen(rng, ways)
    entries, data, at = b"", b"", 132 + 12 * len(tags)
    for name, content in tags.items():
        entries += struct.pack(">4sII", name, at + len(data), len(content))
        data += content + bytes(-len(content) % 4)
    body = SRGB[:128] + struct.pack(">I", len(tags)) + entries + data
    return struct.pack(">I", len(body)) + body[4:]

"""Sound files whose statements are changed: each is read with the right values, or refused by name.

A change takes a folder and a generator, writes a file or a folder, and returns what reading it must give.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import tifffile
from PIL import Image

from tests.faults.stated_change import CURVES, Change, H, Rng, W, chosen, profile_of, random_code
from tests.faults.stated_images import (
    animation,
    bitmap,
    exif_curve,
    icc,
    jpeg_pair,
    png_chunks,
    rare_tiff,
    still_of_another_kind,
    stored_colours,
    tiff_curve,
    tiff_samples,
    turned,
)
from tests.faults.stated_sensors import dng_cells, dng_colours, dng_filters, dng_levels, dng_white
from tests.faults.stated_videos import (
    film,
    video_alpha,
    video_alpha_apart,
    video_curve,
    video_curves,
    video_edit_list,
    video_packed,
    video_profile,
    video_range,
    video_stereo,
    video_streams,
)

# x and y of red, green, blue and white, and the published matrices to BT.709 (white to white by Bradford).
_PRIMARIES = {
    "BT.709": ((0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290), np.eye(3)),
    "ACES AP0": (
        (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767),
        [[2.52169, -1.13413, -0.38756], [-0.27648, 1.37272, -0.09624], [-0.01538, -0.15298, 1.16835]],
    ),
    "ACEScg": (
        (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767),
        [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]],
    ),
    "BT.2020": (
        (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
        [[1.66049, -0.58764, -0.07285], [-0.12455, 1.13290, -0.00835], [-0.01815, -0.10058, 1.11873]],
    ),
}  # fmt: skip


def _aspect(suffix: str) -> Callable[[Path, Rng], Change]:
    def write(folder: Path, rng: Rng) -> Change:
        (values, code), path = random_code(rng), folder / f"a.{suffix}"
        across, down = (int(n) for n in chosen(rng, ((72, 72), (300, 300), (72, 144), (160, 150), (3, 4))))
        if suffix == "exr":
            header = {"type": OpenEXR.scanlineimage, "pixelAspectRatio": down / across}
            OpenEXR.File(header, {"RGB": (values / 255).astype(np.float32)}).write(str(path))
        elif suffix == "mkv":
            film(path, values, codec="libx264rgb", sample_aspect_ratio=Fraction(down, across))
        elif suffix == "tif":
            tifffile.imwrite(path, values, photometric="rgb", resolution=(across, down))
        elif suffix == "webp" or (suffix == "jpg" and rng.random() < 0.5):  # in EXIF data
            exif, how = Image.Exif(), {"quality": 100} if suffix == "jpg" else {"lossless": True}
            exif[282], exif[283] = float(across), float(down)
            Image.fromarray(values).save(path, exif=exif, **how)
        else:
            Image.fromarray(values).save(
                path, dpi=(across, down), **({"quality": 100} if suffix == "jpg" else {})
            )
        refused = (
            "" if across == down else "times as wide as high, expected square ones; stretch it first: ffmpeg"
        )
        return Change(path=path, rgb=code, refused=refused, tolerance=0.012)

    return write


def _floats(folder: Path, rng: Rng) -> Change:
    """Float pictures of any scale: beyond 1 there is no full scale; a plateau at 1 is one."""
    light = rng.uniform(0.1, 0.9, (H, W, 3)).astype(np.float32)
    way = chosen(rng, ("bright", "dark", "stops at 1"))
    light = {"bright": 4 * light, "dark": light / 100}.get(way, light)
    if way == "stops at 1":
        light[: H // 3] = 1
    if rng.random() < 0.5:
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": light}).write(str(folder / "a.exr"))
        path = folder / "a.exr"
    else:
        path = folder / "a.tif"
        tifffile.imwrite(path, light, photometric="rgb")
    return Change(path=path, rgb=light, clipped=1 / 3 if way == "stops at 1" else 0, tolerance=1e-6)


def _exr_chromaticities(folder: Path, rng: Rng) -> Change:
    name, light = chosen(rng, _PRIMARIES), rng.uniform(0.1, 0.9, 3)
    chromaticities, to_bt709 = _PRIMARIES[name]
    header: dict[str, Any] = {"type": OpenEXR.scanlineimage, "chromaticities": chromaticities}
    OpenEXR.File(header, {"RGB": np.tile(light, (H, W, 1)).astype(np.float32)}).write(str(folder / "a.exr"))
    return Change(path=folder / "a.exr", rgb=np.array(to_bt709) @ light, tolerance=0.002)


def _exr_windows(folder: Path, rng: Rng) -> Change:
    """Any data window against any display window, origins below and above 0, in every compression."""
    left, top, shown_left, shown_top = (int(n) for n in rng.integers(-60, 60, 4))
    shown_left, shown_top = left + shown_left // 4, top + shown_top // 5
    values = rng.random((H, W, 3)).astype(np.float32)
    kinds = ("NO", "ZIP", "ZIPS", "RLE", "PIZ")
    header = {
        "type": OpenEXR.scanlineimage, "compression": getattr(OpenEXR, f"{chosen(rng, kinds)}_COMPRESSION"),
        "dataWindow": ((left, top), (left + W - 1, top + H - 1)),
        "displayWindow": ((shown_left, shown_top), (shown_left + W - 1, shown_top + H - 1)),
    }  # fmt: skip
    OpenEXR.File(header, {"RGB": values}).write(str(folder / "a.exr"))
    v, u = np.mgrid[:H, :W]
    row, column = v + shown_top - top, u + shown_left - left
    stored = (row >= 0) & (row < H) & (column >= 0) & (column < W)
    shown = np.where(stored[..., None], values[row.clip(0, H - 1), column.clip(0, W - 1)], 0)
    return Change(path=folder / "a.exr", rgb=shown, tolerance=1e-6)


def _exr_views(folder: Path, rng: Rng) -> Change:
    part = {"RGB": rng.random((H, W, 3)).astype(np.float32)}
    header: dict[str, Any] = {"type": OpenEXR.scanlineimage}
    if rng.random() < 0.5:
        OpenEXR.File({**header, "multiView": ["left", "right"]}, part).write(str(folder / "a.exr"))
    else:
        parts = [OpenEXR.Part(dict(header), dict(part), name=name) for name in ("left", "right")]
        OpenEXR.File(parts).write(str(folder / "a.exr"))
    return Change(path=folder / "a.exr", refused="holds 2 parts or views, expected one picture")


def _exr_luminance(folder: Path, rng: Rng) -> Change:
    """Luminance at full size and chroma at half: written by hand, uncompressed, half floats."""
    step = {"BY": 2, "RY": 2, "Y": 1}
    planes = {name: rng.random((H // n, W // n)).astype("<f2") for name, n in step.items()}

    def attribute(name: str, kind: str, value: bytes) -> bytes:
        return name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<I", len(value)) + value

    box = struct.pack("<4i", 0, 0, W - 1, H - 1)
    channels = (
        b"".join(n.encode() + b"\0" + struct.pack("<iB3xii", 1, 0, k, k) for n, k in step.items()) + b"\0"
    )
    head = struct.pack("<II", 20000630, 2) + attribute("channels", "chlist", channels)
    head += attribute("compression", "compression", b"\0") + attribute("dataWindow", "box2i", box)
    head += attribute("displayWindow", "box2i", box) + attribute("lineOrder", "lineOrder", b"\0")
    head += attribute("pixelAspectRatio", "float", struct.pack("<f", 1))
    head += attribute("screenWindowCenter", "v2f", bytes(8))
    head += attribute("screenWindowWidth", "float", struct.pack("<f", 1)) + b"\0"
    rows = [
        b"".join(p[v // step[n]].tobytes() for n, p in planes.items() if v % step[n] == 0) for v in range(H)
    ]
    lines = [struct.pack("<iI", v, len(row)) + row for v, row in enumerate(rows)]
    at = np.cumsum([len(head) + 8 * H] + [len(line) for line in lines])[:-1]
    (folder / "a.exr").write_bytes(head + at.astype("<u8").tobytes() + b"".join(lines))
    return Change(path=folder / "a.exr", refused="is stored as luminance and chroma, expected RGB")


def _matte_in_alpha(folder: Path, rng: Rng) -> Change:
    v, u = np.mgrid[:H, :W]
    mask = (u - rng.integers(8, 24)) ** 2 + (v - rng.integers(6, 18)) ** 2 < 30
    alpha = np.where(mask, 255, 0).astype(np.uint8)
    paint = np.full((H, W, 3), chosen(rng, (0, 255, 90)), np.uint8)
    way = int(rng.integers(4))
    stored = {
        0: np.dstack([paint, alpha]), 1: alpha,
        2: np.where(mask, int(rng.integers(1, 255)), 0).astype(np.uint8),
        3: np.dstack([rng.integers(0, 256, (H, W, 3), dtype=np.uint8), alpha]),
    }[way]  # fmt: skip
    Image.fromarray(stored).save(folder / "m.png")
    if way == 3:
        return Change(path=folder / "m.png", mask=mask, refused="its colours and its alpha channel")
    return Change(path=folder / "m.png", mask=mask)


def _folder_of_series(folder: Path, rng: Rng) -> Change:
    """Takes, cameras, other series and a video beside the frames; a stray still is left out."""
    take, (values, code) = folder / "take", random_code(rng)
    take.mkdir()
    count = int(rng.integers(2, 5))
    names, refused = [f"f_{k:03d}" for k in range(count + 2)], ""
    way = int(rng.integers(6))
    if way == 5:  # a clock, or a camera's counter
        clock = [f"12-{s // 60:02d}-{s % 60:02d}" for s in range(57, 57 + 2 * count)]
        counter = ["100_9998", "100_9999", "101_0001", "101_0002"]
        names = chosen(rng, (clock, counter))
    elif way == 0:
        names += [f"g_{k:03d}" for k in range(count)]
    elif way == 1:
        first = chosen(rng, ((0, 0), (7, 3), (3, 40)))  # together, or where each was cut to
        names = [f"take{n}_{k:03d}" for n in (1, 2) for k in range(first[n - 1], first[n - 1] + count + n)]
    elif way == 2:
        names += ["mask"]
    elif way == 3:
        film(take / "other.mkv", values)
    for name in names:
        Image.fromarray(values).save(take / f"{name}.png")
    if way in (0, 1):
        refused = "holds 2 series of images"
    elif way == 3:
        refused = "holds the video other.mkv and images"
    return Change(path=take, rgb=code, refused=refused)


def _curves_that_differ(folder: Path, rng: Rng) -> Change:
    """One frame, or the background, states another curve than the first frame, or one of them states none."""
    (values, code), (first, other) = random_code(rng), rng.choice(["srgb", "gamma:1.8", "bt709", ""], 2)
    (folder / "f").mkdir()

    profiles = {curve: {"icc_profile": profile_of(rng, curve)} if curve else {} for curve in (first, other)}
    for k in range(3):
        Image.fromarray(values).save(folder / f"f/{k}.png", **profiles[first])
    changed = folder / ("f/1.png" if rng.random() < 0.5 else "b.png")
    dark = values if changed.parent.name == "f" else np.zeros_like(values)
    Image.fromarray(dark).save(changed, **profiles[other])
    background = changed if changed.name == "b.png" else None
    silent = background is not None and not (first and other)  # a black plate is black by any curve
    refused = "" if first == other or silent else "states the transfer curve"
    light = CURVES[first or "linear"](code)
    return Change(path=folder / "f", rgb=light, refused=refused, background=background)


CHANGES: dict[str, Callable[[Path, Rng], Change]] = {
    **{f"ICC profile, {suffix}": icc(suffix) for suffix in ("png", "jpg", "tif", "webp")},
    **{f"pixel aspect, {suffix}": _aspect(suffix) for suffix in ("png", "jpg", "tif", "bmp", "exr", "mkv")},
    "pixel aspect, webp": _aspect("webp"),
    **{f"animation, {suffix}": animation(suffix) for suffix in ("png", "webp")},
    **{f"EXIF curve, {suffix}": exif_curve(suffix) for suffix in ("png", "jpg", "tif", "webp")},
    "PNG chunks": png_chunks, "turned pictures": turned, "BMP header": bitmap,
    "TIFF curve": tiff_curve, "TIFF samples": tiff_samples, "two views in a JPEG": jpeg_pair,
    "stills of other kinds": still_of_another_kind,
    "video alpha": video_alpha, "video alpha apart": video_alpha_apart, "video stereo": video_stereo,
    "video packed": video_packed, "video streams": video_streams, "video profile": video_profile,
    "video edit list": video_edit_list, "video curves": video_curves, "floats": _floats,
    "video curve": video_curve, "video range": video_range, "EXR chromaticities": _exr_chromaticities,
    "EXR windows": _exr_windows, "EXR views and parts": _exr_views, "EXR luminance": _exr_luminance,
    "rare TIFF": rare_tiff,
    "stored colours": stored_colours, "DNG black and margins": dng_levels,
    "DNG cells": dng_cells, "DNG filters": dng_filters, "DNG colours": dng_colours,
    "DNG white": dng_white, "matte in alpha": _matte_in_alpha, "series in a folder": _folder_of_series,
    "curves that differ": _curves_that_differ,
}  # fmt: skip

"""Sound files whose statements are changed: each is read with the right values, or refused by name.

A change takes a folder and a generator, writes a file or a folder, and returns what reading it must give.
"""

from __future__ import annotations

import io
import re
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import OpenEXR
import tifffile
from PIL import Image, ImageCms

from vntoolkit.errors import BadInput
from vntoolkit.io.footage.captures import CaptureOptions, open_capture
from vntoolkit.io.maps_and_meshes.masks import read_mask

H, W = 24, 32
Rng = np.random.Generator
_SRGB = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
# Linear light of codes 0 to 1, by name; the formulas of IEC 61966-2-1 and ITU-R BT.709.
_CURVES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "linear": lambda x: x,
    "srgb": lambda x: np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4),
    "bt709": lambda x: np.where(x < 0.081, x / 4.5, ((x + 0.099) / 1.099) ** (1 / 0.45)),
    "gamma:1.8": lambda x: x**1.8,
    "gamma:2.2": lambda x: x**2.2,
    "odd": lambda x: x**2 * (3 - 2 * x),
}
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Change:
    """What reading `path` must give: `rgb`, linear, all over the picture or (h, w, 3); or a refusal.

    refused: a pattern of the line. mask: the footage is a matte, and this the mask. clipped: share of pixels.
    """

    path: Path
    rgb: Any = None
    refused: str = ""
    mask: np.ndarray | None = None
    clipped: float | None = None
    tolerance: float = 0.006
    background: Path | None = None


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
    error = np.abs(rgb - np.asarray(change.rgb)).max()
    if not error <= change.tolerance:
        return f"off by {error:.4f}, read as {rgb[H // 2, W // 2]}, expected {np.ravel(change.rgb)[:3]}"
    if change.clipped is not None and abs(clipped - change.clipped) > 0.08:
        return f"{clipped:.2f} of the pixels are clipped, expected {change.clipped:.2f}"
    return ""


def _code(rng: Rng) -> tuple[np.ndarray, np.ndarray]:
    """A picture (h, w, 3) of one random value of 8 bits, and that value, 0 to 1."""
    value = rng.integers(30, 226, 3)
    return np.tile(value, (H, W, 1)).astype(np.uint8), value / 255


def _chosen(rng: Rng, names: Any) -> Any:
    return list(names)[int(rng.integers(len(names)))]


def _profile(rng: Rng, curve: str) -> bytes:
    """The sRGB profile with another curve: as a table, as an exponent or as parameters."""
    tags = {}
    for k in range(struct.unpack(">I", _SRGB[128:132])[0]):
        name, at, size = struct.unpack_from(">4sII", _SRGB, 132 + 12 * k)
        tags[name] = _SRGB[at : at + size]
    codes = np.linspace(0, 1, int(_chosen(rng, (256, 1024, 4096))))
    table = np.rint(65535 * _CURVES[curve](codes)).astype(">u2")
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
        tags[name] = _chosen(rng, ways)
    entries, data, at = b"", b"", 132 + 12 * len(tags)
    for name, content in tags.items():
        entries += struct.pack(">4sII", name, at + len(data), len(content))
        data += content + bytes(-len(content) % 4)
    body = _SRGB[:128] + struct.pack(">I", len(tags)) + entries + data
    return struct.pack(">I", len(body)) + body[4:]


def _icc(suffix: str) -> Callable[[Path, Rng], Change]:
    def write(folder: Path, rng: Rng) -> Change:
        (values, code), curve = _code(rng), _chosen(rng, _CURVES)
        path, profile = folder / f"a.{suffix}", _profile(rng, curve)
        if suffix == "tif":
            tifffile.imwrite(path, values, photometric="rgb", iccprofile=profile)
        else:
            how = {"jpg": {"quality": 100, "subsampling": 0}, "webp": {"lossless": True}}.get(suffix, {})
            Image.fromarray(values).save(path, icc_profile=profile, **how)
        if curve == "odd":
            return Change(
                path=path, refused="states the transfer curve of an ICC profile, .* which is not read"
            )
        return Change(path=path, rgb=_CURVES[curve](code), tolerance=0.012 if suffix == "jpg" else 0.004)

    return write


def _with_chunk(png: bytes, kind: bytes, content: bytes) -> bytes:
    """Put a chunk behind the header of a PNG."""
    chunk = struct.pack(">I", len(content)) + kind + content
    return png[:33] + chunk + struct.pack(">I", zlib.crc32(kind + content)) + png[33:]


def _png_chunks(folder: Path, rng: Rng) -> Change:
    """gAMA, sRGB and cICP, of which the later one in this list counts."""
    (values, code), stream = _code(rng), io.BytesIO()
    Image.fromarray(values).save(stream, "PNG")
    data, light, refused = stream.getvalue(), code, ""
    if rng.random() < 0.6:
        exponent = float(_chosen(rng, (1.0, 1.8, 2.2)))
        data, light = _with_chunk(data, b"gAMA", struct.pack(">I", round(1e5 / exponent))), code**exponent
    if rng.random() < 0.5:
        data, light = _with_chunk(data, b"sRGB", b"\0"), _CURVES["srgb"](code)
    if rng.random() < 0.5:
        number, curve = _chosen(rng, {1: "bt709", 8: "linear", 13: "srgb", 4: "gamma:2.2", 17: ""}.items())
        data = _with_chunk(data, b"cICP", bytes([1, number, 0, 1]))
        light, refused = (
            (_CURVES[curve](code), "") if curve else (light, "states the transfer curve smpte428")
        )
    (folder / "a.png").write_bytes(data)
    return Change(path=folder / "a.png", rgb=light, refused=refused, tolerance=0.004)


def _aspect(suffix: str) -> Callable[[Path, Rng], Change]:
    def write(folder: Path, rng: Rng) -> Change:
        (values, code), path = _code(rng), folder / f"a.{suffix}"
        across, down = (int(n) for n in _chosen(rng, ((72, 72), (300, 300), (72, 144), (160, 150), (3, 4))))
        if suffix == "exr":
            header = {"type": OpenEXR.scanlineimage, "pixelAspectRatio": down / across}
            OpenEXR.File(header, {"RGB": (values / 255).astype(np.float32)}).write(str(path))
        elif suffix == "mkv":
            _film(path, values, codec="libx264rgb", sample_aspect_ratio=Fraction(down, across))
        elif suffix == "tif":
            tifffile.imwrite(path, values, photometric="rgb", resolution=(across, down))
        else:
            Image.fromarray(values).save(
                path, dpi=(across, down), **({"quality": 100} if suffix == "jpg" else {})
            )
        refused = (
            "" if across == down else "times as wide as high, expected square ones; stretch it first: ffmpeg"
        )
        return Change(path=path, rgb=code, refused=refused, tolerance=0.012)

    return write


def _film(path: Path, *frames: np.ndarray, codec: str = "ffv1", **stated: Any) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.height, stream.width = frames[0].shape[:2]
        has_alpha = frames[0].shape[2] == 4
        stream.pix_fmt = "bgra" if has_alpha else "rgb24" if codec == "libx264rgb" else "bgr0"
        stream.codec_context.thread_count = 1
        stream.metadata.update({name: text for name, text in stated.items() if isinstance(text, str)})
        for name, value in stated.items():
            if not isinstance(value, str):
                setattr(stream.codec_context, name, value)
        for frame in frames:
            picture = av.VideoFrame.from_ndarray(frame, format="rgba" if has_alpha else "rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))


def _video_alpha(folder: Path, rng: Rng) -> Change:
    (values, code), alpha = _code(rng), _chosen(rng, (255, 254, 128, 0))
    _film(folder / "a.mkv", np.dstack([values, np.full((H, W), alpha, np.uint8)]))
    return Change(
        path=folder / "a.mkv", rgb=code, refused="" if alpha == 255 else "alpha channel is not opaque"
    )


def _video_stereo(folder: Path, rng: Rng) -> Change:
    values, code = _code(rng)
    mode = _chosen(rng, ("mono", "left_right", "top_bottom"))
    _film(folder / "a.mkv", values, stereo_mode=mode)
    return Change(path=folder / "a.mkv", rgb=code, refused="" if mode == "mono" else "holds 2 views")


def _video_curve(folder: Path, rng: Rng) -> Change:
    (values, code), path = _code(rng), folder / "a.mkv"
    number, curve = _chosen(rng, {1: "bt709", 8: "linear", 13: "srgb", 4: "gamma:2.2", 17: ""}.items())
    _film(path, values, codec="libx264rgb", color_trc=number)
    if not curve:
        return Change(path=path, refused="states the transfer curve smpte428, which is not read")
    return Change(path=path, rgb=_CURVES[curve](code), tolerance=0.02)


def _video_range(folder: Path, rng: Rng) -> Change:
    (values, code), limited = _code(rng), int(rng.integers(1, 3))
    _film(folder / "a.mkv", values, codec="libx264rgb", color_range=limited)
    refused = "is stored as RGB of limited range" if limited == 1 else ""
    return Change(path=folder / "a.mkv", rgb=code, refused=refused, tolerance=0.02)


def _exr_chromaticities(folder: Path, rng: Rng) -> Change:
    name, light = _chosen(rng, _PRIMARIES), rng.uniform(0.1, 0.9, 3)
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
        "type": OpenEXR.scanlineimage, "compression": getattr(OpenEXR, f"{_chosen(rng, kinds)}_COMPRESSION"),
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


def _half_tiff(folder: Path, rng: Rng) -> Change:
    """Half floats, or channels that are stored apart; turned or flipped."""
    upright = rng.random((H, W, 3)).astype(np.float16)
    value = int(_chosen(rng, (1, 2, 3, 4)))
    stored = {1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1]}[value]
    if rng.random() < 0.5:
        stored, upright = np.uint16(65535 * stored), np.uint16(65535 * upright) / 65535
    planar = bool(stored.dtype == np.uint16 or rng.random() < 0.3)
    tifffile.imwrite(
        folder / "a.tif", np.moveaxis(stored, 2, 0).copy() if planar else np.ascontiguousarray(stored),
        photometric="rgb", planarconfig="separate" if planar else "contig",
        compression=_chosen(rng, (None, "zlib")), extratags=[(274, "H", 1, value, True)],
    )  # fmt: skip
    return Change(path=folder / "a.tif", rgb=upright, tolerance=1e-6)


def _animation(suffix: str) -> Callable[[Path, Rng], Change]:
    def write(folder: Path, rng: Rng) -> Change:
        (values, code), count = _code(rng), int(rng.integers(1, 5))
        path = folder / f"a.{suffix}"
        pictures = [Image.fromarray(np.roll(values, k, 2)) for k in range(count)]
        how = {"lossless": True} if suffix == "webp" else {}
        pictures[0].save(
            path, **({"save_all": True, "append_images": pictures[1:]} if count > 1 else {}), **how
        )
        same = {picture.tobytes() for picture in pictures}
        refused = f"holds {count} pictures, expected one" if count > 1 and len(same) == count else ""
        return Change(path=path, rgb=code, refused=refused or ("holds" if count > 1 else ""))

    return write


def _stored_colours(folder: Path, rng: Rng) -> Change:
    values, _ = _code(rng)
    way = int(rng.integers(4))
    if way == 0:
        Image.fromarray(values).convert("CMYK").save(folder / "a.jpg")
        return Change(path=folder / "a.jpg", refused="is stored as CMYK, expected RGB")
    stored, how, said = [
        (np.stack([values] * 3), {"photometric": "rgb"}, "holds 3 pages, expected one"),
        (values[..., 0], {"photometric": "miniswhite"}, "is stored as grey with white as zero"),
        (values, {"photometric": "cielab"}, "is stored as CIELAB"),
    ][way - 1]
    tifffile.imwrite(folder / "a.tif", np.ascontiguousarray(stored), metadata=None, **how)
    return Change(path=folder / "a.tif", refused=said)


def _dng(
    path: Path, rng: Rng, light: np.ndarray, *, white: int, stop: int | None = None, **tags: Any
) -> None:
    """Write RGGB of (h, w, 3) light, noisy, that the sensor stops at `stop`. tags: black, margins."""
    black = np.array(tags.get("black", (64,) * 4)).reshape(2, 2)
    top, left, bottom, right = tags.get("active", (0, 0, *light.shape[:2]))
    v, u = np.mgrid[: light.shape[0], : light.shape[1]]
    pattern = np.array([[0, 1], [1, 2]])[(v - top) % 2, (u - left) % 2]
    level = black[(v - top) % 2, (u - left) % 2]
    samples = level + np.take_along_axis(light, pattern[..., None], 2)[..., 0] * (white - level)
    samples = np.rint(samples + rng.normal(0, 3, samples.shape)).clip(0, stop or white).astype(np.uint16)
    identity = [n for k in range(9) for n in (int(k % 4 == 0), 1)]
    extra = [
        (50706, "B", 4, bytes([1, 4, 0, 0]), True), (50708, "s", 0, "A Camera", True),
        (33421, "H", 2, (2, 2), True), (33422, "B", 4, bytes([0, 1, 1, 2]), True),
        (50713, "H", 2, (2, 2), True), (50714, "H", 4, tuple(black.ravel().tolist()), True),
        (50717, "I", 1, white, True), (50721, "2i", 9, tuple(identity), True),
        (50728, "2I", 3, (1,) * 6, True), (50778, "H", 1, 21, True),
        (50829, "I", 4, (top, left, bottom, right), True),
    ]  # fmt: skip
    tifffile.imwrite(path, samples, photometric=32803, extratags=extra, metadata=None)


def _dng_levels(folder: Path, rng: Rng) -> Change:
    """Black levels of each colour, and margins of any parity, of which LibRaw may leave out a pixel more."""
    light = rng.uniform(0.1, 0.7, 3)
    black = rng.integers(0, 900, 4) if rng.random() < 0.7 else np.full(4, 256)
    far = np.array([2 * H, 2 * W]) - rng.integers(0, 4, 2)
    margins = (*rng.integers(0, 4, 2).tolist(), *far.tolist())
    picture = np.tile(light, (2 * H, 2 * W, 1))
    _dng(
        folder / "a.dng",
        rng,
        picture,
        white=int(rng.integers(3000, 16384)),
        black=black,
        active=margins,
    )
    return Change(path=folder / "a.dng", rgb=light, tolerance=0.01)


def _dng_white(folder: Path, rng: Rng) -> Change:
    """The sensor stops below the stated white; a third of the picture is overexposed."""
    white = int(rng.integers(4000, 16384))
    stop = int(white * rng.uniform(0.8, 1.0))
    light = np.tile(np.linspace(0.1, 0.7, 2 * W)[:, None], (2 * H, 1, 3))
    light[:, : 2 * W // 3] = 1.2
    _dng(folder / "a.dng", rng, light, white=white, stop=stop)
    return Change(path=folder / "a.dng", rgb=light.clip(0, 1), clipped=1 / 3, tolerance=1.0)


def _matte_in_alpha(folder: Path, rng: Rng) -> Change:
    v, u = np.mgrid[:H, :W]
    mask = (u - rng.integers(8, 24)) ** 2 + (v - rng.integers(6, 18)) ** 2 < 30
    alpha = np.where(mask, 255, 0).astype(np.uint8)
    paint = np.full((H, W, 3), _chosen(rng, (0, 255, 90)), np.uint8)
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
    take, (values, code) = folder / "take", _code(rng)
    take.mkdir()
    count = int(rng.integers(2, 5))
    names, refused = [f"f_{k:03d}" for k in range(count + 2)], ""
    way = int(rng.integers(5))
    if way == 0:
        names += [f"g_{k:03d}" for k in range(count)]
    elif way == 1:
        names = [f"take{n}_{k:03d}" for n in (1, 2) for k in range(count + n)]
    elif way == 2:
        names += ["mask"]
    elif way == 3:
        _film(take / "other.mkv", values)
    for name in names:
        Image.fromarray(values).save(take / f"{name}.png")
    if way in (0, 1):
        refused = "holds 2 series of images"
    elif way == 3:
        refused = "holds the video other.mkv and images"
    return Change(path=take, rgb=code, refused=refused)


def _curves_that_differ(folder: Path, rng: Rng) -> Change:
    """One frame, or the background, states another curve than the first frame."""
    (values, code), curve = _code(rng), _chosen(rng, ("srgb", "gamma:1.8", "bt709"))
    (folder / "f").mkdir()
    for k in range(3):
        Image.fromarray(values).save(folder / f"f/{k}.png", icc_profile=_profile(rng, "srgb"))
    changed = folder / ("f/1.png" if rng.random() < 0.5 else "b.png")
    dark = values if changed.parent.name == "f" else np.zeros_like(values)
    Image.fromarray(dark).save(changed, icc_profile=_profile(rng, curve))
    background = changed if changed.name == "b.png" else None
    refused = "" if curve == "srgb" else "states the transfer curve"
    return Change(path=folder / "f", rgb=_CURVES["srgb"](code), refused=refused, background=background)


CHANGES: dict[str, Callable[[Path, Rng], Change]] = {
    **{f"ICC profile, {suffix}": _icc(suffix) for suffix in ("png", "jpg", "tif", "webp")},
    **{f"pixel aspect, {suffix}": _aspect(suffix) for suffix in ("png", "jpg", "tif", "bmp", "exr", "mkv")},
    **{f"animation, {suffix}": _animation(suffix) for suffix in ("png", "webp")},
    "PNG chunks": _png_chunks, "video alpha": _video_alpha, "video stereo": _video_stereo,
    "video curve": _video_curve, "video range": _video_range, "EXR chromaticities": _exr_chromaticities,
    "EXR windows": _exr_windows, "EXR views and parts": _exr_views, "EXR luminance": _exr_luminance,
    "half-float and planar TIFF": _half_tiff,
    "stored colours": _stored_colours, "DNG black and margins": _dng_levels,
    "DNG white": _dng_white, "matte in alpha": _matte_in_alpha, "series in a folder": _folder_of_series,
    "curves that differ": _curves_that_differ,
}  # fmt: skip

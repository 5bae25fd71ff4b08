"""Images that state a curve, a turn, colours or several pictures."""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from PIL import Image, PngImagePlugin

from tests.faults.stated_change import CURVES, Change, H, Rng, W, chosen, profile_of, random_code


def icc(suffix: str) -> Callable[[Path, Rng], Change]:
    def write(folder: Path, rng: Rng) -> Change:
        (values, code), curve = random_code(rng), chosen(rng, CURVES)
        path, profile = folder / f"a.{suffix}", profile_of(rng, curve)
        if suffix == "tif":
            tifffile.imwrite(path, values, photometric="rgb", iccprofile=profile)
        else:
            how = {"jpg": {"quality": 100, "subsampling": 0}, "webp": {"lossless": True}}.get(suffix, {})
            Image.fromarray(values).save(path, icc_profile=profile, **how)
        if curve == "odd":
            return Change(
                path=path, refused="states the transfer curve of an ICC profile, .* which is not read"
            )
        return Change(path=path, rgb=CURVES[curve](code), tolerance=0.012 if suffix == "jpg" else 0.004)

    return write


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _with_chunk(png: bytes, kind: bytes, content: bytes) -> bytes:
    """Put a chunk behind the header of a PNG."""
    return png[:33] + _chunk(kind, content) + png[33:]


def png_chunks(folder: Path, rng: Rng) -> Change:
    """gAMA, sRGB and cICP, of which the later one in this list counts."""
    (values, code), stream = random_code(rng), io.BytesIO()
    Image.fromarray(values).save(stream, "PNG")
    data, light, refused = stream.getvalue(), code, ""
    if rng.random() < 0.6:
        exponent = float(chosen(rng, (1.0, 1.8, 2.2)))
        data, light = _with_chunk(data, b"gAMA", struct.pack(">I", round(1e5 / exponent))), code**exponent
    if rng.random() < 0.5:
        data, light = _with_chunk(data, b"sRGB", b"\0"), CURVES["srgb"](code)
    if rng.random() < 0.5:
        number, curve = chosen(rng, {1: "bt709", 8: "linear", 13: "srgb", 4: "gamma:2.2", 17: ""}.items())
        data = _with_chunk(data, b"cICP", bytes([1, number, 0, 1]))
        light, refused = (CURVES[curve](code), "") if curve else (light, "states the transfer curve smpte428")
    (folder / "a.png").write_bytes(data)
    return Change(path=folder / "a.png", rgb=light, refused=refused, tolerance=0.004)


def _exif(rng: Rng, *entries: tuple[int, int, int, bytes], turned: int = 1) -> bytes:
    """EXIF data of either byte order: how it is turned, and entries (tag, type, count, content)."""
    order = chosen(rng, "<>")
    first = 8 + 2 + 2 * 12 + 4
    beyond = first + 2 + 12 * len(entries) + 4

    def directory(rows: list[tuple[int, int, int, bytes]], at: int) -> bytes:
        """`at`: where contents of more than four bytes begin."""
        table, contents = struct.pack(order + "H", len(rows)), b""
        for tag, kind, count, content in rows:
            table += struct.pack(order + "HHI", tag, kind, count)
            if len(content) > 4:
                table += struct.pack(order + "I", at + len(contents))
                contents += content
            else:
                table += content.ljust(4, b"\0")
        return table + bytes(4) + contents

    short, long = (lambda n: struct.pack(order + "H", n)), (lambda n: struct.pack(order + "I", n))
    own = []
    for tag, kind, count, content in entries:
        if kind == 3:  # a number
            own.append((tag, kind, count, short(int.from_bytes(content, "big"))))
        elif kind == 5:  # a fraction
            own.append((tag, kind, count, b"".join(long(n) for n in struct.unpack(">II", content))))
        else:  # a directory of one text
            text = directory([(1, 2, len(content), content)], 0)
            own.append((tag, 4, 1, long(beyond)))
            return (
                {"<": b"II*\0", ">": b"MM\0*"}[order] + long(8)
                + directory([(274, 3, 1, short(turned)), (0x8769, 4, 1, long(first))], 0)
                + directory(own, 0) + text
            )  # fmt: skip
    return (
        {"<": b"II*\0", ">": b"MM\0*"}[order] + long(8)
        + directory([(274, 3, 1, short(turned)), (0x8769, 4, 1, long(first))], 0)
        + directory(own, beyond)
    )  # fmt: skip


def exif_curve(suffix: str) -> Callable[[Path, Rng], Change]:
    """The colour space sRGB, that of Adobe RGB (no colour space, and an index R03 behind it), or a gamma."""

    def write(folder: Path, rng: Rng) -> Change:
        (values, code), path = random_code(rng), folder / f"a.{suffix}"
        said, curve = chosen(
            rng,
            (
                ([(0xA001, 3, 1, b"\0\1")], "srgb"),
                ([(0xA001, 3, 1, b"\xff\xff"), (0xA005, 4, 1, b"R03\0")], "gamma:2.2"),
                ([(0xA500, 5, 1, struct.pack(">II", 18, 10))], "gamma:1.8"),
                ([(0xA001, 3, 1, b"\xff\xff")], "linear"),
            ),
        )
        exif = b"Exif\0\0" + _exif(rng, *said)
        if suffix == "tif":
            _tiff_with_exif(path, values, curve)
            return Change(path=path, rgb=CURVES[curve](code) if curve in ("srgb", "gamma:1.8") else code)
        how = {"jpg": {"quality": 100, "subsampling": 0}, "webp": {"lossless": True}}.get(suffix, {})
        Image.fromarray(values).save(path, exif=exif, **how)
        return Change(path=path, rgb=CURVES[curve](code), tolerance=0.012 if suffix == "jpg" else 0.004)

    return write


def _tiff_with_exif(path: Path, values: np.ndarray, curve: str) -> None:
    """Write a TIFF, and behind it the directory of its EXIF data, of sRGB, of gamma 1.8 or of neither."""
    unused = 65000  # a number of nobody's, in whose place the directory's is put
    tifffile.imwrite(path, values, photometric="rgb", metadata=None, extratags=[(unused, "I", 1, 0, True)])
    data = bytearray(path.read_bytes())
    at = data.find(struct.pack("<HHI", unused, 4, 1))
    struct.pack_into("<HHII", data, at, 0x8769, 4, 1, len(data))
    entry = struct.pack("<HHHIHH", 1, 0xA001, 3, 1, 1 if curve == "srgb" else 65535, 0)
    if curve == "gamma:1.8":
        entry = struct.pack("<HHHII", 1, 0xA500, 5, 1, len(data) + 18)
    path.write_bytes(data + entry + bytes(4) + struct.pack("<II", 18, 10))


def turned(folder: Path, rng: Rng) -> Change:
    """EXIF data before or behind the pixels of a PNG, or a turn that XMP alone states."""
    upright = np.kron(rng.integers(0, 256, (H // 8, W // 8, 3), dtype=np.uint8), np.ones((8, 8, 1), np.uint8))
    value, way = int(chosen(rng, (3, 6, 8))), int(rng.integers(4))
    stored = np.ascontiguousarray(np.rot90(upright, {3: 2, 6: 1, 8: 3}[value]))
    path = folder / ("a.jpg" if way == 3 else "a.png")
    if way < 2:
        stream = io.BytesIO()
        Image.fromarray(stored).save(stream, "PNG")
        data, exif = stream.getvalue(), _exif(rng, turned=value)
        end = data[:-12] + _chunk(b"eXIf", exif) + data[-12:]
        path.write_bytes(_with_chunk(data, b"eXIf", exif) if way else end)
    else:
        said = f'<x:xmpmeta xmlns:x="adobe:ns:meta/" tiff:Orientation="{value}"/>'
        how: dict[str, Any] = {"xmp": said.encode(), "quality": 100, "subsampling": 0}
        if way == 2:
            how = {"pnginfo": PngImagePlugin.PngInfo()}
            how["pnginfo"].add_itxt("XML:com.adobe.xmp", said)
        Image.fromarray(stored).save(path, **how)
    return Change(path=path, rgb=upright / 255, tolerance=0.02)


def bitmap(folder: Path, rng: Rng) -> Change:
    """BMP of version 4 or 5, whose header states a colour space, gammas or a profile; or bits of its own."""
    (values, code), path = random_code(rng), folder / "a.bmp"
    if rng.random() < 0.4:
        return _masked_bitmap(path, rng)
    kind, curve = chosen(
        rng, {b"BGRs": "srgb", b" niW": "srgb", bytes(4): "gamma:2.2", b"DEBM": "gamma:1.8"}.items()
    )
    profile = profile_of(rng, curve) if kind == b"DEBM" else b""
    length = 124 if profile or rng.random() < 0.5 else 108
    rows = values[::-1, :, ::-1].tobytes()
    header = struct.pack("<IiiHHIIiiII", length, W, H, 1, 24, 0, len(rows), 2835, 2835, 0, 0)
    header += struct.pack("<4I", 0xFF0000, 0xFF00, 0xFF, 0) + kind + bytes(36)
    header += struct.pack("<3I", *(3 * [round(65536 * 2.2)]))
    if length == 124:
        header += struct.pack("<4I", 4, length + len(rows), len(profile), 0)
    size = 14 + length + len(rows) + len(profile)
    path.write_bytes(b"BM" + struct.pack("<IHHI", size, 0, 0, 14 + length) + header + rows + profile)
    return Change(path=path, rgb=CURVES[curve](code), tolerance=0.004)


def _masked_bitmap(path: Path, rng: Rng) -> Change:
    """Colours of 5, 6 or 10 bits, or in another order: Pillow or OpenCV read few of them."""
    bits, packing, masks = chosen(
        rng,
        (
            (16, 0, ()), (16, 3, (0xF800, 0x7E0, 0x1F)), (32, 3, (0xFF, 0xFF00, 0xFF0000)),
            (32, 3, (0xFF000000, 0xFF0000, 0xFF00)), (32, 3, (0x3FF00000, 0xFFC00, 0x3FF)),
        ),
    )  # fmt: skip
    rows = rng.integers(1, 256, H * W * bits // 8, dtype=np.uint8).tobytes()
    header = struct.pack("<IiiHHIIiiII", 40, W, H, 1, bits, packing, len(rows), 2835, 2835, 0, 0)
    header += struct.pack(f"<{len(masks)}I", *masks)
    start = struct.pack("<IHHI", 14 + len(header) + len(rows), 0, 0, 14 + len(header))
    path.write_bytes(b"BM" + start + header + rows)
    return Change(path=path, refused="stores colours by masks of its own")


def tiff_curve(folder: Path, rng: Rng) -> Change:
    """A TransferFunction, one for all channels or three, of 8 or 16 bits."""
    (values, code), curve, path = random_code(rng), chosen(rng, CURVES), folder / "a.tif"
    deep = rng.random() < 0.5
    table = np.rint(65535 * CURVES[curve](np.linspace(0, 1, 65536 if deep else 256))).astype(int).tolist()
    tables = table * int(chosen(rng, (1, 3)))
    stored = values.astype(np.uint16) * 257 if deep else values
    tags = [(301, "H", len(tables), tables, True)]
    tifffile.imwrite(path, stored, photometric="rgb", metadata=None, extratags=tags)
    refused = "states the transfer curve of a table" if curve == "odd" else ""
    return Change(path=path, rgb=CURVES[curve](code), refused=refused, tolerance=0.004)


def tiff_samples(folder: Path, rng: Rng) -> Change:
    """Samples beside the colours, or a volume: one or the other would be left out."""
    (values, code), path = random_code(rng), folder / "a.tif"
    way = int(rng.integers(4))
    stored, how, refused = [
        (np.dstack([values, values[..., :2]]), {"photometric": "rgb", "extrasamples": (0, 0)}, "5 samples"),
        (values[..., :2], {"photometric": "minisblack", "extrasamples": (0,)}, "2 samples"),
        (np.stack([np.tile(values, (2, 2, 1))] * 2),
         {"photometric": "rgb", "volumetric": True, "tile": (2, 16, 16)}, "holds 2 pages"),
        (np.dstack([values, values[..., :1] * 0 + 255]),
         {"photometric": "rgb", "extrasamples": (1,)}, ""),
    ][way]  # fmt: skip
    tifffile.imwrite(path, np.ascontiguousarray(stored), metadata=None, **how)
    return Change(path=path, rgb=code, refused=refused)


def rare_tiff(folder: Path, rng: Rng) -> Change:
    """Half floats, channels that are stored apart, or what OpenCV cannot unpack; turned or flipped."""
    upright = rng.random((H, W, 3)).astype(np.float16)
    value, way = int(chosen(rng, (1, 2, 3, 4))), chosen(rng, ("half", "half planar", "planar", "lzma"))
    if not way.startswith("half"):
        upright = np.uint16(65535 * upright.astype(np.float32))
    stored = {1: upright, 2: upright[:, ::-1], 3: upright[::-1, ::-1], 4: upright[::-1]}[value]
    planar = way.endswith("planar")
    tifffile.imwrite(
        folder / "a.tif", np.moveaxis(stored, 2, 0).copy() if planar else np.ascontiguousarray(stored),
        photometric="rgb", planarconfig="separate" if planar else "contig",
        compression="lzma" if way == "lzma" else chosen(rng, (None, "zlib")),
        extratags=[(274, "H", 1, value, True)],
    )  # fmt: skip
    full = 65535 if upright.dtype == np.uint16 else 1
    return Change(path=folder / "a.tif", rgb=upright / full, tolerance=1e-6)


def jpeg_pair(folder: Path, rng: Rng) -> Change:
    """Two views in one JPEG (MPO); a preview behind the picture is none."""
    (values, code), path = random_code(rng), folder / "a.jpg"
    smaller = rng.random() < 0.5
    other = Image.fromarray(values[::2, ::2] if smaller else values[:, ::-1])
    Image.fromarray(values).save(
        path, "MPO", save_all=True, append_images=[other], quality=100, subsampling=0
    )
    return Change(path=path, rgb=code, refused="" if smaller else "holds 2 pictures", tolerance=0.012)


def still_of_another_kind(folder: Path, rng: Rng) -> Change:
    """What FFmpeg would open, without the picture's statements, or as the first of its like beside it."""
    (values, _), suffix = random_code(rng), chosen(rng, ("tga", "ppm", "jp2"))
    for name in ("f1", "f2", "f%d"):
        Image.fromarray(values).save(folder / f"{name}.{suffix}")
    path = folder / f"{chosen(rng, ('f1', 'f%d'))}.{suffix}"
    return Change(path=path, refused="a picture, which is to be saved as PNG or TIFF")


def animation(suffix: str) -> Callable[[Path, Rng], Change]:
    def write(folder: Path, rng: Rng) -> Change:
        (values, code), count = random_code(rng), int(rng.integers(1, 5))
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


def stored_colours(folder: Path, rng: Rng) -> Change:
    values, _ = random_code(rng)
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

"""Normal maps, depth maps and optical flow on disk. Masks and labels: `label_images`."""

from pathlib import Path

import numpy as np

from vntoolkit.arrays import Array, Float32Array, FloatArray, Flow, Int64Array, Mask, UInt16Array
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.io.atomic import write_large
from vntoolkit.io.footage.images import read_image_with_alpha, write_png
from vntoolkit.io.maps_and_meshes.exr import ExrCompression, read_exr, uncompressed_exr, write_exr
from vntoolkit.native import njit
from vntoolkit.options.export import NormalConvention

Plane = Float32Array
_ERROR_CHANNEL, _DEPTH_ERROR_CHANNEL = "error_deg", "error_percent"
_MOST_PERCENT = np.float32(1000.0)  # more means the same, and a half holds no more than 65504
_UNIT_ATTRIBUTE = "vntoolkit.lengthUnit"
_CONVENTION_ATTRIBUTE = "vntoolkit.normalConvention"
_SHORTEST_NORMAL = 0.5  # a stored vector below it is background, not a normal: (0, 0, 0) or mid grey
_SIGN = np.uint32(0x8000_0000)
_SMALLEST_NORMAL = np.uint32(0x3880_0000)  # 2**-14: below it a half counts in steps of 2**-24
_BIAS = np.uint32(0x3800_0000)  # the exponents' zeros lie 112 apart
_TOO_LARGE = np.uint32(0x4780_0000)  # 2**16
_BEYOND_INFINITY = np.uint32(0x7F80_0000)
_STEPS_PER_UNIT = np.float32(2.0**24)


def write_normal_map(
    path: Path | str,
    normal_map: NormalMap,
    *,
    convention: NormalConvention = NormalConvention.OPENGL,
    compression: ExrCompression = ExrCompression.NONE,
    bits: int = 16,
) -> None:
    """Write a normal map: `.exr` (half RGBA, A = confidence, 0 where invalid) or `.png` (n = v/max·2 − 1).

    An EXR also holds the map's error in degrees, if it has one, as the channel `error_deg`.
    bits: 8 or 16, of a PNG (RGBA, A opaque where valid). compression: of an EXR.
    """
    match Path(path).suffix.lower():
        case ".exr":
            attributes = {_CONVENTION_ATTRIBUTE: convention.value}
            if compression is ExrCompression.NONE:
                names = [*"RGBA", *([] if normal_map.error_deg is None else [_ERROR_CHANNEL])]
                exr = uncompressed_exr(normal_map.shape, dict.fromkeys(names, np.float16), attributes)
                starts = np.array([exr.starts[name] for name in names])
                _fill_halves(normal_map, convention.signs, exr.scanlines, starts)
                write_large(path, exr.content)
                return
            planes = half_planes_from_normals(normal_map, convention.signs)
            channels = dict(zip([*"RGBA", _ERROR_CHANNEL], planes, strict=False))
            write_exr(path, channels, attributes=attributes, compression=compression)
        case ".png":
            stored = normal_map.normals_in_camera * np.array(convention.signs, np.float32)
            write_png(path, _png_from_normals(stored, normal_map.mask, bits))
        case suffix:
            raise BadInput(f"{path}: a normal map is written as .exr or .png, not '{suffix}'")


def read_normal_map(
    path: Path | str,
    *,
    convention: NormalConvention | None = None,
    mask: Mask | None = None,
    max_megapixels: float | None = None,
) -> NormalMap:
    """Read a normal map, EXR, or 8- or 16-bit PNG or TIFF, and normalise it.

    convention: None for what the EXR's header says, else opengl. mask: (h, w); None for the alpha channel,
    or where there is none, for the pixels whose vector is longer than 0.5.
    """
    weight: Plane | None
    if Path(path).suffix.lower() == ".exr":
        stored, weight, error, stated = exr_planes_of_normals(path, max_megapixels)
    else:
        pixels, alpha = read_image_with_alpha(path, max_megapixels=max_megapixels)
        full = 1.0 if pixels.dtype == np.float32 else np.iinfo(pixels.dtype).max
        stored = pixels if pixels.dtype == np.float32 else pixels * np.float32(2.0 / full) - 1.0
        weight = None if alpha is None else alpha.astype(np.float32)
        error, stated = None, None
    signs = (convention or stated or NormalConvention.OPENGL).signs
    normals, valid = _unit_normals(np.ascontiguousarray(stored), np.array(signs, np.float32))
    if weight is not None:
        valid &= weight > 0
    if mask is not None:
        require_shape(mask, valid.shape, f"mask of {path}")
        valid &= mask
    if not valid.any():
        raise BadInput(f"{path}: no pixel holds a normal")
    normals *= valid[..., None]
    graded = weight is not None and bool((weight[valid] < 1).any())
    return NormalMap(
        normals_in_camera=normals,
        mask=valid,
        weight=weight if graded else None,
        error_deg=None if error is None else np.where(valid, error, np.float32(0)),
    )


def write_depth_map(
    path: Path | str, depth_map: DepthMap, *, compression: ExrCompression = ExrCompression.NONE
) -> None:
    """Write depth as EXR: channel Z, float32, NaN where invalid; the length unit is in the header.

    Its error, if it has one, is the channel `error_percent`, half, in % of the depth's range.
    """
    if Path(path).suffix.lower() != ".exr":
        raise BadInput(f"{path}: a depth map is written as .exr")
    invalid = np.float32(np.nan)
    channels: dict[str, Array] = {"Z": np.where(depth_map.mask, depth_map.depth, invalid).astype(np.float32)}
    if depth_map.error_percent is not None:
        channels[_DEPTH_ERROR_CHANNEL] = np.minimum(depth_map.error_percent, _MOST_PERCENT).astype(np.float16)
    attributes = {_UNIT_ATTRIBUTE: depth_map.unit.value}
    write_exr(path, channels, attributes=attributes, compression=compression)


def read_depth_map(path: Path | str, *, max_megapixels: float | None = None) -> DepthMap:
    """Read the channel Z of an EXR; NaN and infinity are invalid. Without a stated unit: pixels."""
    channels, texts = read_exr(path, max_megapixels=max_megapixels, error=BadInput)
    z = channels.get("Z")
    if z is None:
        raise BadInput(f"{path}: expected a channel Z, found {', '.join(channels)}")
    mask = np.isfinite(z)
    if not mask.any():
        raise BadInput(f"{path}: no pixel holds a depth")
    try:
        unit = LengthUnit(texts.get(_UNIT_ATTRIBUTE, LengthUnit.PIXEL.value))
    except ValueError as problem:
        raise BadInput(f"{path}: unknown length unit '{texts[_UNIT_ATTRIBUTE]}'") from problem
    error = channels.get(_DEPTH_ERROR_CHANNEL)
    return DepthMap(
        depth=np.where(mask, z, 0).astype(np.float32),
        mask=mask,
        unit=unit,
        error_percent=None if error is None else np.where(mask, error, 0).astype(np.float32),
    )


def write_flow(path: Path | str, flow_px: Flow, *, compression: ExrCompression = ExrCompression.NONE) -> None:
    """Write optical flow (h, w, 2) in pixels as EXR: channels du, dv, float32; NaN stays NaN."""
    require_shape(flow_px, (None, None, 2), "flow")
    flow_px = np.asarray(flow_px, dtype=np.float32)
    write_exr(path, {"du": flow_px[..., 0], "dv": flow_px[..., 1]}, compression=compression)


def _png_from_normals(stored: FloatArray, mask: Mask, bits: int) -> Array:
    if bits not in (8, 16):
        raise BadInput(f"normal map: a PNG has 8 or 16 bits, not {bits}")
    full = 2**bits - 1
    rgba = np.zeros((*mask.shape, 4), dtype=np.uint8 if bits == 8 else np.uint16)
    rgba[..., :3] = np.rint(np.clip((stored + 1.0) * (full / 2), 0, full))
    rgba[~mask, :3] = full // 2 + 1
    rgba[..., 3] = np.where(mask, full, 0)
    return rgba


def exr_planes_of_normals(
    path: Path | str, max_megapixels: float | None
) -> tuple[FloatArray, Plane, Plane | None, NormalConvention | None]:
    """Return what an EXR holds of normals: vectors (h, w, 3) as stored, confidence, errors, stated axes."""
    channels, texts = read_exr(path, max_megapixels=max_megapixels, error=BadInput)
    names = next((n for n in ("RGB", "XYZ", "xyz") if set(n) <= set(channels)), None)
    if names is None:
        raise BadInput(f"{path}: expected the channels R, G, B or X, Y, Z, found {', '.join(channels)}")
    stored = np.stack([channels[name] for name in names], axis=-1, dtype=np.float32, casting="unsafe")
    weight = channels["A"].astype(np.float32) if "A" in channels else None
    error = channels[_ERROR_CHANNEL].astype(np.float32) if _ERROR_CHANNEL in channels else None
    valid: Mask = np.isfinite(stored[..., 0]) & np.isfinite(stored[..., 1]) & np.isfinite(stored[..., 2])
    if weight is None:
        weight = valid.astype(np.float32)
    elif not valid[weight > 0].all():
        raise BadInput(f"{path}: {int((~valid & (weight > 0)).sum())} normals are NaN or infinite")
    convention = texts.get(_CONVENTION_ATTRIBUTE)
    try:
        stated = None if convention is None else NormalConvention(convention)
        return stored, weight, error, stated
    except ValueError as problem:
        raise BadInput(f"{path}: unknown normal convention '{convention}'") from problem


def half_planes_from_normals(normal_map: NormalMap, signs: tuple[float, float, float]) -> FloatArray:
    """Return (4, h, w) float16: n_x, n_y, n_z, each times its sign (1 or -1); the weight, 0 where invalid.

    Of a map with expected errors, (5, h, w): then these, in degrees.
    """
    height, width = normal_map.shape
    count = 4 if normal_map.error_deg is None else 5
    rows = np.empty((height, count * width), dtype=np.uint16)
    _fill_halves(normal_map, signs, rows, width * np.arange(count))
    return rows.view(np.float16).reshape(height, count, width).transpose(1, 0, 2)


def _fill_halves(
    normal_map: NormalMap,
    signs: tuple[float, float, float],
    rows: UInt16Array,
    starts: Int64Array,
) -> None:
    """Put planes into rows of halves, in half of numpy's time; starts: where each begins in a row."""
    normals = np.ascontiguousarray(normal_map.normals_in_camera, dtype=np.float32)
    mask = np.ascontiguousarray(normal_map.mask)
    weight, error = normal_map.weight, normal_map.error_deg
    weight = np.ascontiguousarray(mask if weight is None else weight, dtype=np.float32)
    error = None if error is None else np.ascontiguousarray(error)
    flips = np.array([0x8000 if sign < 0 else 0 for sign in (*signs, 1, 1)], dtype=np.uint32)
    _fill(normals, mask, weight, error, flips, rows, starts)


@njit(cache=True)
def _unit_normals(stored, signs):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return stored vectors (h, w, 3) as unit normals, 0 where none is, and (h, w) where one is."""
    height, width = stored.shape[:2]
    normals = np.zeros((height, width, 3), np.float32)
    valid = np.zeros((height, width), np.bool_)
    for v in range(height):
        for u in range(width):
            x, y, z = stored[v, u, 0] * signs[0], stored[v, u, 1] * signs[1], stored[v, u, 2] * signs[2]
            length = np.sqrt(x * x + y * y + z * z)
            if length > _SHORTEST_NORMAL and length < np.inf:  # so that it is a number, too
                valid[v, u] = True
                normals[v, u, 0], normals[v, u, 1], normals[v, u, 2] = x / length, y / length, z / length
    return normals, valid


@njit(cache=True, inline="always")
def _half_bits(value, bits):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Round a float32, given as value and as bits, to the nearest half, ties to even."""
    sign = (bits & _SIGN) >> np.uint32(16)
    size = bits & ~_SIGN
    normal = (size - _BIAS + np.uint32(0xFFF) + ((size >> np.uint32(13)) & np.uint32(1))) >> np.uint32(13)
    subnormal = np.uint32(np.int32(np.rint(min(abs(value), np.float32(1.0)) * _STEPS_PER_UNIT)))
    half = normal if size >= _SMALLEST_NORMAL else subnormal
    infinite = np.uint32(0x7E00) if size > _BEYOND_INFINITY else np.uint32(0x7C00)
    return sign | (min(half, np.uint32(0x7C00)) if size < _TOO_LARGE else infinite)


@njit(cache=True)
def _fill(normals, mask, weight, error, flips, rows, starts):  # type: ignore[no-untyped-def]  # pragma: no cover
    height, width = mask.shape
    row = np.empty(width, np.float32)  # contiguous, so that eight pixels are converted at a time
    bits = row.view(np.uint32)
    for v in range(height):
        for k in range(len(starts)):
            if k < 3:
                for u in range(width):
                    row[u] = normals[v, u, k]
            elif k == 3:
                for u in range(width):
                    row[u] = weight[v, u] if mask[v, u] else np.float32(0)
            elif error is not None:
                for u in range(width):  # a slice would take ten seconds to compile
                    row[u] = error[v, u]
            to, flip = rows[v, starts[k] : starts[k] + width], flips[k]
            for u in range(width):
                to[u] = _half_bits(row[u], bits[u]) ^ flip

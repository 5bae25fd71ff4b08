"""Normal maps, depth maps and optical flow on disk. Masks and labels: `label_images`."""

import logging
from pathlib import Path

import cv2
import numpy as np

from vntoolkit.arrays import Array, FloatArray, Flow, Mask, UInt16Array
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.exr import ExrCompression, read_exr, write_exr
from vntoolkit.options.export import NormalConvention

logger = logging.getLogger(__name__)
ERROR_CHANNEL, CONVENTION_ATTRIBUTE = "error_deg", "vntoolkit.normalConvention"
_DEPTH_ERROR_CHANNEL = "error_percent"
_MOST_PERCENT = np.float32(1000.0)  # more means the same, and a half holds no more than 65504
_UNIT_ATTRIBUTE = "vntoolkit.lengthUnit"


def write_normal_map(
    path: Path | str,
    normal_map: NormalMap,
    *,
    convention: NormalConvention = NormalConvention.OPENGL,
    compression: ExrCompression = ExrCompression.NONE,
) -> None:
    """Write a normal map: `.exr` (half RGBA, A = confidence, 0 where invalid) or `.png` (n = v/65535·2 − 1).

    An EXR also holds the map's error in degrees, if it has one, as the channel `error_deg`.
    A PNG is RGBA of 16 bits, opaque where valid. compression: of an EXR.
    """
    match Path(path).suffix.lower():
        case ".exr":
            attributes = {CONVENTION_ATTRIBUTE: convention.value}
            planes = half_planes_from_normals(normal_map, convention.signs)
            channels = dict(zip([*"RGBA", ERROR_CHANNEL], planes, strict=False))
            write_exr(path, channels, attributes=attributes, compression=compression)
        case ".png":
            stored = normal_map.normals_in_camera * np.array(convention.signs, np.float32)
            write_png(path, _png_from_normals(stored, normal_map.mask))
        case suffix:
            raise BadInput(f"{path}: a normal map is written as .exr or .png, not '{suffix}'")


def read_normal_map(
    path: Path | str,
    *,
    convention: NormalConvention | None = None,
    mask: Mask | None = None,
) -> NormalMap:
    """Read a normal map of this program or of another one. What had to be assumed is logged.

    convention: None for what the EXR's header says, else opengl. mask: (h, w); None for the alpha channel,
    or where there is none, for all but the background.
    """
    from vntoolkit.io.maps_and_meshes.stored_normals import read_stored_normals

    found = read_stored_normals(path, mask)
    for note in found.notes:
        logger.warning("%s: %s", path, note)
    signs = np.array((convention or found.convention or NormalConvention.OPENGL).signs, np.float32)
    return NormalMap(
        normals_in_camera=found.vectors * signs,
        mask=found.mask,
        weight=found.weight,
        error_deg=found.error_deg,
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


def read_depth_map(path: Path | str) -> DepthMap:
    """Read the channel Z of an EXR; NaN and infinity are invalid. Without a stated unit: pixels."""
    channels, header = read_exr(path)
    z = channels.get("Z")
    if z is None:
        raise BadInput(f"{path}: expected a channel Z, found {', '.join(channels)}")
    mask = np.isfinite(z)
    if not mask.any():
        raise BadInput(f"{path}: no pixel holds a depth")
    try:
        unit = LengthUnit(header.texts.get(_UNIT_ATTRIBUTE, LengthUnit.PIXEL.value))
    except ValueError as problem:
        raise BadInput(f"{path}: unknown length unit '{header.texts[_UNIT_ATTRIBUTE]}'") from problem
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


def _png_from_normals(stored: FloatArray, mask: Mask) -> UInt16Array:
    rgba = np.zeros((*mask.shape, 4), dtype=np.uint16)
    rgba[..., :3] = np.rint(np.clip((stored + 1.0) * (65535 / 2), 0, 65535))
    rgba[~mask, :3] = 32768
    rgba[..., 3] = np.where(mask, 65535, 0)
    return rgba


def half_planes_from_normals(normal_map: NormalMap, signs: tuple[float, float, float]) -> FloatArray:
    """Return (4, h, w) float16: n_x, n_y, n_z, each times its sign (1 or -1); the weight, 0 where invalid.

    Of a map with expected errors, (5, h, w): then these, in degrees.
    """
    weight, error = normal_map.weight, normal_map.error_deg
    planes = np.empty((4 if error is None else 5, *normal_map.shape), dtype=np.float16)
    planes[:3] = np.moveaxis(_halves(np.asarray(normal_map.normals_in_camera), (*signs, 1.0)), 2, 0)
    weight = normal_map.mask.view(np.uint8) if weight is None else np.where(normal_map.mask, weight, 0)
    planes[3] = _halves(weight)
    if error is not None:
        planes[4] = _halves(np.asarray(error))
    return planes


def _halves(values: Array, factors: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)) -> Array:
    """Return products with a factor a channel as float16, rounded as by numpy, in a tenth of its time."""
    return np.asarray(cv2.multiply(values, np.array(factors), dtype=cv2.CV_16F))

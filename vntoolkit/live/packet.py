"""One live result as bytes for the page: a depth grid, normals and the camera's picture, as large as it asks.

A packet is the length of its header (uint32, little-endian, a multiple of 4), the header as JSON, and behind
it, in this order: depth as uint16 steps (65535: none), normals and camera as RGBA. Nothing is compressed: the
page mostly runs on the machine that films, where compressing costs both sides more than copying.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.conventions import NormalConvention, graphics_from_camera
from vntoolkit.live.sources import TimedFrame
from vntoolkit.meshing.surface import MeshOptions

_NONE = 65535  # depth step of a pixel without depth
_CLIPPED = (255, 0, 255, 255)
_JUMP = MeshOptions().largest_step
_MOST_PX = 4096
_LOOKED_AT = 4  # every so many pixels, for the box


@dataclass(frozen=True, kw_only=True)
class PacketSizes:
    """Longest sides in pixels of what is sent: the grid of the surface, the normals, the camera's picture."""

    grid: int = 80
    normals: int = 320
    camera: int = 240

    def __post_init__(self) -> None:
        if not all(2 <= side <= _MOST_PX for side in (self.grid, self.normals, self.camera)):
            raise BadInput(f"live page: expected sizes from 2 to {_MOST_PX} pixels")


@dataclass(frozen=True, kw_only=True)
class Place:
    """Where the surface stands: centre and size (x, y, z) of the first one's box, in the graphics frame."""

    centre: tuple[float, ...]
    size: tuple[float, ...]

    @classmethod
    def of(cls, depth_map: DepthMap, camera: Camera) -> Place:
        """Return the place of a depth map, which needs one valid pixel."""
        step = _LOOKED_AT if depth_map.mask[::_LOOKED_AT, ::_LOOKED_AT].any() else 1
        rows, columns = (step * places for places in np.nonzero(depth_map.mask[::step, ::step]))
        pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
        points = graphics_from_camera(camera.unproject(pixels, depth_map.depth[rows, columns]))
        low, high = points.min(axis=0), points.max(axis=0)
        return cls(centre=tuple(((low + high) / 2).tolist()), size=tuple((high - low).tolist()))


def packet(header: dict[str, Any], blocks: list[npt.NDArray[Any]]) -> bytes:
    """Return header and blocks as one packet."""
    text = json.dumps(header, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join([struct.pack("<I", len(text)), text, *(block.tobytes() for block in blocks)])


def depth_block(
    depth_map: DepthMap, camera: Camera, longest_px: int
) -> tuple[dict[str, Any], npt.NDArray[np.uint16]]:
    """Return what the page must know of the grid, and its depth in steps between the nearest and furthest.

    Padded to an even number, so that what follows it begins at a multiple of four bytes.
    """
    stride = _stride(depth_map.shape, longest_px)
    depth, mask = depth_map.depth[::stride, ::stride], depth_map.mask[::stride, ::stride]
    known = depth[mask]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = max(high - low, 1e-12) / (_NONE - 1)
    steps = np.full(depth.size + depth.size % 2, _NONE, np.uint16)
    steps[: depth.size][mask.ravel()] = ((known - low) / step).round()
    pixel_width = stride / camera.matrix[0, 0] * ((low + high) / 2 if camera.is_perspective else 1.0)
    facts = {
        "shape": depth.shape,
        "low": low,
        "step": step,
        "focal": [camera.matrix[0, 0] / stride, camera.matrix[1, 1] / stride],
        "centre": [camera.matrix[0, 2] / stride, camera.matrix[1, 2] / stride],
        "perspective": camera.is_perspective,
        "jump": _JUMP * abs(pixel_width) / step,
    }
    return facts, steps


def normals_block(normal_map: NormalMap, longest_px: int) -> npt.NDArray[np.uint8]:
    """Return the usual colours (h, w, 4): red to the right, green up, blue to the viewer; 0 where none."""
    stride = _stride(normal_map.shape, longest_px)
    normals, mask = (
        normal_map.normals_in_camera[::stride, ::stride],
        normal_map.mask[::stride, ::stride],
    )
    block = np.zeros((*mask.shape, 4), np.uint8)
    scale = 127.5 * np.array(NormalConvention.OPENGL.signs, np.float32)
    block[..., :3] = (normals * scale + 127.5) * mask[..., None]
    block[..., 3] = mask * np.uint8(255)
    return block


def camera_block(timed: TimedFrame, longest_px: int) -> npt.NDArray[np.uint8]:
    """Return the camera's picture (h, w, 4), what is clipped painted over."""
    values = timed.frame.values
    stride = _stride(values.shape[:2], longest_px)
    small = values[::stride, ::stride]
    if small.dtype == np.uint16:
        small = small >> (timed.frame.bits - 8)
    elif small.dtype != np.uint8:
        small = 255 * np.clip(small, 0, 1)
    block = np.full((*small.shape[:2], 4), 255, np.uint8)
    block[..., :3] = small
    red, green, blue = (block[..., channel] == 255 for channel in range(3))
    block[red | green | blue] = _CLIPPED
    return block


def _stride(shape: tuple[int, ...], longest_px: int) -> int:
    return max(1, -(-max(shape) // longest_px))

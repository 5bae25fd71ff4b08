"""The 3-D page of `view`, `view --html` and `live`: its text, and the packets that it draws.

A packet is the length of its header (uint32, little-endian, a multiple of 4), the header as JSON, and blocks
behind it, to which the header refers by their places, multiples of 4. A header holds `pictures` by name, each
raw RGBA or an image file, `own`, a grid of depths, and `registered`, the vertices of a moving mesh, as far as
the frame has them; for the faces of that mesh, the same in all frames, there is a packet with `mesh`.
"""

import json
import struct
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from vntoolkit.arrays import Array, ByteArray, FloatArray, IntArray, Points, UInt16Array
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.options.depth import MeshOptions
from vntoolkit.options.export import NormalConvention
from vntoolkit.report.rendering import rendered, scene_policy, scene_text

_NONE = 65535  # depth step of a pixel without depth
_STEPS = 65535
_ZERO = 128  # where there is no normal: colours that are blended with it keep their direction
_LOOKED_AT = 4  # every so many pixels, for the box


class Packet:
    """A packet in the making: blocks are added, and their places go into the header."""

    def __init__(self) -> None:
        self._blocks: list[bytes] = []
        self._size = 0

    def add(self, block: Array | bytes) -> int:
        """Add a block; return its place."""
        content = block if isinstance(block, bytes) else np.ascontiguousarray(block).tobytes()
        place, padding = self._size, -len(content) % 4
        self._blocks += [content, b"\0" * padding]
        self._size += len(content) + padding
        return place

    def raw_picture(self, rgba: ByteArray) -> dict[str, Any]:
        """Add a picture (h, w, 4) as it is; return what the header says of it."""
        return {"at": self.add(rgba), "shape": rgba.shape[:2]}

    def picture_file(self, content: bytes, kind: str) -> dict[str, Any]:
        """Add the bytes of an image file, of a MIME type; return what the header says of it."""
        return {"at": self.add(content), "bytes": len(content), "type": kind}

    def content(self, header: Mapping[str, Any]) -> bytes:
        """Return header and blocks as one packet."""
        text = json.dumps(header, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        return b"".join([struct.pack("<I", len(text)), text, *self._blocks])


def depth_block(
    depth_map: DepthMap, camera: Camera, stride: int, largest_step: float = MeshOptions().largest_step
) -> tuple[dict[str, Any], UInt16Array]:
    """Return what the page must know of every stride-th depth, and these as steps from nearest to furthest.

    largest_step: pixel widths that neighbours may lie apart in depth, as for `mesh_from_depth`.
    """
    depth, mask = depth_map.depth[::stride, ::stride], depth_map.mask[::stride, ::stride]
    known = depth[mask]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    step = max(high - low, 1e-12) / (_NONE - 1)
    steps = np.full(depth.shape, _NONE, np.uint16)
    steps[mask] = ((known - low) / step).round()
    pixel_width = stride / camera.matrix[0, 0] * ((low + high) / 2 if camera.is_perspective else 1.0)
    facts = {
        "shape": depth.shape,
        "stride": stride,
        "width": camera.width,
        "height": camera.height,
        "low": low,
        "step": step,
        "focal": [camera.matrix[0, 0] / stride, camera.matrix[1, 1] / stride],
        "centre": [camera.matrix[0, 2] / stride, camera.matrix[1, 2] / stride],
        "perspective": camera.is_perspective,
        "jump": largest_step * abs(pixel_width) / step,
    }
    return facts, steps


def normals_block(normal_map: NormalMap, stride: int = 1) -> ByteArray:
    """Return the usual colours (h, w, 4): red is right, green up, blue to the viewer; clear where none."""
    normals, mask = normal_map.normals_in_camera[::stride, ::stride], normal_map.mask[::stride, ::stride]
    block = np.full((*mask.shape, 4), _ZERO, np.uint8)
    scale = 127.5 * np.array(NormalConvention.OPENGL.signs, np.float32)
    block[..., :3] = np.where(mask[..., None], normals * scale + 127.5, _ZERO)
    block[..., 3] = mask * np.uint8(255)
    return block


def vertices_block(vertices: Points) -> tuple[dict[str, Any], UInt16Array]:
    """Return the vertices (n, 3), in the camera frame, as steps of their box in the graphics frame."""
    points = graphics_from_camera(np.asarray(vertices, dtype=np.float64))
    low, high = points.min(axis=0), points.max(axis=0)
    step = np.maximum(high - low, 1e-12) / _STEPS
    return {"low": low.tolist(), "step": step.tolist()}, np.rint((points - low) / step).astype(np.uint16)


def errors_block(uncertainty_px: FloatArray, lost_px: float) -> ByteArray:
    """Return expected errors (n,) as bytes, of which 255 is lost_px and more."""
    return np.rint(255 * np.clip(uncertainty_px / lost_px, 0.0, 1.0)).astype(np.uint8)


def mesh_packet(mesh: Mesh, wires: Mesh, kept: IntArray) -> bytes:
    """Return what all frames of a registered mesh share.

    wires: a coarser mesh, of which the edges are drawn; kept: (k,) its vertices' places among the mesh's.
    """
    packet, shown = Packet(), kept[np.asarray(wires.faces)]
    edges = np.sort(shown[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges = np.unique(edges, axis=0)
    uv: FloatArray = np.zeros((len(mesh.vertices), 2)) if mesh.uv is None else np.array(mesh.uv)
    uv[:, 1] = 1 - uv[:, 1]  # the page counts rows downwards
    entry = {
        "vertices": len(mesh.vertices),
        "faces": {"at": packet.add(np.asarray(mesh.faces).astype("<u4")), "count": 3 * len(mesh.faces)},
        "wires": {"at": packet.add(edges.astype("<u4")), "count": 2 * len(edges)},
        "uv": {"at": packet.add(np.rint(uv.clip(0, 1) * _STEPS).astype("<u2"))},
    }
    return packet.content({"mesh": entry})


def depth_box(depth_map: DepthMap, camera: Camera) -> FloatArray:
    """Return the lowest and highest x, y, z (2, 3), in the graphics frame, of a map with a valid pixel."""
    step = _LOOKED_AT if depth_map.mask[::_LOOKED_AT, ::_LOOKED_AT].any() else 1
    rows, columns = (step * places for places in np.nonzero(depth_map.mask[::step, ::step]))
    pixels = np.stack([columns, rows], axis=-1).astype(np.float64)
    return vertex_box(camera.unproject(pixels, depth_map.depth[rows, columns]))


def vertex_box(vertices: Points) -> FloatArray:
    """Return the lowest and highest x, y, z (2, 3), in the graphics frame, of points in the camera's."""
    points = graphics_from_camera(np.asarray(vertices, dtype=np.float64))
    return np.stack([points.min(axis=0), points.max(axis=0)])


def place_of(boxes: Iterable[FloatArray]) -> dict[str, list[float]]:
    """Return where the surface stands: centre and size of what holds all these boxes."""
    every = np.array(list(boxes))
    low, high = every[:, 0].min(axis=0), every[:, 1].max(axis=0)
    return {"centre": ((low + high) / 2).tolist(), "size": (high - low).tolist()}


def stride_to(shape: tuple[int, ...], longest_px: int) -> int:
    """Return the stride at which a map's longer side has at most so many pixels."""
    return max(1, -(-max(shape[:2]) // longest_px))


def scene_page(title: str, mode: str, setup: Mapping[str, Any]) -> str:
    """Return the page as HTML, script and style inside.

    mode: `file`, `view` or `live`. setup: what the script must know; `records`: the page has a button for it,
    `captured`: surfaces can be painted in the captured colours; `lost_px`: frames of the registered surface
    have `errors`, bytes of which 255 is that many pixels and more; `findings`: what was found wrong, lines.
    """
    known = {name: setup.get(name, False) for name in ("records", "captured")}
    known |= {"lost_px": setup.get("lost_px"), "findings": setup.get("findings", ())}
    told = {"mode": mode, **known, **setup}
    return rendered(
        "scene.html.j2",
        **{
            **told,
            "title": title,
            "setup": json.dumps(told, separators=(",", ":")).replace("<", "\\u003c"),  # no end of the script
            "style": scene_text("scene.css"),
            "script": scene_text("scene.js"),
            "policy": scene_policy() if mode == "file" else None,
        },
    )

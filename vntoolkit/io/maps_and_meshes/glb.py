"""GLB for short clips: one glTF 2.0 mesh whose frames are morph targets, played by an animation.

Written by hand: the file is one JSON chunk and one binary chunk. Each frame is a target, so a long clip
belongs into USD. Bones are not written: the vertices carry the whole motion.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit import __version__
from vntoolkit.arrays import Points
from vntoolkit.checks import require_finite, require_positive, require_shape
from vntoolkit.errors import BadMesh, CannotWrite
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.conventions import graphics_from_camera

MAX_BYTES = 512 * 2**20  # browsers and Blender hold the clip whole, and more than once
_FLOAT, _UINT = 5126, 5125
_ARRAY_BUFFER, _INDEX_BUFFER = 34962, 34963
_HEADER = struct.Struct("<4sII")
_CHUNK = struct.Struct("<I4s")
# glTF's default is bare metal, which shows black; captured cloth is one layer, seen from both sides
_MATTE = {
    "name": "Matte",
    "doubleSided": True,
    "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
}


class _Binary:
    """The binary chunk as it grows, with the accessors that describe it."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size = 0
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: npt.NDArray[Any], kind: str, *, target: int | None = None) -> int:
        """Append an array; return the number of its accessor. Every array here is a multiple of 4 bytes."""
        content = np.ascontiguousarray(values).tobytes()
        view: dict[str, Any] = {"buffer": 0, "byteOffset": self.size, "byteLength": len(content)}
        if target is not None:
            view["target"] = target
        accessor = {
            "bufferView": len(self.views),
            "componentType": _UINT if values.dtype == np.uint32 else _FLOAT,
            "count": values.size if kind == "SCALAR" else len(values),
            "type": kind,
        }
        if kind != "VEC2" and target != _INDEX_BUFFER:  # positions and times need their range
            rows = values.reshape(len(values), -1) if kind != "SCALAR" else values.reshape(-1, 1)
            accessor["min"], accessor["max"] = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self.size += len(content)
        if self.size > MAX_BYTES:
            raise CannotWrite(
                f"the clip exceeds {MAX_BYTES // 2**20} MiB as GLB: write .usdc, or fewer frames"
            )
        self.parts.append(content)
        self.views.append(view)
        self.accessors.append(accessor)
        return len(self.accessors) - 1


def write_glb(path: Path | str, template: Mesh, frames: Iterable[Points], *, frame_rate_hz: float) -> int:
    """Write a moving surface of fixed topology, lengths in metres; return the number of frames.

    frames: vertices (n, 3) in the camera frame. Colours go as COLOR_0, texture coordinates as TEXCOORD_0.
    The material is matte and two-sided. Raises `CannotWrite` where the clip exceeds 512 MiB.
    """
    count, parts = _content(template, frames, frame_rate_hz, str(path))
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.writelines(parts)
    return count


def _content(
    template: Mesh, frames: Iterable[Points], frame_rate_hz: float, name: str
) -> tuple[int, list[bytes]]:
    """Return the number of frames, and the file's bytes in pieces."""
    require_positive(frame_rate_hz, f"{name}: frame rate")
    nothing = BadMesh(f"{name}: a GLB needs at least one frame and one triangle")
    if not len(template.faces):
        raise nothing
    binary = _Binary()
    primitive: dict[str, Any] = {"attributes": {}, "mode": 4, "material": 0}
    first: npt.NDArray[np.float32] | None = None
    targets: list[dict[str, int]] = []
    for index, vertices in enumerate(frames):
        require_shape(vertices, (len(template.vertices), 3), f"frame {index}", BadMesh)
        require_finite(vertices, f"frame {index}", BadMesh)
        positions = graphics_from_camera(np.asarray(vertices)).astype(np.float32)
        if first is None:
            first = positions
            _add_surface(binary, primitive, template, first)
        else:
            targets.append({"POSITION": binary.add(positions - first, "VEC3", target=_ARRAY_BUFFER)})
    if first is None:
        raise nothing
    mesh: dict[str, Any] = {"primitives": [primitive]}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"vntoolkit {__version__}"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "name": "Surface"}],
        "meshes": [mesh],
        "materials": [_MATTE],
    }
    if targets:
        primitive["targets"] = targets
        mesh["weights"] = [0.0] * len(targets)
        document["animations"] = [_animation(binary, len(targets), frame_rate_hz)]
    return len(targets) + 1, _pieces(document, binary)


def _add_surface(
    binary: _Binary, primitive: dict[str, Any], template: Mesh, positions: npt.NDArray[np.float32]
) -> None:
    attributes = primitive["attributes"]
    attributes["POSITION"] = binary.add(positions, "VEC3", target=_ARRAY_BUFFER)
    if template.colours is not None:
        colours = np.clip(np.asarray(template.colours, dtype=np.float32), 0, 1)
        attributes["COLOR_0"] = binary.add(colours, "VEC3", target=_ARRAY_BUFFER)
    if template.uv is not None:
        uv = np.array(template.uv, dtype=np.float32)
        uv[:, 1] = 1 - uv[:, 1]  # glTF counts v downwards
        attributes["TEXCOORD_0"] = binary.add(uv, "VEC2", target=_ARRAY_BUFFER)
    primitive["indices"] = binary.add(
        np.asarray(template.faces, dtype=np.uint32).ravel(), "SCALAR", target=_INDEX_BUFFER
    )


def _animation(binary: _Binary, targets: int, frame_rate_hz: float) -> dict[str, Any]:
    """Frame k has the weight of target k − 1 at 1 and all others at 0; frame 0 is the mesh itself."""
    times = (np.arange(targets + 1) / frame_rate_hz).astype(np.float32)
    weights = np.eye(targets + 1, targets, k=-1, dtype=np.float32)
    sampler = {
        "input": binary.add(times, "SCALAR"),
        "output": binary.add(weights.ravel(), "SCALAR"),
        "interpolation": "LINEAR",
    }
    channel = {"sampler": 0, "target": {"node": 0, "path": "weights"}}
    return {"name": "Motion", "channels": [channel], "samplers": [sampler]}


def _pieces(document: dict[str, Any], binary: _Binary) -> list[bytes]:
    document["accessors"] = binary.accessors
    document["bufferViews"] = binary.views
    document["buffers"] = [{"byteLength": binary.size}]
    text = json.dumps(document, separators=(",", ":")).encode("utf-8")
    text += b" " * (-len(text) % 4)
    total = _HEADER.size + 2 * _CHUNK.size + len(text) + binary.size
    return [
        _HEADER.pack(b"glTF", 2, total),
        _CHUNK.pack(len(text), b"JSON") + text,
        _CHUNK.pack(binary.size, b"BIN\0"),
        *binary.parts,
    ]

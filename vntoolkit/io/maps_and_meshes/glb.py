"""GLB: one glTF 2.0 surface, moved by a skin with blend shapes, or by one morph target a frame (short clips).

Written by hand: the file is one JSON chunk and one binary chunk. A clip without skin has every frame as a
target, so a long one belongs into USD.
"""

import json
import struct
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit import __version__
from vntoolkit.arrays import Array, Float32Array, FloatArray, Points, UInt16Array
from vntoolkit.checks import require_finite, require_positive, require_shape
from vntoolkit.errors import BadMesh, CannotWrite
from vntoolkit.geometry.camera import ViewedFrom
from vntoolkit.geometry.mesh import Mesh, require_times, vertex_normals
from vntoolkit.geometry.motion import Motion
from vntoolkit.geometry.skinned_clip import SkinnedClip
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.conventions import graphics_from_camera, motion_with_axes_turned
from vntoolkit.io.maps_and_meshes.texture import SurfaceTexture

MAX_BYTES = 512 * 2**20  # browsers and Blender hold the clip whole, and more than once
_TYPES = {
    np.dtype(np.uint8): 5121,
    np.dtype(np.uint16): 5123,
    np.dtype(np.uint32): 5125,
    np.dtype(np.float32): 5126,
}
_SKIN_BYTES = 28 * 2**20  # of a clip with skin: the blend shapes take what the surface leaves
_INFLUENCES = 8  # of joints on a vertex: two sets of four; some viewers read the first set alone
_FIRST_JOINT = 1  # of the nodes of a clip with skin: node 0 is the cloth
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}  # by the numbers of an element
_ARRAY_BUFFER, _INDEX_BUFFER = 34962, 34963
_NOTHING = "a GLB needs at least one frame and one triangle"
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

    def add(self, values: Array, target: int | None = None, *, normalised: bool = False) -> int:
        """Append an array, a row an element; return the number of its accessor."""
        rows = values.reshape(len(values), -1)
        kind = _KINDS[rows.shape[1]]
        view = self.add_bytes(np.ascontiguousarray(values).tobytes())
        accessor: dict[str, Any] = {
            "bufferView": view,
            "componentType": _TYPES[values.dtype],
            "count": len(values),
            "type": kind,
        }
        if target is not None:
            self.views[view]["target"] = target
        if normalised:
            accessor["normalized"] = True
        if kind in ("VEC3", "SCALAR") and target != _INDEX_BUFFER:  # positions and times need their range
            accessor["min"], accessor["max"] = rows.min(axis=0).tolist(), rows.max(axis=0).tolist()
        self.accessors.append(accessor)
        return len(self.accessors) - 1

    def add_bytes(self, content: bytes) -> int:
        """Append bytes as they are; return the number of their view."""
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(content)})
        self.parts.append(content + b"\0" * (-len(content) % 4))
        self.size += len(self.parts[-1])
        if self.size > MAX_BYTES:
            raise CannotWrite(
                f"the clip exceeds {MAX_BYTES // 2**20} MiB as GLB: write .usdc, or fewer frames"
            )
        return len(self.views) - 1


def write_glb(
    path: Path | str,
    template: Mesh,
    frames: Iterable[Points],
    *,
    frame_rate_hz: float,
    times_s: FloatArray | None = None,
    camera: ViewedFrom | None = None,
    texture: SurfaceTexture | None = None,
) -> int:
    """Write a moving surface of fixed topology, lengths in metres; return the number of frames.

    frames: vertices (n, 3) in the camera frame. times_s: (frames,) of each, rising; None for one every
    1 / frame_rate_hz seconds. Normals are those of each frame. Colours go as COLOR_0, or as
    the texture where there is one, since programs multiply the two. Texture coordinates go as TEXCOORD_0. The
    material is matte and two-sided. Raises `CannotWrite` where the clip exceeds 512 MiB.
    """
    if texture is not None and texture.albedo is not None:
        template = replace(template, colours=None)
    require_positive(frame_rate_hz, f"{path}: frame rate")
    _require_triangles(path, template)
    binary = _Binary()
    primitive: dict[str, Any] = {"attributes": {}, "mode": 4, "material": 0}
    targets: list[dict[str, int]] = []
    first = base = np.empty((0, 3), np.float32)
    count = 0
    for count, vertices in enumerate(frames, start=1):
        require_shape(vertices, (len(template.vertices), 3), f"frame {count - 1}", BadMesh)
        require_finite(vertices, f"frame {count - 1}", BadMesh)
        positions = graphics_from_camera(np.asarray(vertices)).astype(np.float32)
        normals = _normals(positions, template)
        if count == 1:
            first, base = positions, normals
            _add_surface(binary, primitive, replace(template, normals=None), positions)
            continue
        steps = {"POSITION": positions - first, "NORMAL": normals - base}
        targets.append({name: binary.add(step, _ARRAY_BUFFER) for name, step in steps.items()})
    if not count:
        raise BadMesh(f"{path}: {_NOTHING}")
    mesh: dict[str, Any] = {"primitives": [primitive]}
    document = _document(mesh, [{"mesh": 0, "name": "Surface"}], [0], camera, texture, binary)
    if targets:
        primitive["targets"] = targets
        mesh["weights"] = [0.0] * len(targets)
        seconds = np.arange(count) / frame_rate_hz if times_s is None else times_s
        require_times(seconds, count, f"{path}: times")
        # frame k has the weight of target k - 1 at 1 and all others at 0; frame 0 is the mesh itself
        weights = np.eye(count, count - 1, k=-1, dtype=np.float32)
        document["animations"] = [_animation(binary, seconds, [(0, "weights", binary.add(weights.ravel()))])]
    _write(path, document, binary)
    return count


def _require_triangles(path: Path | str, mesh: Mesh) -> None:
    if not len(mesh.faces):
        raise BadMesh(f"{path}: {_NOTHING}")


def write_glb_skin(
    path: Path | str,
    clip: SkinnedClip,
    *,
    camera: ViewedFrom | None = None,
    texture: SurfaceTexture | None = None,
) -> int:
    """Write a skinned surface with its skeleton and animation; return the number of frames.

    Eight joints a vertex, and as many blend shapes as keep the file below 30 MB. Raises `CannotWrite`.
    """
    require_positive(clip.motion.frame_rate_hz, f"{path}: frame rate")
    _require_triangles(path, clip.mesh)
    clip = _of_moderate_size(clip, texture)
    motion = motion_with_axes_turned(clip.motion)
    binary = _Binary()
    mesh = _skinned_mesh(binary, clip)
    nodes = [{"mesh": 0, "skin": 0, "name": "Cloth"}, *_joint_nodes(motion)]
    document = _document(mesh, nodes, [0, _FIRST_JOINT], camera, texture, binary)
    document["skins"] = [_skin(binary, clip)]
    document["animations"] = [_skin_animation(binary, clip, motion)]
    _write(path, document, binary)
    return len(motion)


def _of_moderate_size(clip: SkinnedClip, texture: SurfaceTexture | None) -> SkinnedClip:
    """Return the clip with eight joints a vertex, and as many blend shapes as the surface leaves room for."""
    clip, count = clip.with_influences(_INFLUENCES), len(clip.mesh.vertices)
    surface = 80 * count + 12 * len(clip.mesh.faces)  # bytes of a vertex with all attributes, of a triangle
    if texture is not None:
        surface += texture.normal.stat().st_size
        if texture.albedo is not None:
            surface += texture.albedo.stat().st_size
            clip = replace(clip, mesh=replace(clip.mesh, colours=None))
    return clip.with_shapes(max(0, (_SKIN_BYTES - surface) // (12 * max(count, 1))))


def _skinned_mesh(binary: _Binary, clip: SkinnedClip) -> dict[str, Any]:
    """Add the surface with its joints, weights and blend shapes; return the mesh that refers to them."""
    primitive: dict[str, Any] = {"attributes": {}, "mode": 4, "material": 0}
    positions = graphics_from_camera(np.asarray(clip.mesh.vertices)).astype(np.float32)
    _add_surface(binary, primitive, clip.mesh, positions)
    joints = np.zeros((len(positions), _INFLUENCES), np.uint16)
    joints[:, : clip.joints.shape[1]] = clip.joints
    weights = _whole_weights(clip.weights)
    joints[weights == 0] = 0  # as the standard asks
    attributes = primitive["attributes"]
    for number in range(_INFLUENCES // 4 if weights[:, 4:].any() else 1):
        four = slice(4 * number, 4 * number + 4)
        attributes[f"JOINTS_{number}"] = binary.add(joints[:, four], _ARRAY_BUFFER)
        attributes[f"WEIGHTS_{number}"] = binary.add(weights[:, four], _ARRAY_BUFFER, normalised=True)
    mesh: dict[str, Any] = {"primitives": [primitive], "name": "Cloth"}
    if len(clip.shapes):
        steps = (graphics_from_camera(shape).astype(np.float32) for shape in clip.shapes)
        primitive["targets"] = [{"POSITION": binary.add(step, _ARRAY_BUFFER)} for step in steps]
        mesh["weights"] = clip.shape_weights[0].tolist()
    return mesh


def _joint_nodes(motion: Motion) -> list[dict[str, Any]]:
    """Return the joints as nodes, in the pose of the first frame."""
    nodes, skeleton = [], motion.skeleton
    for joint, name in enumerate(skeleton.names):
        children = (_FIRST_JOINT + np.flatnonzero(skeleton.parents == joint)).tolist()
        place = motion.root_positions[0] if joint == 0 else skeleton.offsets[joint]
        turn = motion.rotations[0, joint]
        node = {
            "name": name,
            "translation": place.tolist(),
            "rotation": (turn / np.linalg.norm(turn)).tolist(),
        }
        nodes.append(node | ({"children": children} if children else {}))
    return nodes


def _skin(binary: _Binary, clip: SkinnedClip) -> dict[str, Any]:
    turn = graphics_from_camera(np.eye(3))
    bind = np.array(clip.rest_from_model)
    bind[:, :3, :3] = turn @ bind[:, :3, :3] @ turn.T
    bind[:, :3, 3] = bind[:, :3, 3] @ turn.T
    inverse = np.linalg.inv(bind)
    inverse[:, 3] = [0, 0, 0, 1]
    columns = inverse.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32)
    return {
        "joints": list(range(_FIRST_JOINT, _FIRST_JOINT + len(bind))),
        "skeleton": _FIRST_JOINT,
        "inverseBindMatrices": binary.add(columns),
    }


def _skin_animation(binary: _Binary, clip: SkinnedClip, motion: Motion) -> dict[str, Any]:
    """Return the turns of the joints, the path of the root, and the weights of the blend shapes."""
    outputs: list[tuple[int, str, int]] = [
        (_FIRST_JOINT + joint, "rotation", binary.add(motion.rotations[:, joint].astype(np.float32)))
        for joint in range(len(motion.skeleton.names))
    ]
    path = binary.add(motion.root_positions.astype(np.float32))
    outputs.append((_FIRST_JOINT, "translation", path))
    if len(clip.shapes):
        sliders = clip.shape_weights.astype(np.float32).ravel()
        outputs.append((0, "weights", binary.add(sliders)))
    return _animation(binary, np.arange(len(motion)) / motion.frame_rate_hz, outputs)


def _whole_weights(weights: Array) -> UInt16Array:
    """Return (n, 8) weights of 65535 in all: the heaviest takes what rounding leaves."""
    whole = np.zeros((len(weights), _INFLUENCES), np.int64)
    whole[:, : weights.shape[1]] = np.floor(weights * 65535)
    whole[:, 0] += 65535 - whole.sum(axis=1)
    return whole.astype(np.uint16)


def _document(
    mesh: dict[str, Any],
    nodes: list[dict[str, Any]],
    roots: list[int],
    camera: ViewedFrom | None,
    texture: SurfaceTexture | None,
    binary: _Binary,
) -> dict[str, Any]:
    """Return the file's description, but for its animations."""
    material = dict(_MATTE)
    scene: dict[str, Any] = {"nodes": roots}
    document: dict[str, Any] = {
        "asset": {"version": "2.0", "generator": f"vntoolkit {__version__}"},
        "scene": 0,
        "scenes": [scene],
        "nodes": nodes,
        "meshes": [mesh],
        "materials": [material],
    }
    if texture is not None:
        document |= _images(texture, material, binary)
    if camera is not None:
        lens = {
            "yfov": camera.vertical_angle_rad,
            "aspectRatio": camera.aspect_ratio,
            "znear": 0.01,
        }
        document["cameras"] = [{"type": "perspective", "perspective": lens}]
        turned = np.eye(4)
        turned[:3, :3], turned[:3, 3] = camera.file_axes(), graphics_from_camera(camera.position)
        nodes.append({"name": "Camera", "camera": 0, "matrix": turned.T.ravel().tolist()})
        offset = graphics_from_camera(camera.offset).round(9).tolist()  # of the capture's origin in this file
        scene |= {"nodes": [*roots, len(nodes) - 1], "extras": {"vntoolkit_offset": offset}}
    return document


def _images(texture: SurfaceTexture, material: dict[str, Any], binary: _Binary) -> dict[str, Any]:
    """Embed the textures, and let the material show them."""
    files = [file for file in (texture.albedo, texture.normal) if file is not None]
    images = [{"bufferView": binary.add_bytes(file.read_bytes()), "mimeType": "image/png"} for file in files]
    looks = dict(material["pbrMetallicRoughness"])
    if texture.albedo is not None:
        looks["baseColorTexture"] = {"index": 0}
    material["normalTexture"] = {"index": len(images) - 1}
    material["pbrMetallicRoughness"] = looks
    return {
        "images": images,
        "samplers": [{"wrapS": 33071, "wrapT": 33071}],
        "textures": [{"source": number, "sampler": 0} for number in range(len(images))],
    }


def _normals(positions: Float32Array, template: Mesh) -> Float32Array:
    """Return (n, 3) unit vertex normals; where a vertex has no triangle, towards the viewer."""
    normals = vertex_normals(positions, template.faces)
    normals[np.linalg.norm(normals, axis=1) < 0.5] = [0.0, 0.0, 1.0]
    return normals.astype(np.float32)


def _add_surface(binary: _Binary, primitive: dict[str, Any], template: Mesh, positions: Float32Array) -> None:
    attributes = primitive["attributes"]
    attributes["POSITION"] = binary.add(positions, _ARRAY_BUFFER)
    normals = _normals(positions, template)
    if template.normals is not None:
        given = graphics_from_camera(np.asarray(template.normals)).astype(np.float32)
        normals = np.where(np.abs(np.linalg.norm(given, axis=1, keepdims=True) - 1) < 1e-3, given, normals)
    attributes["NORMAL"] = binary.add(normals, _ARRAY_BUFFER)
    if template.colours is not None:
        colours = np.clip(np.asarray(template.colours, dtype=np.float32), 0, 1)
        attributes["COLOR_0"] = binary.add(colours, _ARRAY_BUFFER)
    if template.uv is not None:
        uv = np.array(template.uv, dtype=np.float32)
        uv[:, 1] = 1 - uv[:, 1]  # glTF counts v downwards
        attributes["TEXCOORD_0"] = binary.add(uv, _ARRAY_BUFFER)
    primitive["indices"] = binary.add(np.asarray(template.faces, dtype=np.uint32).ravel(), _INDEX_BUFFER)


def _animation(binary: _Binary, times_s: FloatArray, outputs: list[tuple[int, str, int]]) -> dict[str, Any]:
    """Return an animation. outputs: node, what of it moves, and the accessor of its values."""
    times = binary.add(np.asarray(times_s, dtype=np.float32))
    return {
        "name": "Motion",
        "samplers": [
            {"input": times, "output": accessor, "interpolation": "LINEAR"} for *_, accessor in outputs
        ],
        "channels": [
            {"sampler": number, "target": {"node": node, "path": path}}
            for number, (node, path, _) in enumerate(outputs)
        ],
    }


def _write(path: Path | str, document: dict[str, Any], binary: _Binary) -> None:
    document["accessors"] = binary.accessors
    document["bufferViews"] = binary.views
    document["buffers"] = [{"byteLength": binary.size}]
    text = json.dumps(document, separators=(",", ":")).encode("utf-8")
    text += b" " * (-len(text) % 4)
    total = _HEADER.size + 2 * _CHUNK.size + len(text) + binary.size
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        file.write(_HEADER.pack(b"glTF", 2, total))
        file.write(_CHUNK.pack(len(text), b"JSON") + text)
        file.write(_CHUNK.pack(binary.size, b"BIN\0"))
        file.writelines(binary.parts)

"""A reconstruction as one offline page: turn it, light it, play it; nothing is fetched, nothing installed.

viser's own static page replays a recorded scene but leaves its controls out, so no light could be dragged;
hence a page of our own, of plain WebGL.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, IntArray, Points
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import write_text
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.footage.images import encoded_image, resized_image
from vntoolkit.meshing.surface import MeshOptions, mesh_from_depth
from vntoolkit.native import import_open3d
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report.page import data_uri
from vntoolkit.report.pictures import picture_of_normals, pictures_of_frame
from vntoolkit.report.samples_section import sampled

_WEBP_QUALITY = 88
_STEPS = 65535
_ZLIB_LEVEL = 6
_WIRE_VERTICES = 3000  # a wire a pixel would look solid
_CHECKS = (32, 24)  # cells across and down the template's picture
_CHECK_COLOURS = np.array([[0.85, 0.82, 0.78], [0.62, 0.13, 0.08]], np.float32)


@dataclass(frozen=True, kw_only=True)
class SceneOptions:
    """How much of a reconstruction goes into an offline page.

    vertices: most vertices of a frame's mesh on the page of --html; finer ones are thinned. picture_px:
    longest side of that page's pictures, pixels. most_frames: most frames on that page, evenly spread over
    those there are; 12,000 vertices and four pictures of 640 pixels take about 0.3 MB a frame.
    """

    vertices: int = 12_000
    picture_px: int = 640
    most_frames: int = 150

    def __post_init__(self) -> None:
        if self.vertices < 4 or self.picture_px < 1 or self.most_frames < 1:
            raise BadInput("scene: expected at least 4 vertices, one pixel and one frame")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Frame:
    """own: vertices of the frame's mesh, topology: its faces and uv as packed. registered: vertices."""

    number: int
    pictures: dict[str, str]
    own: Points | None
    topology: dict[str, str]
    registered: Points | None


def write_scene(
    path: Path,
    result: OpenedResult,
    options: SceneOptions | None = None,
    on_frame: Callable[[], None] = lambda: None,
) -> None:
    """Write the page of the opened frames, atomically. Raises `BadInput` where they have no depth."""
    options = options or SceneOptions()
    track = result.track
    thin = None if track is None else thinned_template(track.sequence.template, options.vertices)
    frames = []
    for number in sampled(result.numbers, options.most_frames):
        moved = None
        if track is not None and thin is not None and number in track.numbers:
            moved = np.array(track.sequence.vertices[track.numbers.index(number)])[thin.kept]
        own = _own_mesh(result, number, options)
        if own is None and moved is None:
            raise BadInput(f"{result.folder.root}: frame {number} has no depth; reconstruct with --to depth")
        frames.append(
            _Frame(
                number=number,
                pictures=_pictures(result, number, options),
                own=None if own is None else own.vertices.astype(np.float32),
                topology={} if own is None else _topology(own),
                registered=moved,
            )
        )
        on_frame()
    scene = _scene(result, frames, None if thin is None else thin.mesh)
    _write(path, f"{Path(result.manifest.input.source).name}, {counted(len(frames))}", scene)


def counted(frames: int) -> str:
    """Return "1 frame" or "7 frames"."""
    return f"{frames} frame" + ("" if frames == 1 else "s")


def _own_mesh(result: OpenedResult, number: int, options: SceneOptions) -> Mesh | None:
    depth_map = result.depth(number)
    if depth_map is None:
        return None
    stride = max(1, int(np.ceil(np.sqrt(depth_map.mask.sum() / options.vertices))))
    step = result.manifest.options.get("meshing.largest_step", MeshOptions().largest_step)
    return mesh_from_depth(
        depth_map, result.camera, options=MeshOptions(stride=stride, largest_step=float(step))
    )


def _pictures(result: OpenedResult, number: int, options: SceneOptions) -> dict[str, str]:
    """Return the frame's pictures as URIs; labels stay sharp, since mixed colours would mean other lights."""
    uris = {}
    for name, picture in pictures_of_frame(result, number, ground=20, beside_normals=127).items():
        sharp = name == "shadows"
        suffix = ".png" if sharp else ".webp"
        small = resized_image(picture, options.picture_px, smooth=not sharp)
        uris[name] = data_uri(encoded_image(small, suffix, quality=_WEBP_QUALITY), suffix)
    return uris


def _scene(result: OpenedResult, frames: list[_Frame], template: Mesh | None) -> dict[str, Any]:
    """Return the page's data; positions as 16-bit steps of the box around all frames, its largest side 1."""
    clouds = [f.own for f in frames if f.own is not None]
    clouds += [f.registered for f in frames if f.registered is not None]
    ends = graphics_from_camera(np.array([[cloud.min(axis=0), cloud.max(axis=0)] for cloud in clouds]))
    low, high = ends.min(axis=(0, 1)).astype(np.float64), ends.max(axis=(0, 1))
    extent = np.maximum(high - low, 1e-9)

    def packed(vertices: Points) -> str:
        shares = (graphics_from_camera(np.asarray(vertices, dtype=np.float64)) - low) / extent
        return _packed(np.rint(shares.clip(0, 1) * _STEPS).astype("<u2"))

    scene: dict[str, Any] = {
        "rate": result.manifest.input.frame_rate_hz * len(frames) / len(result.numbers),
        "size": (extent / extent.max()).tolist(),
        "hasNormals": "normals" in frames[0].pictures,
        "frames": [
            {
                "number": f.number,
                "pictures": f.pictures,
                "own": None if f.own is None else {"positions": packed(f.own), **f.topology},
            }
            for f in frames
        ],
        "registered": None,
    }
    if template is not None and all(f.registered is not None for f in frames):
        assert result.track is not None
        numbers = [f.number for f in frames]
        nearest = int(np.argmin(np.abs(np.array(numbers) - result.track.template)))
        scene["registered"] = {
            "template": nearest,
            "frames": [packed(f.registered) for f in frames if f.registered is not None],
            **_topology(template),
        }
    return scene


def _topology(mesh: Mesh) -> dict[str, str]:
    uv: FloatArray = np.zeros((len(mesh.vertices), 2)) if mesh.uv is None else np.asarray(mesh.uv)
    return {
        "faces": _packed(np.diff(mesh.faces, axis=0, prepend=0).astype("<i4")),  # packs well
        "uv": _packed(np.rint(uv.clip(0, 1) * _STEPS).astype("<u2")),
    }


def _packed(values: npt.NDArray[Any]) -> str:
    packed = zlib.compress(np.ascontiguousarray(values).tobytes(), _ZLIB_LEVEL)
    return base64.b64encode(packed).decode("ascii")


def _write(path: Path, title: str, scene: dict[str, Any]) -> None:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("vntoolkit.report"), autoescape=True, undefined=StrictUndefined
    )
    script = (files("vntoolkit.report") / "templates" / "scene.js").read_text("utf-8")
    data = json.dumps(scene, separators=(",", ":")).replace("<", "\\u003c")  # no end of the script in it
    write_text(path, environment.get_template("scene.html.j2").render(title=title, scene=data, script=script))


class Look(Enum):
    """How the mesh is painted; plaster and checkerboard are lit by the light that one drags."""

    PLASTER = "relit plaster"
    CAPTURED = "captured colours"
    NORMALS = "normals"
    CHECKERBOARD = "checkerboard"


class Surface(Enum):
    """Before and after registration."""

    OWN = "of each frame"
    REGISTERED = "registered"


class ResultSurfaces:
    """Reads the meshes of an opened result, one frame at a time."""

    def __init__(self, result: OpenedResult) -> None:
        self._result = result
        self._thinned: ThinnedTemplate | None = None

    def kinds(self) -> list[Surface]:
        """Return which surfaces there are."""
        own, track = self._result.length_unit is not None, self._result.track is not None
        return [s for s, there in ((Surface.OWN, own), (Surface.REGISTERED, track)) if there]

    def mesh(self, number: int, surface: Surface) -> Mesh:
        """Return the surface in a frame; its own one where the registered one has none. Raises `BadInput`."""
        track = self._result.track
        if surface is Surface.REGISTERED and track is not None and number in track.numbers:
            return track.mesh(number)
        mesh = self._result.mesh(number)
        if mesh is not None:
            return mesh
        depth_map = self._result.depth(number)
        if depth_map is None:
            root = self._result.folder.root
            raise BadInput(f"{root}: frame {number} has no depth; run `vntoolkit reconstruct --to depth`")
        return mesh_from_depth(depth_map, self._result.camera)

    def wires(self, number: int, surface: Surface) -> Mesh:
        """Return a mesh coarse enough to see through."""
        track, depth_map = self._result.track, self._result.depth(number)
        if surface is Surface.REGISTERED and track is not None and number in track.numbers:
            if self._thinned is None:
                self._thinned = thinned_template(track.sequence.template, _WIRE_VERTICES)
            return replace(
                self._thinned.mesh, vertices=track.mesh(number).vertices[self._thinned.kept], normals=None
            )
        if depth_map is None:
            return self.mesh(number, surface)
        stride = max(1, int(np.ceil(np.sqrt(depth_map.mask.sum() / _WIRE_VERTICES))))
        return mesh_from_depth(depth_map, self._result.camera, options=MeshOptions(stride=stride))

    def colours(self, mesh: Mesh, number: int, surface: Surface, look: Look) -> npt.NDArray[np.float32]:
        """Return linear vertex colours; texture coordinates say which pixel of the picture a vertex shows."""
        camera, track = self._result.camera, self._result.track
        uv = mesh.uv
        if uv is None:  # meshes read back carry none: project
            pixels = camera.project(mesh.vertices)
            uv = np.stack([(pixels[:, 0] + 0.5) / camera.width, 1 - (pixels[:, 1] + 0.5) / camera.height], -1)
        if look is Look.CHECKERBOARD:
            cells = np.floor(np.asarray(uv) * _CHECKS).astype(int).sum(axis=1)
            return np.asarray(_CHECK_COLOURS[cells % 2])
        source = track.template if surface is Surface.REGISTERED and track is not None else number
        normal_map = self._result.normals(source)
        picture = self._result.picture(source) if look is Look.CAPTURED else None
        if picture is None:
            assert normal_map is not None
            picture = picture_of_normals(normal_map)
        u = np.clip(np.rint(uv[:, 0] * camera.width - 0.5).astype(int), 0, camera.width - 1)
        v = np.clip(np.rint((1 - uv[:, 1]) * camera.height - 0.5).astype(int), 0, camera.height - 1)
        return np.asarray((picture[v, u] / np.float32(255)) ** np.float32(2.2), dtype=np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class ThinnedTemplate:
    """kept: indices of the vertices of the full template that remain, in the order of `mesh`."""

    kept: IntArray
    mesh: Mesh


# Fewer vertices of a moving surface, the same ones in every frame.


def thinned_template(template: Mesh, largest: int) -> ThinnedTemplate:
    """Return at most about `largest` vertices of a template, cuts and borders kept.

    Quadric decimation chooses triangles; each of their corners then moves to the nearest true vertex, which
    has a position in every frame. Triangles that lose a corner by that are dropped.
    """
    count = len(template.vertices)
    if count <= largest:
        return ThinnedTemplate(kept=np.arange(count), mesh=template)
    o3d = import_open3d()
    plain = Mesh(vertices=template.vertices, faces=template.faces).to_open3d()
    target = max(4, round(len(template.faces) * largest / count))
    few = plain.simplify_quadric_decimation(target)
    tree = o3d.geometry.KDTreeFlann(plain)
    nearest = np.array([tree.search_knn_vector_3d(point, 1)[1][0] for point in few.vertices], dtype=np.int64)
    faces = nearest[np.asarray(few.triangles)]
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    kept, renumbered = np.unique(faces, return_inverse=True)
    attributes = {
        name: None if getattr(template, name) is None else np.asarray(getattr(template, name))[kept]
        for name in ("normals", "colours", "uv")
    }
    mesh = replace(
        template,
        vertices=np.asarray(template.vertices)[kept],
        faces=renumbered.reshape(-1, 3).astype(np.int32),
        **attributes,
    )
    return ThinnedTemplate(kept=kept, mesh=mesh)

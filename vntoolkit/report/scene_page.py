"""A reconstruction as one offline page: turn it, light it, play it; nothing is fetched, nothing installed.

viser's own static page replays a recorded scene but leaves its controls out, so no light could be dragged;
hence a page of our own, of plain WebGL.
"""

from __future__ import annotations

import base64
import json
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray, Points
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import write_text
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.images import encoded_image, resized_image
from vntoolkit.meshing.surface import MeshOptions, mesh_from_depth
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report.page import data_uri
from vntoolkit.report.pictures import pictures_of_frame
from vntoolkit.report.samples_section import sampled
from vntoolkit.report.thinning import thinned_template

_WEBP_QUALITY = 88
_STEPS = 65535
_ZLIB_LEVEL = 6


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

"""A reconstruction on the 3-D page: whole frames served on demand, or thinned ones in a page to keep."""

import base64
import threading
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import FloatArray, IntArray
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import write_text
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.io.footage.image_writing import encoded_image, resized_image
from vntoolkit.libraries import import_open3d
from vntoolkit.options.depth import MeshOptions
from vntoolkit.options.pages import ScenePageOptions, ViewerOptions
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report import scene
from vntoolkit.report.local_server import LocalServer
from vntoolkit.report.pictures import pictures_of_frame

if TYPE_CHECKING:
    from vntoolkit.pipeline.tracked_folder import Tracks

_WEBP_QUALITY = 88
_PICTURE_PX = 640  # longest side of an offline page's pictures
_SERVED_QUALITY = 92  # of a JPEG
_ZLIB_LEVEL = 6
_WIRE_VERTICES = 3000  # a wire a pixel would look solid
_BOXED_FRAMES = 8  # that the served page is framed by: reading all would keep one waiting
_GROUND = 20


def write_scene(path: Path, result: OpenedResult, options: ScenePageOptions | None = None) -> None:
    """Write the page of the opened frames, atomically. Raises `BadInput` where they have no depth."""
    options = options or ScenePageOptions()
    packed = _ResultScene(result, sampled(result.numbers, options.most_frames), options)
    frames = []
    for index, number in enumerate(progress.counted(packed.numbers, "scene", len(packed.numbers))):
        if not packed.has_surface(number):
            raise BadInput(f"{result.folder.root}: frame {number} has no depth; reconstruct with --to depth")
        frames.append(_folded(packed.frame(index)))
    setup = packed.setup(packed.numbers) | {"frames": frames}
    if "registered" in setup["surfaces"]:
        setup["topology"] = _folded(packed.topology())
    title = f"{Path(result.manifest.input.source).name}, {counted(len(frames))}"
    write_text(path, scene.scene_page(title, "file", setup))


def counted(frames: int) -> str:
    """Return "1 frame" or "7 frames"."""
    return f"{frames} frame" + ("" if frames == 1 else "s")


def _folded(packet: bytes) -> str:
    return base64.b64encode(zlib.compress(packet, _ZLIB_LEVEL)).decode("ascii")


class ResultViewer:
    """Serves an opened result until `close`. Frames are read from disk as they are shown, at full size."""

    def __init__(self, result: OpenedResult, options: ViewerOptions | None = None) -> None:
        """Raises `BadInput` where there is nothing to show, `CannotWrite` for an address that is not ours."""
        self._scene = _ResultScene(result, result.numbers)
        if not self._scene.surfaces:
            raise BadInput(
                f"{result.folder.root}: holds no depth to show; run `vntoolkit reconstruct --to depth`, or "
                "look at the normals by `vntoolkit report`"
            )
        setup = self._scene.setup(sampled(result.numbers, _BOXED_FRAMES))
        name = Path(result.manifest.input.source).name
        self._closed = threading.Event()
        self._reading = threading.Lock()  # one frame at a time, so that memory does not grow with pages
        self._server = LocalServer(
            options or ViewerOptions(),
            scene.scene_page(f"{name}, {counted(len(result.numbers))}", "view", setup),
            {"/frame": self._frame, "/topology": self._topology},
        )
        self.address = self._server.address

    def close(self) -> None:
        """Stop serving."""
        self._closed.set()
        self._server.close()

    def wait(self) -> None:
        """Serve until interrupted."""
        while not self._closed.wait(1.0):
            pass

    def _frame(self, query: Mapping[str, str]) -> bytes | None:
        if self._closed.is_set():
            return None  # a page's connection outlives the listening
        index, grid = int(query["index"]), int(query["grid"])
        if not 0 <= index < len(self._scene.numbers) or grid < 2:
            raise BadInput(
                f"frame: expected an index below {len(self._scene.numbers)} and a grid of 2 or more"
            )
        with self._reading:
            return self._scene.frame(index, surface=query["surface"], grid_px=grid)

    def _topology(self, _query: Mapping[str, str]) -> bytes:
        with self._reading:
            return self._scene.topology()


class _ResultScene:
    """Packs the frames of a result; options: how far they are thinned, None for not at all."""

    def __init__(
        self, result: OpenedResult, numbers: tuple[int, ...], options: ScenePageOptions | None = None
    ) -> None:
        self._result, self.numbers, self._options = result, numbers, options
        self._largest_step = float(
            result.manifest.options.get("meshing.largest_step", MeshOptions().largest_step)
        )

    @cached_property
    def surfaces(self) -> list[str]:
        """What can be shown: the surface of each frame, the registered one."""
        own = self._result.length_unit is not None
        return ["own"] * own + ["registered"] * (self._track is not None)

    def setup(self, boxed: tuple[int, ...]) -> dict[str, Any]:
        """Return what the page must know; it is framed by the frames `boxed`."""
        result, track = self._result, self._track
        at = 0 if track is None else int(np.argmin(np.abs(np.array(self.numbers) - track.template)))
        return {
            "times_s": result.manifest.input.times_of(self.numbers).tolist(),
            "numbers": self.numbers,
            "surfaces": self.surfaces,
            "template": at,
            "place": scene.place_of(box for number in boxed for box in self._boxes(number)),
            "captured": result.picture(self.numbers[0]) is not None,
            "findings": [finding.line for finding in result.findings if finding.level != "note"],
        } | ({} if track is None or track.sequence.uncertainty_px is None else {"lost_px": track.lost_px})

    def has_surface(self, number: int) -> bool:
        """Whether there is anything to show of a frame."""
        tracked = self._track is not None and number in self._track.numbers
        return tracked or self._result.folder.has(number, "depth")

    def frame(self, index: int, *, surface: str = "", grid_px: int | None = None) -> bytes:
        """Return a frame as a packet. surface: only this one; grid_px: longest side of its grid."""
        number, packet = self.numbers[index], scene.Packet()
        header: dict[str, Any] = {"pictures": self._pictures(packet, number)}
        track = self._track
        if track is not None and surface != "own" and number in track.numbers:
            row, uncertainty = track.numbers.index(number), track.sequence.uncertainty_px
            facts, steps = scene.vertices_block(np.asarray(track.sequence.vertices[row])[self._thinned.kept])
            header["registered"] = {"at": packet.add(steps), **facts}
            if uncertainty is not None:
                errors = scene.errors_block(np.asarray(uncertainty[row])[self._thinned.kept], track.lost_px)
                header["registered"]["errors"] = packet.add(errors)
        depth_map = None if surface == "registered" and "registered" in header else self._depth(number)
        if depth_map is not None:
            facts, steps = scene.depth_block(
                depth_map, self._result.camera, self._stride(depth_map, grid_px), self._largest_step
            )
            header["own"] = {"at": packet.add(steps), **facts}
        return packet.content(header)

    def topology(self) -> bytes:
        """Return the packet of what all frames of the registered surface share."""
        wires = thinned_template(self._thinned.mesh, _WIRE_VERTICES)
        return scene.mesh_packet(self._thinned.mesh, wires.mesh, wires.kept)

    @cached_property
    def _track(self) -> "Tracks | None":
        """The registered surface; in a page to keep, only where it is there in every frame."""
        track = self._result.track
        if track is None or not set(self.numbers) & set(track.numbers):
            return None
        return track if self._options is None or set(self.numbers) <= set(track.numbers) else None

    @cached_property
    def _thinned(self) -> "ThinnedTemplate":
        assert self._track is not None
        template = self._track.sequence.template
        count = len(template.vertices) if self._options is None else self._options.vertices
        return thinned_template(template, count)

    def _depth(self, number: int) -> DepthMap | None:
        depth_map = self._result.depth(number)
        return depth_map if depth_map is not None and depth_map.mask.any() else None

    def _stride(self, depth_map: DepthMap, grid_px: int | None) -> int:
        if self._options is None:
            return scene.stride_to(depth_map.shape, grid_px or max(depth_map.shape))
        return max(1, int(np.ceil(np.sqrt(depth_map.mask.sum() / self._options.vertices))))

    def _boxes(self, number: int) -> list[FloatArray]:
        depth_map, track = self._depth(number), self._track
        boxes = [] if depth_map is None else [scene.depth_box(depth_map, self._result.camera)]
        if track is not None and number in track.numbers:
            boxes.append(scene.vertex_box(np.asarray(track.sequence.vertices[track.numbers.index(number)])))
        return boxes

    def _pictures(self, packet: scene.Packet, number: int) -> dict[str, Any]:
        """Add the frame's pictures; labels stay sharp, since mixed colours would mean other lights."""
        pictures = pictures_of_frame(self._result, number, ground=_GROUND)
        pictures["normals"] = scene.normals_block(self._result.normals(number))
        options, entries = self._options, {}
        for name, whole in pictures.items():
            if name == "normals" and options is None:
                entries[name] = packet.raw_picture(whole)  # measured normals light the surface: nothing lost
                continue
            kind = "png" if name in ("shadows", "materials") else "jpg" if options is None else "webp"
            small = whole if options is None else resized_image(whole, _PICTURE_PX, smooth=kind != "png")
            quality = _SERVED_QUALITY if kind == "jpg" else _WEBP_QUALITY
            content = encoded_image(small, f".{kind}", quality=quality)
            entries[name] = packet.picture_file(content, f"image/{kind}".replace("jpg", "jpeg"))
        return entries


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

"""The files that `track` reads and writes: the reconstruction's frames and the folder DIR/track."""

import json
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from vntoolkit.arrays import Colours, FloatArray, Points, VisibilityLabels
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.atomic import atomic_path, write_text
from vntoolkit.io.files import parse_json, read_text
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.maps_and_meshes.arrays import read_npz
from vntoolkit.io.maps_and_meshes.label_images import read_labels
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.results.manifest import read_manifest, result_digest
from vntoolkit.io.results.sequences import remove_mesh_sequence
from vntoolkit.io.rigs import camera_from_content, entry_from_camera, rig_from_entry
from vntoolkit.pipeline.outputs import ReconstructionFolder
from vntoolkit.tracking.remembered import Remembered

_RECORD = "track.json"
_MEMORY_NAME = "remembered.npz"  # of the last frame, for a run that goes on
_VERSION = 1
_IN_WORDS = {"result_sha256": "normals and depth", "frame_rate_hz": "frame rate"}


@dataclass(frozen=True, kw_only=True, eq=False)
class TrackSource:
    """A reconstruction to track.

    numbers: frames asked for, in order; those without files are missing. camera: of the undistorted maps.
    filmed_by: the camera of the footage, with its distortion. digest: of the reconstruction
    (`result_digest`).
    """

    folder: ReconstructionFolder
    camera: Camera
    filmed_by: Camera
    numbers: tuple[int, ...]
    frame_rate_hz: float
    digest: str

    def has(self, number: int) -> bool:
        """Whether the frame's normals and depth are both there."""
        return self.folder.has(number, "normals", "depth")

    def maps(self, number: int) -> tuple[NormalMap, DepthMap]:
        """Read one frame. Raises `BadInput`, as the others do, for a file of another size than the camera."""
        path = self.folder.file("depth", number)
        depth = read_depth_map(path)
        self._require_size(path, depth.shape)
        return self.normals(number), depth

    def labels(self, number: int) -> VisibilityLabels | None:
        """Read which lights reach the pixels of one frame; None where `reconstruct` looked for no shadows."""
        path = self.folder.file("shadows", number)
        if not path.exists():
            return None
        labels = read_labels(path)
        self._require_size(path, labels.shape)
        return labels

    def normals(self, number: int) -> NormalMap:
        """Read one frame's normals."""
        path = self.folder.file("normals", number)
        normals = read_normal_map(path)
        self._require_size(path, normals.shape)
        return normals

    def _require_size(self, path: Path, shape: tuple[int, ...]) -> None:
        height, width = shape
        own = self.camera
        if (width, height) != (own.width, own.height):
            raise BadInput(
                f"{path}: {width}×{height} pixels, but the camera has {own.width}×{own.height}; "
                "remove it and run `vntoolkit reconstruct` again: it makes what is missing"
            )


def open_track_source(root: Path) -> TrackSource:
    """Open a folder that `reconstruct` wrote, up to its last frame on disk. Raises `BadInput`."""
    manifest = read_manifest(root)
    folder = ReconstructionFolder(root=root)
    numbers = tuple(FrameRange.from_text(manifest.frames).numbers(manifest.input.frame_count))
    present = [n for n in numbers if folder.has(n, "normals", "depth")]
    if not present:
        raise BadInput(f"{root}: no frame has both normals and depth; run `vntoolkit reconstruct --to depth`")
    camera = rig_from_entry(manifest.rig).camera
    return TrackSource(
        folder=folder,
        camera=camera.without_distortion(),
        filmed_by=camera,
        numbers=numbers[: numbers.index(present[-1]) + 1],
        frame_rate_hz=manifest.input.playing_rate_hz,
        digest=result_digest(manifest),
    )


def write_track_record(folder: Path, record: dict[str, Any]) -> None:
    """Write DIR/track/track.json: what a resumed run must agree with, and what `evaluate` reads."""
    write_text(folder / _RECORD, json.dumps({"version": _VERSION, **record}, indent=2) + "\n")


def camera_record(camera: Camera) -> dict[str, Any]:
    """Return the camera as track.json holds it, with the keys of rig.json."""
    return entry_from_camera(camera).model_dump(mode="json")


def recorded_camera(record: dict[str, Any]) -> Camera:
    """Return the camera that track.json names: it takes tracked vertices to pixels of the footage."""
    try:
        return camera_from_content(record.get("camera"))
    except BadInput as problem:
        raise BadInput(
            f"{_RECORD}: names no whole camera ({problem}); run `vntoolkit track` again, with --overwrite"
        ) from problem


def read_track_record(folder: Path) -> dict[str, Any]:
    """Read DIR/track/track.json. Raises `BadInput`."""
    path = folder / _RECORD
    if not path.exists():
        raise BadInput(f"{folder}: holds no {_RECORD}; give a folder that `vntoolkit track` has worked on")
    match parse_json(read_text(path), str(path)):
        case {"frames": [*numbers], "template": int()} as record if all(isinstance(n, int) for n in numbers):
            return record
    raise BadInput(f"{path}: expected an object with frames, a list of numbers, and template, a number")


def require_free(folder: Path, record: dict[str, Any], *, overwrite: bool) -> None:
    """Raise `BadInput` where the folder holds tracks made otherwise, naming what changed, or another mesh.

    overwrite: tracks made otherwise may be replaced; what `track` did not write never.
    """
    if not (folder / _RECORD).exists():
        if (folder / "vertices.npy").exists() or (folder / "sequence.json").exists():
            raise BadInput(
                f"{folder}: holds a moving mesh that `vntoolkit track` did not write; choose another --out"
            )
        return
    if overwrite:
        return
    now = json.loads(json.dumps(record))
    unnamed = {"result_sha256": now["result_sha256"], "paint": False}  # a record of before these were kept
    before = unnamed | read_track_record(folder)
    grown = now["frames"][: len(before["frames"])] == before["frames"]
    free = ("frames", "lost_px")
    changed = [key for key in now if key not in free and before.get(key) != now[key]]
    if changed or not grown:
        names = ", ".join(_IN_WORDS.get(key, key) for key in changed or ["frames"])
        raise BadInput(f"{folder}: holds tracks made with other {names}; add --overwrite to replace them")


def clear_track(folder: Path) -> None:
    """Remove what `track` wrote into a folder, and nothing else."""
    if not (folder / _RECORD).exists():
        return
    made = ("albedo.png", "normal.png", "texture.json")
    for name in (
        _RECORD,
        "reflectance.npy",  # of an earlier version
        _MEMORY_NAME,
        "checkerboard.mkv",
        "checkerboard.png",
        *(f"texture/{name}" for name in made),
    ):
        (folder / name).unlink(missing_ok=True)
    with suppress(OSError):  # something else is left
        (folder / "texture").rmdir()
    remove_backwards(folder)
    remove_mesh_sequence(folder)


def remove_backwards(folder: Path) -> None:
    """Remove what was tracked backwards from the template, and is in place now."""
    (folder / "backwards" / _MEMORY_NAME).unlink(missing_ok=True)
    remove_mesh_sequence(folder / "backwards")


def write_remembered(folder: Path, frame_count: int, remembered: Remembered) -> None:
    """Write what is remembered after so many frames of the moving mesh in the folder."""
    with atomic_path(folder / _MEMORY_NAME) as path, path.open("wb") as stream:
        np.savez(stream, frame_count=frame_count, **vars(remembered))


def read_remembered(folder: Path, like: Remembered) -> tuple[int, Remembered]:
    """Return what `write_remembered` wrote, and after how many frames.

    like: of the same template. Where the folder holds none that is whole and of this template: 0, and that.
    """
    path = folder / _MEMORY_NAME
    if not path.exists():
        return 0, like
    try:
        found = {name: read_npz(path, name) for name in vars(like)}
        frame_count = int(read_npz(path, "frame_count"))
        whole = all(
            found[name].shape == array.shape and np.isfinite(found[name]).all()
            for name, array in vars(like).items()
        )
    except (BadInput, TypeError):
        return 0, like
    return (frame_count, replace(like, **found)) if whole else (0, like)


def colours_at(vertices: Points, coloured: Mesh) -> Colours:
    """Return (n, 3): for each vertex the colour of the nearest vertex of a coloured mesh."""
    _, nearest = cKDTree(coloured.vertices).query(np.asarray(vertices), workers=-1)
    colours: Colours = np.asarray(coloured.colours)[nearest]
    return colours


def uv_in_picture(camera: Camera, vertices: Points) -> FloatArray:
    """Return (n, 2): where vertices are in the camera's picture, (0, 0) at its bottom left."""
    u, v = camera.project(np.asarray(vertices)).T
    return np.stack([(u + 0.5) / camera.width, 1 - (v + 0.5) / camera.height], axis=-1)

"""The folder DIR/track that `track` writes, and every later verb reads."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import Points
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.files import read_json
from vntoolkit.io.results.folder import FolderKind, flat
from vntoolkit.io.results.numbered_files import remove_if_empty
from vntoolkit.io.results.sequences import SEQUENCE_FILES, read_mesh_sequence
from vntoolkit.io.rigs import CameraEntry, camera_from_entry
from vntoolkit.options.tracking import LOST_PX

_RECORD = "track.json"
MEMORY_NAME = "remembered.npz"  # of the last frame, for a run that goes on
TRACKS_VERSION = 1
_LOGGER = logging.getLogger(__name__)
_IN_WORDS = {"result_sha256": "normals and depth", "frame_rate_hz": "frame rate"}  # of track.json


@dataclass(frozen=True, kw_only=True, eq=False)
class Tracks:
    """The moving mesh that `track` wrote. record: track.json. numbers: of the frames that are there."""

    folder: Path
    record: Mapping[str, Any]
    sequence: MeshSequence

    @property
    def numbers(self) -> tuple[int, ...]:
        """Numbers of the frames, in order."""
        return tuple(self.record["frames"][: len(self.sequence)])

    @property
    def template(self) -> int:
        """Number of the template's frame."""
        return int(self.record["template"])

    @property
    def camera(self) -> Camera:
        """The camera of the footage, with its distortion: it takes vertices to pixels."""
        return recorded_camera(self.record)

    @property
    def lost_px(self) -> float:
        """Expected error above which a vertex is called lost."""
        return float(self.record.get("lost_px", LOST_PX))

    def mesh(self, number: int) -> Mesh:
        """Return the surface in one frame."""
        return self.sequence[self.numbers.index(number)]

    def with_uv(self, camera: Camera) -> "Tracks":
        """Return these, the template's texture coordinates those of its own frame's picture.

        camera: of that picture. Without the template's frame they stay as they are.
        """
        if self.template_vertices is None:
            return self
        u, v = camera.project(self.template_vertices).T
        uv = np.stack([(u + 0.5) / camera.width, 1 - (v + 0.5) / camera.height], axis=-1)  # from bottom left
        template = replace(self.sequence.template, uv=uv)
        return replace(self, sequence=replace(self.sequence, template=template))

    @cached_property
    def template_vertices(self) -> Points | None:
        """(n, 3), the surface in the template's own frame; None where that is not tracked yet."""
        if self.template not in self.numbers:
            return None
        return np.array(self.sequence.vertices[self.numbers.index(self.template)])


def read_tracks(folder: Path) -> Tracks:
    """Open a folder that `track` wrote, and say where frames are missing at its end. Raises `BadInput`."""
    tracks = Tracks(folder=folder, record=read_track_record(folder), sequence=read_mesh_sequence(folder))
    asked = tracks.record["frames"]
    if len(tracks.sequence) < len(asked):
        _LOGGER.warning(
            "%s: incomplete, holds %d of %d frames; run the same `vntoolkit track` again",
            folder, len(tracks.sequence), len(asked),
        )  # fmt: skip
    return tracks


def recorded_camera(record: Mapping[str, Any]) -> Camera:
    """Return the camera that track.json names: it takes tracked vertices to pixels of the footage."""
    try:
        return camera_from_entry(CameraEntry.read(record.get("camera"), "camera"))
    except BadInput as problem:
        raise BadInput(
            f"{_RECORD}: names no whole camera ({problem}); run `vntoolkit track` again, with --overwrite"
        ) from problem


def read_track_record(folder: Path) -> dict[str, Any]:
    """Read DIR/track/track.json. Raises `BadInput`."""
    path = folder / _RECORD
    if not path.exists():
        raise BadInput(f"{folder}: holds no {_RECORD}; give a folder that `vntoolkit track` has worked on")
    match read_json(path):
        case {"frames": [*numbers], "template": int()} as record if all(isinstance(n, int) for n in numbers):
            return record
    raise BadInput(f"{path}: expected an object with frames, a list of numbers, and template, a number")


def _request(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return what tracks of two runs must agree in."""
    values = flat({k: v for k, v in record.items() if k not in ("version", "lost_px")})
    return {_IN_WORDS.get(name, name): value for name, value in values.items()}


# Folder of what is tracked from the template back, until it is in place.
_BACKWARDS = "backwards"
_MOVING = (*SEQUENCE_FILES, MEMORY_NAME)
TRACKS = FolderKind(
    verb="track",
    holds="tracks",
    record=_RECORD,
    files=(
        *_MOVING,
        *(f"{_BACKWARDS}/{name}" for name in _MOVING),
        "checkerboard.mkv",
        "checkerboard.png",
        "motion.csv",
        "object.csv",
        *(f"texture/{name}" for name in ("albedo.png", "normal.png", "texture.json")),
    ),
    frames={"motion": (".exr",)},
    foreign=("vertices.npy", "sequence.json"),
    request=_request,
    grows=("frames",),
)


def remove_backwards(folder: Path) -> None:
    """Remove what was tracked backwards from the template, and is in place now."""
    for name in _MOVING:
        (folder / _BACKWARDS / name).unlink(missing_ok=True)
    remove_if_empty(folder / _BACKWARDS)

"""One synthetic capture: what is asked for, and where its files go."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadInput, BadMotion
from vntoolkit.io.files import read_text, source_file
from vntoolkit.io.frame_range import FrameRange
from vntoolkit.io.npy import map_npy
from vntoolkit.pipeline.option_values import option_values
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.render import RenderOptions, require_same_topology
from vntoolkit.simulation.scene import Scene, SceneOptions, build_scene

_VERSION = 1


@dataclass(frozen=True, kw_only=True)
class SimulationFolder:
    """The layout of a synthetic capture on disk; frames are numbered by their place in the video."""

    root: Path

    @property
    def video(self) -> Path:
        """The capture itself."""
        return self.root / "capture.mkv"

    @property
    def truth(self) -> Path:
        """Everything that is known about it."""
        return self.root / "truth"

    @property
    def description(self) -> Path:
        """What was asked for; written first."""
        return self.root / "simulation.json"

    def staged(self, place: int) -> Path:
        """A rendered frame that waits for the video to be written; comes last of a frame's files."""
        return self.root / ".frames" / f"{place:06d}.png"

    def map_file(self, kind: str, place: int, suffix: str) -> Path:
        """The file of one frame's normals, depth, mask, visibility or flow."""
        return self.truth / kind / f"{place:06d}{suffix}"


@dataclass(frozen=True, kw_only=True, eq=False)
class SimulationJob:
    """Everything that a worker needs, small enough to send to another process.

    scene: a name in `SCENES`. frames: which of the scene's frames are filmed. motion: .npy file, float
    (frames, n, 3) in the camera frame and metres, that moves the scene's mesh instead of its own motion.
    """

    scene: str
    folder: SimulationFolder
    options: SceneOptions = field(default_factory=SceneOptions)
    nuisances: Nuisances = field(default_factory=Nuisances)
    rendering: RenderOptions = field(default_factory=RenderOptions)
    frames: FrameRange = field(default_factory=FrameRange)
    motion: Path | None = None

    @cached_property
    def built(self) -> Scene:
        """The scene, moved by the motion file where there is one. Raises `BadMotion`, `BadMesh`."""
        scene = build_scene(self.scene, self.options)
        if self.motion is None:
            return scene
        moved = read_motion_file(self.motion)
        require_same_topology(moved[0], scene)
        return replace(
            scene,
            vertices=lambda frame: np.array(moved[frame], np.float64),
            frame_count=len(moved),
            camera_from_object=None,
        )

    @cached_property
    def numbers(self) -> range:
        """The scene's frames that are filmed."""
        return self.frames.numbers(self.built.frame_count)

    def description(self) -> str:
        """Return what shapes the result, as JSON: two runs with the same text give the same bytes."""
        content: dict[str, Any] = {
            "version": _VERSION,
            "scene": self.scene,
            "frames": self.frames.to_text(),
            "motion": None if self.motion is None else asdict(source_file(self.motion)),
            "scene_options": {k: v for k, v in option_values(self.options).items() if v is not None},
            "nuisances": option_values(self.nuisances),
            "samples": self.rendering.samples,
        }
        return json.dumps(content, indent=2) + "\n"


def read_motion_file(path: Path) -> FloatArray:
    """Map a (frames, n, 3) .npy file of vertices into memory. Raises `BadMotion`."""
    moved: FloatArray = map_npy(path, BadMotion)
    if moved.ndim != 3 or moved.shape[2] != 3 or not len(moved) or moved.dtype.kind != "f":
        raise BadMotion(
            f"{path}: expected floating point vertices (frames, n, 3), got {moved.shape} {moved.dtype}"
        )
    return moved


def require_free(folder: SimulationFolder, description: str, overwrite: bool) -> bool:
    """Return whether a run of the same description began here; raise where another one's files are."""
    if not folder.description.exists():
        if folder.video.exists() and not overwrite:
            raise BadInput(f"{folder.root}: holds a capture.mkv already; choose another folder")
        return False
    if overwrite:
        return False
    if read_text(folder.description) != description:
        raise BadInput(
            f"{folder.root}: holds a capture made with other options (see {folder.description.name}); "
            "choose another folder, or add --overwrite"
        )
    return True

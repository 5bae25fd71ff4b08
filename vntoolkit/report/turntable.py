"""A dressed figure to look at: a contact sheet through time, and a turn around it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import IntArray
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.footage.video import write_video
from vntoolkit.pipeline.dress import DressedFigure
from vntoolkit.report.pictures import write_tiles
from vntoolkit.report.raycast_view import View, capsules, picture_of
from vntoolkit.skinning.kinematics import bone_segments, pose_of_frame

_BONE_COLOUR = (0.18, 0.30, 0.62)
_CLOTH_COLOUR = (0.80, 0.45, 0.32)
_FLOOR_COLOUR = (0.80, 0.82, 0.84)
_BONE_RADIUS = 0.013  # of the figure's height
_FLOOR_SAMPLES = 50
_MARGIN = 1.25  # height of the picture over the figure's


@dataclass(frozen=True, kw_only=True)
class PreviewOptions:
    """How the preview looks.

    frames: pictures in the contact sheet, evenly spaced in time. azimuths_deg: one row of the sheet for each
    of these directions. picture_width, picture_height: of one picture, pixels. turn_frames: pictures of the
    turntable, over which the motion plays once and the viewer goes round once.
    """

    frames: int = 6
    azimuths_deg: tuple[float, ...] = (0.0, 50.0, 180.0)
    picture_width: int = 300
    picture_height: int = 400
    turn_frames: int = 120

    def __post_init__(self) -> None:
        if min(self.frames, self.turn_frames, self.picture_width, self.picture_height) < 1:
            raise BadInput("preview: expected at least one frame and one pixel")


def meshes_of_frame(dressed: DressedFigure, frame: int, floor: float) -> list[Mesh]:
    """Return the cloth, the bones and a patch of floor, at height y `floor`, of one frame of the clock."""
    template = dressed.template
    colours = template.colours
    if colours is None:
        colours = np.tile(np.array(_CLOTH_COLOUR, np.float32), (len(template.vertices), 1))
    cloth = Mesh(vertices=dressed.frame(frame), faces=template.faces, colours=colours)
    skeleton = dressed.motion.skeleton
    pose = pose_of_frame(dressed.motion, frame)
    _, starts, ends = bone_segments(skeleton, pose)
    bones = capsules(starts, ends, _BONE_RADIUS * skeleton.height, _BONE_COLOUR)
    return [cloth, bones, _floor(dressed, frame, floor)]


def floor_height(dressed: DressedFigure) -> float:
    """Return y of the lowest bone over the whole motion, sampled: that is where the figure stands."""
    moments = np.linspace(0, len(dressed) - 1, _FLOOR_SAMPLES).round().astype(int)
    skeleton = dressed.motion.skeleton
    poses = (pose_of_frame(dressed.motion, int(moment)) for moment in moments)
    return max(float(bone_segments(skeleton, pose)[2][:, 1].max()) for pose in poses)


def _floor(dressed: DressedFigure, frame: int, y: float) -> Mesh:
    x, _, z = dressed.motion.root_positions[frame]
    half = 0.45 * dressed.motion.skeleton.height
    corners = np.array([[x + i * half, y, z + j * half] for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return Mesh(
        vertices=corners,
        faces=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        colours=np.tile(np.array(_FLOOR_COLOUR, np.float32), (4, 1)),
    )


def _view(dressed: DressedFigure, frame: int, azimuth_deg: float, options: PreviewOptions) -> View:
    """Follow the hips sideways and in depth, not in height, so that steps show."""
    motion = dressed.motion
    centre = np.array(motion.root_positions[frame])
    centre[1] = np.median(motion.root_positions[:, 1])
    return View(
        centre=centre,
        height=_MARGIN * motion.skeleton.height,
        azimuth_deg=azimuth_deg,
        elevation_deg=12.0,
        width_px=options.picture_width,
        height_px=options.picture_height,
    )


def contact_sheet(dressed: DressedFigure, options: PreviewOptions | None = None) -> npt.NDArray[np.uint8]:
    """Return one picture (h, w, 3) uint8: time runs to the right, one direction a row."""
    options = options or PreviewOptions()
    floor = floor_height(dressed)
    columns = []
    for frame in _moments(dressed, options):
        meshes = meshes_of_frame(dressed, int(frame), floor)
        views = (_view(dressed, int(frame), azimuth, options) for azimuth in options.azimuths_deg)
        columns.append(np.concatenate([picture_of(meshes, view) for view in views], axis=0))
    return np.concatenate(columns, axis=1)


def _write_sheet(path: Path, dressed: DressedFigure, options: PreviewOptions) -> None:
    """Write the contact sheet with its times above and its directions beside."""
    sheet, width, height = contact_sheet(dressed, options), options.picture_width, options.picture_height
    seconds = _moments(dressed, options) / dressed.clock.frame_rate_hz
    rows = [
        {
            f"{second:.2f} s": sheet[i * height : (i + 1) * height, k * width : (k + 1) * width]
            for k, second in enumerate(seconds)
        }
        for i in range(len(options.azimuths_deg))
    ]
    names = [f"from {azimuth:.0f}°" for azimuth in options.azimuths_deg]
    write_tiles(path, rows, names, height_px=height)


def _moments(dressed: DressedFigure, options: PreviewOptions) -> IntArray:
    return np.linspace(0, len(dressed) - 1, options.frames).round().astype(np.int64)


def turntable(
    dressed: DressedFigure, options: PreviewOptions | None = None
) -> Iterator[npt.NDArray[np.uint8]]:
    """Yield pictures (h, w, 3) uint8 of the motion, seen by a viewer who goes once around the figure."""
    options = options or PreviewOptions()
    floor = floor_height(dressed)
    for index in range(options.turn_frames):
        frame = index * len(dressed) // options.turn_frames
        azimuth = 360.0 * index / options.turn_frames
        yield picture_of(meshes_of_frame(dressed, frame, floor), _view(dressed, frame, azimuth, options))


def write_preview(
    folder: Path, stem: str, dressed: DressedFigure, options: PreviewOptions | None = None
) -> None:
    """Write `STEM_sheet.png` and `STEM_turntable.mkv` into a folder."""
    options = options or PreviewOptions()
    _write_sheet(folder / f"{stem}_sheet.png", dressed, options)
    seconds = max(len(dressed) / dressed.clock.frame_rate_hz, 1e-3)
    rate = float(np.clip(round(options.turn_frames / seconds), 1, 60))
    write_video(folder / f"{stem}_turntable.mkv", turntable(dressed, options), rate)

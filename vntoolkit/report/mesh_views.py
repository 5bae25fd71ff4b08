"""Pictures of meshes without a graphics card: OpenCV's rasteriser, one light at the camera's side."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import ByteArray, Colours, FloatArray, IntArray, Points, Vector3
from vntoolkit.checks import require_finite
from vntoolkit.display import SCREEN_GAMMA
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.motion import bone_segments, pose_of_frame
from vntoolkit.io.footage.video import write_video
from vntoolkit.pipeline.dress import DressedFigure, floor_height
from vntoolkit.pipeline.threads import stepped
from vntoolkit.report.pictures import write_tiles
from vntoolkit.skinning.findings import is_outside
from vntoolkit.skinning.stretch import STRETCHED

BACKGROUND = (0.93, 0.94, 0.96)
PLAIN = (0.66, 0.65, 0.62)  # of a mesh without colours
_AMBIENT = 0.12
_ROOM = 1.15  # height of a picture over its subject's
_FINER = 2  # samples along each side of a pixel, averaged: smooth edges
_LIGHT = np.array([-0.35, -0.55, -0.76])  # from the surface, in the axes of the view (y down)
_AWAY = 100.0  # heights of the picture, to the viewer: depths in float32 tell a thousandth of a pixel apart
_UNMOVED = np.eye(4, dtype=np.float32)


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """An orthographic view. centre: (3,) point in the middle. height: of the picture, length units.

    azimuth_deg, elevation_deg: the viewer's place around the centre; 0, 0 looks along +z, as the camera does;
    90° looks from the figure's left (+x), positive elevation from above. width_px, height_px: picture size.
    """

    centre: Vector3
    height: float
    azimuth_deg: float = 0.0
    elevation_deg: float = 0.0
    width_px: int = 320
    height_px: int = 480

    @classmethod
    def around(cls, mesh: Mesh, width_px: int, height_px: int, **angles: float) -> "View":
        """Return the view of these angles in which the mesh, unturned, fills the picture."""
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        width, height = (high - low)[:2]
        tall = _ROOM * max(float(height), float(width) * height_px / width_px)
        return cls(centre=(low + high) / 2, height=tall, width_px=width_px, height_px=height_px, **angles)

    @property
    def view_from_world(self) -> FloatArray:
        """(3, 3) rotation into the axes of the view: x right, y down, z away from the viewer."""
        a, e = np.deg2rad([self.azimuth_deg, self.elevation_deg])
        around = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
        tilt = np.array([[1, 0, 0], [0, np.cos(e), -np.sin(e)], [0, np.sin(e), np.cos(e)]])
        return tilt @ around


def picture_of(meshes: Sequence[Mesh], view: View) -> ByteArray:
    """Render meshes in the camera frame; returns (h, w, 3) uint8 RGB. Both sides of a face are lit.

    OpenCV's rasteriser knows perspective alone. Corners are moved so that its projection of each is the
    orthographic one.
    """
    size = _FINER * view.height_px, _FINER * view.width_px
    picture = np.tile(np.power(BACKGROUND, SCREEN_GAMMA).astype(np.float32), (*size, 1))
    depths = np.full(size, 2 * _AWAY, np.float32)
    settings = cv2.TriangleRasterizeSettings().setCullingMode(cv2.RASTERIZE_CULLING_NONE)
    settings = settings.setShadingType(cv2.RASTERIZE_SHADING_SHADED)
    for mesh in meshes:
        require_finite(mesh.vertices, "vertices to draw", BadMesh)
        turned = ((mesh.vertices - view.centre) @ view.view_from_world.T / view.height).astype(np.float32)
        corners = turned[mesh.faces]
        colours = _lit_colours(mesh, corners)
        corners *= [1, -1, -1]  # the rasteriser's y is up, its z towards the viewer
        corners[..., :2] *= 1 - corners[..., 2:] / _AWAY
        corners[..., 2] -= _AWAY
        order = np.arange(corners.size // 3, dtype=np.int32).reshape(-1, 3)
        points, angle = corners.reshape(-1, 3), 2 * np.arctan(0.5 / _AWAY)
        if len(order):
            cv2.triangleRasterize(
                points, order, colours, picture, depths, _UNMOVED, angle, 1.0, 2 * _AWAY, settings
            )
    smooth = cv2.resize(picture, (view.width_px, view.height_px), interpolation=cv2.INTER_AREA)
    return (np.clip(smooth, 0, 1) ** (1 / SCREEN_GAMMA) * 255 + 0.5).astype(np.uint8)


def _lit_colours(mesh: Mesh, corners: FloatArray) -> Colours:
    """Return the linear colour of every corner (m·3, 3) of the faces (m, 3, 3), lit by their normals."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.maximum(np.linalg.norm(normals, axis=1), np.float32(1e-30))
    towards = np.where(normals[:, 2] > 0, -1.0, 1.0) / lengths
    light = (_LIGHT / np.linalg.norm(_LIGHT)).astype(np.float32)
    brightness = _AMBIENT + (1 - _AMBIENT) * np.maximum(normals @ light * towards, 0)
    own = np.array(PLAIN, np.float32) if mesh.colours is None else mesh.colours[mesh.faces]
    lit = np.clip(own * brightness[:, None, None], 0, 1).astype(np.float32)
    return np.ascontiguousarray(np.broadcast_to(lit, corners.shape)).reshape(-1, 3)


def capsules(starts: Points, ends: Points, radius: float, colour: tuple[float, float, float]) -> Mesh:
    """Return one mesh of eight-sided spindles from starts to ends, (b, 3) each: bones to look at."""
    sides = 8
    angles = 2 * np.pi * np.arange(sides) / sides
    vertices: list[Points] = []
    faces: list[list[int]] = []
    for start, end in zip(starts, ends, strict=True):
        axis = end - start
        across = np.cross(axis, [0.0, 0.0, 1.0] if abs(axis[2]) < 0.9 * np.linalg.norm(axis) else [0, 1.0, 0])
        across /= np.linalg.norm(across)
        other = np.cross(axis, across) / np.linalg.norm(axis)
        ring = (
            start + 0.2 * axis + radius * (np.outer(np.cos(angles), across) + np.outer(np.sin(angles), other))
        )
        base = len(vertices) * (sides + 2)
        vertices.append(np.concatenate([ring, [start, end]]))
        for side in range(sides):
            here, there = base + side, base + (side + 1) % sides
            faces += [[here, there, base + sides + 1], [there, here, base + sides]]
    points = np.concatenate(vertices) if vertices else np.zeros((0, 3))
    return Mesh(
        vertices=points,
        faces=np.array(faces, dtype=np.int32).reshape(-1, 3),
        colours=np.tile(np.array(colour, np.float32), (len(points), 1)),
    )


_RED = (0.85, 0.06, 0.05)
_COARSE_VERTICES = 10_000  # of a garment: about two pixels of the turntable apart
_BONE_COLOUR = (0.18, 0.30, 0.62)
_CLOTH_COLOUR = (0.80, 0.45, 0.32)
_FLOOR_COLOUR = (0.80, 0.82, 0.84)
_BONE_RADIUS = 0.013  # of the figure's height
_DRAWN_AT_ONCE = 2  # pictures: most of the work is one thread's
# Height of the picture and of its middle, over the figure's: room for raised arms.
_MARGIN, _MIDDLE = 1.35, 0.55


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
    turn_frames: int = 60

    def __post_init__(self) -> None:
        if min(self.frames, self.turn_frames, self.picture_width, self.picture_height) < 1:
            raise BadInput("preview: expected at least one frame and one pixel")


class _Stage:
    """Makes a frame's cloth, bones and floor; red is stretched above 2×, or an arm outside its sleeve."""

    def __init__(self, dressed: DressedFigure, *, coarse: bool = False) -> None:
        """coarse: with fewer triangles, for pictures that are seen for a moment."""
        from vntoolkit.report.result_scene import thinned_template

        self._dressed, self._meter, self._floor = dressed, dressed.meter(), floor_height(dressed.motion)
        template = dressed.template
        self._colours = np.full((len(template.vertices), 3), _CLOTH_COLOUR, np.float32)
        if template.colours is not None:
            self._colours = np.array(template.colours)
        self._drawn = thinned_template(template, _COARSE_VERTICES if coarse else len(template.vertices))

    def meshes(self, frame: int) -> list[Mesh]:
        """Return the meshes of one frame of the clock."""
        dressed, skeleton = self._dressed, self._dressed.motion.skeleton
        vertices, pose = dressed.frame(frame), pose_of_frame(dressed.motion, frame)
        colours = np.array(self._colours)
        stretched = self._meter.stretch(vertices) > STRETCHED
        colours[np.unique(dressed.template.faces[stretched])] = _RED
        kept, faces = self._drawn.kept, self._drawn.mesh.faces
        cloth = Mesh(vertices=vertices[kept], faces=faces, colours=colours[kept])
        outside = is_outside(self._meter.off_axis(vertices, pose).max(axis=1))
        out = [
            joint
            for one, is_out in zip(dressed.fitting.sleeved, outside, strict=True)
            if is_out and not one.is_short
            for joint in one.arm.joints
        ]
        joints, starts, ends = bone_segments(skeleton, pose)
        red = np.isin(joints, out)
        radius = _BONE_RADIUS * skeleton.height
        bones = [
            capsules(starts[which], ends[which], radius, colour)
            for which, colour in ((~red, _BONE_COLOUR), (red, _RED))
        ]
        return [cloth, *bones, _floor(dressed, frame, self._floor)]

    def view(self, frame: int, azimuth_deg: float, options: PreviewOptions) -> View:
        """Follow the hips sideways and in depth, not in height, so that steps show."""
        motion = self._dressed.motion
        x, _, z = motion.root_positions[frame]
        return View(
            centre=np.array([x, self._floor - _MIDDLE * motion.skeleton.height, z]),
            height=_MARGIN * motion.skeleton.height,
            azimuth_deg=azimuth_deg,
            elevation_deg=12.0,
            width_px=options.picture_width,
            height_px=options.picture_height,
        )


def _floor(dressed: DressedFigure, frame: int, y: float) -> Mesh:
    x, _, z = dressed.motion.root_positions[frame]
    half = 0.45 * dressed.motion.skeleton.height
    corners = np.array([[x + i * half, y, z + j * half] for i, j in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
    return Mesh(
        vertices=corners,
        faces=np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32),
        colours=np.tile(np.array(_FLOOR_COLOUR, np.float32), (4, 1)),
    )


def contact_sheet(dressed: DressedFigure, options: PreviewOptions | None = None) -> ByteArray:
    """Return one picture (h, w, 3) uint8: time runs to the right, one direction a row."""
    options = options or PreviewOptions()
    stage = _Stage(dressed)
    moments = [int(frame) for frame in _moments(dressed, options)]
    jobs = (
        (meshes, stage.view(frame, azimuth, options))
        for frame in moments
        for meshes in (stage.meshes(frame),)
        for azimuth in options.azimuths_deg
    )
    rows = len(options.azimuths_deg)
    pictures = list(progress.counted(_drawn(jobs), "contact sheet", rows * len(moments)))
    return np.concatenate([np.concatenate(pictures[row::rows], axis=1) for row in range(rows)], axis=0)


def _drawn(jobs: Iterable[tuple[Sequence[Mesh], View]]) -> Iterator[ByteArray]:
    """Yield the picture of each job; one is drawn beside the next."""
    return stepped(jobs, lambda job: picture_of(*job), threads=_DRAWN_AT_ONCE)


def _write_sheet(path: Path, dressed: DressedFigure, options: PreviewOptions) -> None:
    """Write the contact sheet with its times above and its directions beside."""
    sheet = contact_sheet(dressed, options)
    width, height = options.picture_width, options.picture_height
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


def turntable(dressed: DressedFigure, options: PreviewOptions | None = None) -> Iterator[ByteArray]:
    """Yield pictures (h, w, 3) uint8 of the motion, seen by a viewer who goes once around the figure."""
    options = options or PreviewOptions()
    stage = _Stage(dressed, coarse=True)
    frames = [index * len(dressed) // options.turn_frames for index in range(options.turn_frames)]
    azimuths = 360.0 * np.arange(len(frames)) / len(frames)
    yield from _drawn(
        (stage.meshes(frame), stage.view(frame, azimuth, options))
        for frame, azimuth in zip(frames, azimuths, strict=True)
    )


def write_preview(
    folder: Path, stem: str, dressed: DressedFigure, options: PreviewOptions | None = None
) -> None:
    """Write `STEM_sheet.png` and `STEM_turntable.mkv` into a folder."""
    options = options or PreviewOptions()
    _write_sheet(folder / f"{stem}_sheet.png", dressed, options)
    seconds = max(len(dressed) / dressed.clock.frame_rate_hz, 1e-3)
    rate = float(np.clip(round(options.turn_frames / seconds), 1, 60))
    pictures = progress.counted(turntable(dressed, options), "turntable", options.turn_frames)
    write_video(folder / f"{stem}_turntable.mkv", pictures, rate)

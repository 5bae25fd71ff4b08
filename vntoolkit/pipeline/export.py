"""Export of results to other programs: one animated file, or one file per frame, written atomically."""

from __future__ import annotations

import logging
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import Array, FloatArray, Vector3
from vntoolkit.errors import BadInput, VntError
from vntoolkit.geometry.camera import Camera, ViewedFrom
from vntoolkit.geometry.maps import LengthUnit
from vntoolkit.geometry.mesh import Mesh, vertex_normals
from vntoolkit.io import atomic
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.maps_and_meshes.maps import write_normal_map
from vntoolkit.io.results.folder import FolderKind, begin_run, option_values, read_lock, write_lock
from vntoolkit.options.export import (
    INSPECTED,
    CleanOptions,
    ExportArguments,
    ExportedSurface,
    ExportFormat,
    ExportOptions,
    FileUnit,
)
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.pipeline.texture_files import texture_of_tracks, with_captured_colours

if TYPE_CHECKING:
    from vntoolkit.pipeline.tracked_folder import Tracks

_MATERIAL = "surface.mtl"  # of all frames in a folder of OBJ files
_LOGGER = logging.getLogger(__name__)
_METRES_PER_PIXEL = 0.001  # shown, not measured: a 600-pixel subject opens 0.6 m tall in Blender
_HEADROOM = 1.25  # of a light's picture over the brightest that the rig's material gets


@dataclass(frozen=True, kw_only=True)
class ExportSummary:
    """What was exported.

    out: file or folder. frames: in it. kept: of these, from an earlier run. is_tracked: the registered
    surface; None where no mesh is written.
    """

    out: Path
    frames: int
    kept: int
    is_tracked: bool | None = None


def export(asked: ExportArguments) -> ExportSummary:
    """Export a reconstruction in another format.

    A single file appears when it is whole. In a folder every file does; the same command again goes on where
    it stopped, and writes again what has changed since. Raises `BadInput`.
    """
    folder = Path(asked.folder)
    with read_lock(folder):
        result = read_result(folder, frames=asked.frames, footage=asked.footage, background=asked.background)
        track = _track_of(result, asked)
        if asked.to in (ExportFormat.RRD, ExportFormat.MCAP):
            from vntoolkit.pipeline.export_recordings import export_recording

            return export_recording(asked, asked.out, result, track)
        if asked.to is ExportFormat.USD or (asked.to is ExportFormat.GLB and track is not None):
            return _export_animation(asked, result, track)
        return _export_folder(asked, result, track)


def _track_of(result: OpenedResult, options: ExportOptions) -> Tracks | None:
    if options.mesh is ExportedSurface.FRAMES:
        return None
    if options.cleaning is not None and result.track is not None:
        raise BadInput("cleaning gives every frame a topology of its own: add --mesh frames")
    if result.track is None and options.mesh is ExportedSurface.TRACKED:
        raise BadInput(f"{result.folder.root}: holds no tracked surface; run `vntoolkit track` first")
    return result.track


def _export_animation(options: ExportArguments, result: OpenedResult, track: Tracks | None) -> ExportSummary:
    filmed = result.manifest.input
    suffix = ".glb" if options.to is ExportFormat.GLB else ".usdc"
    out = options.out or result.folder.root / "export" / f"surface{suffix}"
    if out.suffix.lower() not in ((".glb",) if suffix == ".glb" else (".usdc", ".usd")):
        raise BadInput(f"{out}: expected the name of a file that ends in {suffix}")
    lengths = file_lengths(options, result.length_unit)
    numbers = numbers_with(result, "mesh", track)
    rate, times_s = filmed.rate_of(numbers), filmed.times_of(numbers)
    atomic.require_writable_folder(out.parent)  # and remove what a killed run left there
    counted = progress.counted(numbers, "export", len(numbers))
    clock: dict[str, Any] = {"frame_rate_hz": rate, "times_s": times_s}
    lengths_of_usd: dict[str, Any] = {"metres_per_unit": lengths.metres_per_unit, "up": options.up}
    if track is None:
        from vntoolkit.io.maps_and_meshes.usd import write_usd_meshes

        own = (own_mesh(result, n, options, lengths.factor) for n in counted)
        count = write_usd_meshes(out, own, **clock, **lengths_of_usd)
        return ExportSummary(out=out, frames=count, kept=0, is_tracked=False)
    offset = offset_of(track, options, lengths.factor)
    rows = map(track.numbers.index, counted)
    moving = (track.sequence.vertices[row] * lengths.factor + offset for row in rows)
    texture = texture_of_tracks(result.folder.root / "track")
    template = with_captured_colours(track, texture)
    camera = viewed_from(result.camera, offset)
    if options.to is ExportFormat.GLB:
        from vntoolkit.io.maps_and_meshes.glb import write_glb

        count = write_glb(out, template, moving, **clock, camera=camera, texture=texture)
    else:
        from vntoolkit.io.maps_and_meshes.usd import write_usd_sequence

        count = write_usd_sequence(
            out,
            template,
            moving,
            **clock,
            **lengths_of_usd,
            camera=camera,
            texture=None if texture is None else texture.beside(out),
        )
    return ExportSummary(out=out, frames=count, kept=0, is_tracked=True)


def offset_of(track: Tracks, options: ExportOptions, factor: float) -> Vector3:
    """Return (3,): what puts the template's middle above the origin and its lowest point on the floor."""
    if not options.centre:
        return np.zeros(3)
    vertices = np.asarray(track.mesh(track.template).vertices, dtype=np.float64) * factor
    middle = vertices.mean(axis=0)
    return -np.array([middle[0], vertices[:, 1].max(), middle[2]])


def viewed_from(camera: Camera, offset: Vector3) -> ViewedFrom | None:
    """Return the camera of the capture in a scene that was moved by the offset; None without perspective."""
    if not camera.is_perspective:
        return None
    offset = np.asarray(offset, dtype=np.float64)
    return ViewedFrom(camera=camera, position=offset, rotation=np.eye(3), offset=offset)


def _export_folder(asked: ExportArguments, result: OpenedResult, track: Tracks | None) -> ExportSummary:
    writer = frame_export(result, track, asked)
    out = asked.out or result.folder.root / "export" / ExportFormat(asked.to).value
    if out.suffix and out.suffix.lower() == writer.suffix:
        raise BadInput(f"{out}: expected the name of a folder, for one {writer.suffix} a frame")
    root = result.folder.root
    atomic.require_apart([out], (root / name for name in ("normals", "depth", "shadows", "mesh", "track")))
    if out.resolve() == root.resolve():
        raise BadInput(f"{out}: is the result itself; choose another --out")
    numbers = writer.numbers()
    cleans = [each.name for each in fields(CleanOptions)]
    values = option_values(asked.part(ExportOptions), without=("clean", *cleans))
    values |= {} if asked.cleaning is None else option_values(asked.cleaning, "cleaning.")
    record = {"version": 1, "options": values, "result_sha256": result.digest, **writer.facts}
    with write_lock(out):
        begin_run(out, EXPORT, record, overwrite=asked.overwrite)
        kept = {number for number in numbers if writer.is_current(out, number)}
        progress.begin("export", len(numbers), len(kept))
        for number in numbers:
            if number not in kept:
                writer.write(out, number)
                progress.step()
        writer.finish(out)
    return ExportSummary(out=out, frames=len(numbers), kept=len(kept), is_tracked=writer.is_tracked)


def _remove_frame_folder(folder: Path) -> None:
    from vntoolkit.io.light_files import remove_diligent

    remove_diligent(folder)


EXPORT = FolderKind(
    verb="export",
    holds="an export",
    record="export.json",
    files=("track.npz", _MATERIAL, "surface_albedo.png", "surface_normal.png"),
    frames={
        ".": (".ply", ".obj", ".stl", ".glb", ".npz", ".png", ".exr", ".csv", ".json", ".sur", ".x3p")
    },  # whatever the format of the earlier one
    clear_frame=_remove_frame_folder,
)


@dataclass(frozen=True, kw_only=True)
class FileLengths:
    """factor: by which lengths are multiplied on their way into a file. metres_per_unit: of the file."""

    factor: float
    metres_per_unit: float


def file_lengths(options: ExportOptions, unit: LengthUnit | None) -> FileLengths:
    """Return what lengths of a result become; raise `BadInput` for units that it has no scale for."""
    metres = 1.0 if unit is LengthUnit.METRE else options.scale
    if unit is LengthUnit.METRE and options.scale is not None:
        raise BadInput("scale: the result has lengths in metres already; leave out --scale")
    if metres is not None:
        usual = FileUnit.MM if options.to is ExportFormat.STL else FileUnit.M
        target = (options.units or usual).metres
        return FileLengths(factor=metres / target, metres_per_unit=target)
    if options.units is not None and unit is not None:
        stored = "in pixels" if unit is LengthUnit.PIXEL else "of free scale"
        raise BadInput(
            f"units: the result's lengths are {stored}; give --scale METRES for a length of 1, or "
            "reconstruct with --distance"
        )
    shown = _METRES_PER_PIXEL if unit is LengthUnit.PIXEL else 1.0
    if unit is not None:
        _LOGGER.warning("the result has no scale: lengths are written as if 1 were %g m", shown)
    if options.to is ExportFormat.GLB:
        return FileLengths(factor=shown, metres_per_unit=1.0)
    return FileLengths(factor=1.0, metres_per_unit=shown)


# The formats with one file or folder per frame: meshes, arrays, normal maps, DiLiGenT objects.


def numbers_with(result: OpenedResult, kind: str, track: Tracks | None = None) -> tuple[int, ...]:
    """Return the opened frames that have a depth or a mesh, their own or the registered; raise for none."""
    if track is not None:
        found = tuple(number for number in track.numbers if number in set(result.numbers))
    else:
        found = tuple(number for number in result.numbers if result.folder.has(number, kind))
    if not found:
        root = result.folder.root
        raise BadInput(f"{root}: holds no {kind} of those frames; run `vntoolkit reconstruct --to {kind}`")
    return found


def own_mesh(result: OpenedResult, number: int, options: ExportOptions, factor: float) -> Mesh:
    """Return a frame's own mesh, which was there a moment ago, cleaned if asked for; factor: of lengths."""
    mesh = result.mesh(number)
    if mesh is None:
        raise BadInput(f"frame {number}: its mesh has vanished")
    if options.cleaning is not None:
        from vntoolkit.meshing.clean import clean_mesh

        mesh = clean_mesh(mesh, options.cleaning)
    return replace(mesh, vertices=mesh.vertices * factor)


class FrameExport(ABC):
    """Writes one frame at a time.

    suffix: of its files, empty for a folder a frame. made_from: folders of the result; a file older than
    theirs is written again. needs: the one of them without which a frame is left out.
    """

    suffix = ""
    made_from: tuple[str, ...] = ("normals",)
    needs = ""
    has_lengths = True
    is_tracked: bool | None = None  # of meshes

    @property
    def facts(self) -> Mapping[str, Any]:
        """What else the record of the export says."""
        return {}

    def __init__(self, result: OpenedResult, track: Tracks | None, options: ExportOptions) -> None:
        self.result, self.track, self.options = result, track, options
        self.factor = file_lengths(options, result.length_unit).factor if self.has_lengths else 1.0

    def numbers(self) -> tuple[int, ...]:
        """Return the frames that there are."""
        return numbers_with(self.result, self.needs) if self.needs else self.result.numbers

    def place(self, out: Path, number: int) -> Path:
        """Return the file or folder of a frame."""
        return out / f"{number:06d}{self.suffix}"

    def last_file(self, out: Path, number: int) -> Path:
        """Return the file that is written last."""
        return self.place(out, number)

    def sources(self, number: int) -> list[Path]:
        """Return the files of the result that the frame is made from."""
        return [self.result.folder.file(kind, number) for kind in self.made_from]

    def is_current(self, out: Path, number: int) -> bool:
        """Whether the frame was exported, and is not older than what it is made from."""
        made = self.last_file(out, number)
        if not made.exists():
            return False
        newest = max((path.stat().st_mtime for path in self.sources(number) if path.exists()), default=0.0)
        return made.stat().st_mtime >= newest

    @abstractmethod
    def write(self, out: Path, number: int) -> None:
        """Write a frame."""

    def finish(self, out: Path) -> None:  # noqa: B027 - most have nothing to add
        """Write what belongs to all frames together."""


class _Meshes(FrameExport):
    """PLY, OBJ, STL or GLB a frame, of the registered surface where there is one, else of its own mesh."""

    made_from, needs = ("mesh",), "mesh"

    def __init__(self, result: OpenedResult, track: Tracks | None, options: ExportOptions) -> None:
        super().__init__(result, track, options)
        self.suffix, self.is_tracked = f".{options.to.value}", track is not None
        self._offset: Vector3 = np.zeros(3)
        self._texture, self._has_material = None, False
        if track is not None:
            self._offset = offset_of(track, options, self.factor)
            self._texture = texture_of_tracks(result.folder.root / "track")
            self._template = with_captured_colours(track, self._texture)

    @property
    def facts(self) -> Mapping[str, Any]:
        """By how much the files' meshes were moved, and hence where the camera is in them."""
        if self.track is None or not self.options.centre:
            return {}
        return {"camera_position": graphics_from_camera(self._offset, self.options.up).round(9).tolist()}

    def numbers(self) -> tuple[int, ...]:
        return numbers_with(self.result, self.needs, self.track)

    def sources(self, number: int) -> list[Path]:
        if self.track is None:
            return super().sources(number)
        return [self.result.folder.root / "track" / "vertices.npy"]

    def write(self, out: Path, number: int) -> None:
        path, mesh = self.place(out, number), self._mesh(number)
        if self.options.to is ExportFormat.GLB:
            from vntoolkit.io.maps_and_meshes.glb import write_glb

            rate = self.result.manifest.input.playing_rate_hz
            camera = viewed_from(self.result.camera, self._offset)
            write_glb(path, mesh, iter([mesh.vertices]), frame_rate_hz=rate, camera=camera)
        else:
            from vntoolkit.io.maps_and_meshes.meshes import write_mesh

            write_mesh(path, mesh, up=self.options.up, material=self._material(out))

    def _mesh(self, number: int) -> Mesh:
        if self.track is None:
            return own_mesh(self.result, number, self.options, self.factor)
        vertices = self.track.mesh(number).vertices * self.factor + self._offset
        normals = vertex_normals(vertices, self._template.faces)
        return replace(self._template, vertices=vertices, normals=normals)

    def _material(self, out: Path) -> str | None:
        """Return the name of the material that all frames share, of OBJ files with a texture."""
        if self._texture is None or self.options.to is not ExportFormat.OBJ:
            return None
        if not self._has_material:
            from vntoolkit.io.maps_and_meshes.meshes import write_material

            beside = self._texture.beside(out / _MATERIAL)
            write_material(out / _MATERIAL, beside.albedo, beside.normal)
            self._has_material = True
        return _MATERIAL


class _PointClouds(FrameExport):
    """PLY without faces, coloured where the footage is still at hand."""

    suffix = ".ply"
    made_from, needs = ("normals", "depth"), "depth"

    def write(self, out: Path, number: int) -> None:
        from vntoolkit.io.maps_and_meshes.meshes import write_point_cloud
        from vntoolkit.meshing.surface import point_cloud_from_depth

        depth_map = self.result.depth(number)
        assert depth_map is not None
        try:
            rgb = self.result.linear(number).rgb
        except VntError:
            rgb = None
        normal_map = self.result.normals(number)
        cloud = point_cloud_from_depth(depth_map, self.result.camera, rgb=rgb, normal_map=normal_map)
        cloud = replace(cloud, points=cloud.points * self.factor)
        write_point_cloud(self.place(out, number), cloud, up=self.options.up)


class _NormalMaps(FrameExport):
    """16-bit PNG."""

    suffix = ".png"
    has_lengths = False

    def write(self, out: Path, number: int) -> None:
        normal_map, path = self.result.normals(number), self.place(out, number)
        write_normal_map(path, normal_map, convention=self.options.normal_convention)


class _Arrays(FrameExport):
    """Everything of a frame as named arrays."""

    suffix = ".npz"
    made_from = ("normals", "depth", "shadows", "mesh")

    def write(self, out: Path, number: int) -> None:
        from vntoolkit.io.maps_and_meshes.arrays import write_npz

        write_npz(self.place(out, number), arrays_of_frame(self.result, number, self.options, self.factor))

    def finish(self, out: Path) -> None:
        if self.track is not None:
            numbers = self.result.numbers
            write_tracked_npz(out / "track.npz", self.track, numbers, self.options, self.factor)


class _Diligent(FrameExport):
    """One picture per light: its contribution to the frame, as if it had shone alone."""

    has_lengths = False

    def __init__(self, result: OpenedResult, track: Tracks | None, options: ExportOptions) -> None:
        super().__init__(result, track, options)
        if result.lacks_background:
            raise BadInput("diligent: the result was made with a background; give it as --background")
        result.capture  # noqa: B018 - refused before anything is written
        lights = result.rig.response.lights
        strengths: FloatArray = np.linalg.norm(lights, axis=1)
        known = result.manifest.known
        albedo = 1.0 if known.materials else known.relative_albedo or 1.0
        self._scale = _HEADROOM * max(1.0, float(albedo)) * float(strengths.max())
        self._directions = lights / strengths[:, None]
        self._intensities = np.repeat(strengths[:, None] / self._scale, 3, axis=1)

    def last_file(self, out: Path, number: int) -> Path:
        return self.place(out, number) / "filenames.txt"

    def write(self, out: Path, number: int) -> None:
        from vntoolkit.io.light_files import write_diligent

        response = self.result.rig.response
        rgb = self.result.linear(number).rgb - response.ambient
        contributions = rgb @ response.contributions_from_rgb.T / self._scale
        stored = np.rint(np.clip(contributions, 0, 1) * 65535).astype(np.uint16)
        images = [np.repeat(stored[..., k : k + 1], 3, axis=2) for k in range(3)]
        write_diligent(
            self.place(out, number),
            images,
            self._directions,
            self._intensities,
            self.result.normals(number),
            self.options.normal_convention,
        )


def frame_export(result: OpenedResult, track: Tracks | None, options: ExportOptions) -> FrameExport:
    """Return what writes the frames of a format."""
    kinds: dict[ExportFormat, type[FrameExport]] = {
        ExportFormat.POINTS: _PointClouds,
        ExportFormat.NPZ: _Arrays,
        ExportFormat.PNG: _NormalMaps,
        ExportFormat.DILIGENT: _Diligent,
    }
    if options.to in INSPECTED:
        from vntoolkit.pipeline.export_inspection import Inspected

        return Inspected(result, track, options)
    return kinds.get(options.to, _Meshes)(result, track, options)


# The arrays of `--to npz`: of a frame, and of the registered surface.


def arrays_of_frame(
    result: OpenedResult, number: int, options: ExportOptions, factor: float
) -> Mapping[str, Array]:
    """Return what `--to npz` holds of a frame.

    normals (h, w, 3) in the asked convention, mask, confidence, error_deg; depth along the optical axis,
    depth_mask, depth_error_percent; labels; vertices, faces, vertex_normals, vertex_colours, uv of the
    frame's own mesh in the frame of files; camera_matrix. factor: of lengths. Parts that the frame
    lacks are left out.
    """
    normal_map, depth_map = result.normals(number), result.depth(number)
    signs = np.array(options.normal_convention.signs, np.float32)
    arrays: dict[str, Any] = {
        "normals": normal_map.normals_in_camera * signs,
        "mask": normal_map.mask,
        "confidence": normal_map.weight,
        "error_deg": normal_map.error_deg,
        "labels": result.labels(number),
        "camera_matrix": result.camera.matrix,
        "normal_convention": np.array(options.normal_convention.value),
        "up": np.array(options.up.value),
    }
    if depth_map is not None:
        arrays |= {"depth": (depth_map.depth * factor).astype(np.float32), "depth_mask": depth_map.mask}
        arrays["depth_error_percent"] = depth_map.error_percent
    mesh = result.mesh(number)
    if mesh is not None:
        normals = None if mesh.normals is None else graphics_from_camera(mesh.normals, options.up)
        arrays |= {
            "vertices": (graphics_from_camera(mesh.vertices, options.up) * factor).astype(np.float32),
            "faces": mesh.faces,
            "vertex_normals": None if normals is None else normals.astype(np.float32),
            "vertex_colours": mesh.colours,
            "uv": mesh.uv,
        }
    return {name: np.asarray(values) for name, values in arrays.items() if values is not None}


def write_tracked_npz(
    path: Path, track: Tracks, numbers: tuple[int, ...], options: ExportOptions, factor: float
) -> None:
    """Write the registered surface: vertices (frames, n, 3), faces, uv, uncertainty_px, frames, times_s,
    frame_rate_hz."""
    from vntoolkit.io.maps_and_meshes.arrays import StreamedArray, write_npz

    wanted = set(numbers)
    rows = [row for row, number in enumerate(track.numbers) if number in wanted]
    sequence, template = track.sequence, track.sequence.template
    moving = (graphics_from_camera(sequence.vertices[row], options.up) * factor for row in rows)
    arrays: dict[str, Any] = {
        "vertices": StreamedArray(
            shape=(len(rows), len(template.vertices), 3), dtype=np.float32, rows=moving
        ),
        "faces": template.faces,
        "frames": np.array([track.numbers[row] for row in rows]),
        "frame_rate_hz": np.array(sequence.frame_rate_hz),
        "times_s": sequence.instants_s[rows],
        "up": np.array(options.up.value),
    }
    arrays |= {name: v for name, v in (("uv", template.uv), ("colours", template.colours)) if v is not None}
    uncertainty = sequence.uncertainty_px
    if uncertainty is not None:
        arrays["uncertainty_px"] = StreamedArray(
            shape=(len(rows), len(template.vertices)), dtype=np.float32, rows=(uncertainty[r] for r in rows)
        )
    write_npz(path, arrays)

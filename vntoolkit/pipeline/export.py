"""Export of results to other programs: one animated file, or one file per frame, written atomically."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import FloatArray, Points, Vector3
from vntoolkit.errors import BadInput, VntError
from vntoolkit.geometry.camera import ViewedFrom
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
    from vntoolkit.io.maps_and_meshes.texture import SurfaceTexture
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
        source = ExportSource(result=result, track=_track_of(result, asked), options=asked)
        if asked.to in (ExportFormat.RRD, ExportFormat.MCAP):
            from vntoolkit.pipeline.export_recordings import export_recording

            out = source.file_to_write(asked.out, f".{ExportFormat(asked.to).value}")
            return export_recording(source, out)
        if asked.to is ExportFormat.USD or (asked.to is ExportFormat.GLB and source.track is not None):
            return _export_animation(source, asked.out)
        return _export_folder(source, asked)


def _track_of(result: OpenedResult, options: ExportOptions) -> Tracks | None:
    if options.mesh is ExportedSurface.FRAMES:
        return None
    if options.cleaning is not None and result.track is not None:
        raise BadInput("cleaning gives every frame a topology of its own: add --mesh frames")
    if result.track is None and options.mesh is ExportedSurface.TRACKED:
        raise BadInput(f"{result.folder.root}: holds no tracked surface; run `vntoolkit track` first")
    return result.track


@dataclass(frozen=True, kw_only=True, eq=False)
class ExportSource:
    """A result as files take it. track: its registered surface; None for the meshes of its frames."""

    result: OpenedResult
    track: Tracks | None
    options: ExportOptions

    @cached_property
    def lengths(self) -> FileLengths:
        """What lengths become. Raises `BadInput` for units that the result has no scale for."""
        return file_lengths(self.options, self.result.length_unit)

    @cached_property
    def offset(self) -> Vector3:
        """(3,), what puts the template's middle above the origin and its lowest point on the floor."""
        if self.track is None or not self.options.centre:
            return np.zeros(3)
        template = self.track.mesh(self.track.template).vertices
        vertices = np.asarray(template, dtype=np.float64) * self.lengths.factor
        middle = vertices.mean(axis=0)
        return -np.array([middle[0], vertices[:, 1].max(), middle[2]])

    @cached_property
    def texture(self) -> SurfaceTexture | None:
        """The texture of the registered surface."""
        return None if self.track is None else texture_of_tracks(self.result.folder.root / "track")

    @property
    def has_material(self) -> bool:
        """Whether the frames share a material: OBJ files with a texture."""
        return self.options.to is ExportFormat.OBJ and self.texture is not None

    @cached_property
    def template(self) -> Mesh:
        """The registered surface's topology, colours and texture coordinates."""
        assert self.track is not None
        return with_captured_colours(self.track, self.texture)

    @property
    def camera(self) -> ViewedFrom | None:
        """The camera of the capture in the scene, which was moved; None without perspective."""
        camera = self.result.camera
        if not camera.is_perspective:
            return None
        return ViewedFrom(camera=camera, position=self.offset, rotation=np.eye(3), offset=self.offset)

    def numbers_with(self, kind: str) -> tuple[int, ...]:
        """Return the opened frames that have a depth or a mesh, their own or the registered."""
        result, track = self.result, self.track
        if kind == "mesh" and track is not None:
            found = tuple(number for number in track.numbers if number in set(result.numbers))
        else:
            found = tuple(number for number in result.numbers if result.folder.has(number, kind))
        if not found:
            root = result.folder.root
            raise BadInput(
                f"{root}: holds no {kind} of those frames; run `vntoolkit reconstruct --to {kind}`"
            )
        return found

    def vertices(self, number: int) -> Points:
        """Return the registered surface's vertices (n, 3) in a frame, in the file's unit."""
        assert self.track is not None
        return self.track.mesh(number).vertices * self.lengths.factor + self.offset

    def mesh(self, number: int) -> Mesh:
        """Return the registered surface in a frame, or the frame's own mesh, cleaned if asked for."""
        if self.track is not None:
            vertices = self.vertices(number)
            normals = vertex_normals(vertices, self.template.faces)
            return replace(self.template, vertices=vertices, normals=normals)
        mesh = self.result.mesh(number)
        if mesh is None:  # it was there a moment ago
            raise BadInput(f"frame {number}: its mesh has vanished")
        if self.options.cleaning is not None:
            from vntoolkit.meshing.clean import clean_mesh

            mesh = clean_mesh(mesh, self.options.cleaning)
        return replace(mesh, vertices=mesh.vertices * self.lengths.factor)

    def file_to_write(self, asked: Path | None, *suffixes: str) -> Path:
        """Return the file that was asked for, else surface with the first suffix; make its folder."""
        out = asked or self.result.folder.root / "export" / f"surface{suffixes[0]}"
        if out.suffix.lower() not in suffixes:
            raise BadInput(f"{out}: expected the name of a file that ends in {suffixes[0]}")
        atomic.require_writable_folder(out.parent)  # and remove what a killed run left there
        return out


def _export_animation(source: ExportSource, asked_out: Path | None) -> ExportSummary:
    filmed, track, up = source.result.manifest.input, source.track, source.options.up
    is_glb = source.options.to is ExportFormat.GLB
    lengths, numbers = source.lengths, source.numbers_with("mesh")
    out = source.file_to_write(asked_out, *((".glb",) if is_glb else (".usdc", ".usd")))
    counted = progress.counted(numbers, "export", len(numbers))
    clock: dict[str, Any] = {"frame_rate_hz": filmed.rate_of(numbers), "times_s": filmed.times_of(numbers)}
    of_usd: dict[str, Any] = {"metres_per_unit": lengths.metres_per_unit, "up": up}
    texture, moving = source.texture, map(source.vertices, counted)
    if track is None:
        from vntoolkit.io.maps_and_meshes.usd import write_usd_meshes

        count = write_usd_meshes(out, map(source.mesh, counted), **clock, **of_usd)
    elif is_glb:
        from vntoolkit.io.maps_and_meshes.glb import write_glb

        count = write_glb(out, source.template, moving, **clock, camera=source.camera, texture=texture)
    else:
        from vntoolkit.io.maps_and_meshes.usd import write_usd_sequence

        texture = None if texture is None else texture.beside(out)
        count = write_usd_sequence(
            out, source.template, moving, **clock, **of_usd, camera=source.camera, texture=texture
        )
    return ExportSummary(out=out, frames=count, kept=0, is_tracked=track is not None)


def _export_folder(source: ExportSource, asked: ExportArguments) -> ExportSummary:
    result, way = source.result, frame_format(source)
    out = asked.out or result.folder.root / "export" / ExportFormat(asked.to).value
    if out.suffix and out.suffix.lower() == way.suffix:
        raise BadInput(f"{out}: expected the name of a folder, for one {way.suffix} a frame")
    root = result.folder.root
    atomic.require_apart([out], (root / name for name in ("normals", "depth", "shadows", "mesh", "track")))
    if out.resolve() == root.resolve():
        raise BadInput(f"{out}: is the result itself; choose another --out")
    numbers = source.numbers_with(way.needs) if way.needs else result.numbers
    cleans = [each.name for each in fields(CleanOptions)]
    values = option_values(asked.part(ExportOptions), without=("clean", *cleans))
    values |= {} if asked.cleaning is None else option_values(asked.cleaning, "cleaning.")
    record = {"version": 1, "options": values, "result_sha256": result.digest}
    has_meshes = way.needs == "mesh"
    if has_meshes and source.track is not None and asked.centre:
        record["camera_position"] = graphics_from_camera(source.offset, source.options.up).round(9).tolist()
    with write_lock(out):
        begin_run(out, EXPORT, record, overwrite=asked.overwrite)
        kept = {number for number in numbers if way.is_current(source, out, number)}
        progress.begin("export", len(numbers), len(kept))
        if source.has_material and source.texture is not None:
            from vntoolkit.io.maps_and_meshes.meshes import write_material

            beside = source.texture.beside(out / _MATERIAL)
            write_material(out / _MATERIAL, beside.albedo, beside.normal)
        for number in numbers:
            if number not in kept:
                way.write(source, way.place(out, number), number)
                progress.step()
        if asked.to is ExportFormat.NPZ and source.track is not None:
            write_tracked_npz(out / "track.npz", source)
    tracked = source.track is not None if has_meshes else None
    return ExportSummary(out=out, frames=len(numbers), kept=len(kept), is_tracked=tracked)


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


@dataclass(frozen=True, kw_only=True)
class FrameFormat:
    """How a frame is written.

    write: of a source to a file, or to a folder where suffix is empty. made_from: folders of the result; a
    file older than theirs is written again. needs: the one of them without which a frame is left out.
    """

    write: Callable[[ExportSource, Path, int], None]
    suffix: str = ""
    made_from: tuple[str, ...] = ("normals",)
    needs: str = ""

    def place(self, out: Path, number: int) -> Path:
        """Return the file or folder of a frame."""
        return out / f"{number:06d}{self.suffix}"

    def is_current(self, source: ExportSource, out: Path, number: int) -> bool:
        """Whether the frame was exported, and is not older than what it is made from."""
        made = self.place(out, number)
        made = made if self.suffix else made / "filenames.txt"  # which is written last
        if not made.exists():
            return False
        folder = source.result.folder
        files = [folder.file(kind, number) for kind in self.made_from]
        if self.needs == "mesh" and source.track is not None:
            files = [folder.root / "track" / "vertices.npy"]
        newest = max((path.stat().st_mtime for path in files if path.exists()), default=0.0)
        return made.stat().st_mtime >= newest


def frame_format(source: ExportSource) -> FrameFormat:
    """Return how frames are written; raise `BadInput` for a result that cannot be."""
    to = source.options.to
    if to in INSPECTED:
        from vntoolkit.pipeline.export_inspection import inspection_format

        return inspection_format(source)
    if to is ExportFormat.PNG:
        return FrameFormat(write=_write_normals, suffix=".png")
    if to is ExportFormat.DILIGENT:
        if source.result.lacks_background:
            raise BadInput("diligent: the result was made with a background; give it as --background")
        source.result.capture  # noqa: B018 - refused before anything is written
        return FrameFormat(write=_write_lights)
    source.lengths  # noqa: B018 - refused before anything is written
    if to is ExportFormat.POINTS:
        return FrameFormat(write=_write_points, suffix=".ply", made_from=("normals", "depth"), needs="depth")
    if to is ExportFormat.NPZ:
        of = ("normals", "depth", "shadows", "mesh")
        return FrameFormat(write=_write_arrays, suffix=".npz", made_from=of)
    return FrameFormat(write=_write_mesh, suffix=f".{to.value}", made_from=("mesh",), needs="mesh")


def _write_mesh(source: ExportSource, path: Path, number: int) -> None:
    """Write PLY, OBJ, STL or GLB, of the registered surface where there is one, else of the frame's mesh."""
    mesh = source.mesh(number)
    if source.options.to is ExportFormat.GLB:
        from vntoolkit.io.maps_and_meshes.glb import write_glb

        rate = source.result.manifest.input.playing_rate_hz
        write_glb(path, mesh, iter([mesh.vertices]), frame_rate_hz=rate, camera=source.camera)
        return
    from vntoolkit.io.maps_and_meshes.meshes import write_mesh

    write_mesh(path, mesh, up=source.options.up, material=_MATERIAL if source.has_material else None)


def _write_points(source: ExportSource, path: Path, number: int) -> None:
    """Write a PLY without faces, coloured where the footage is still at hand."""
    from vntoolkit.io.maps_and_meshes.meshes import write_point_cloud
    from vntoolkit.meshing.surface import point_cloud_from_depth

    result = source.result
    depth_map, normal_map = result.depth(number), result.normals(number)
    assert depth_map is not None
    try:
        rgb = result.linear(number).rgb
    except VntError:
        rgb = None
    cloud = point_cloud_from_depth(depth_map, result.camera, rgb=rgb, normal_map=normal_map)
    cloud = replace(cloud, points=cloud.points * source.lengths.factor)
    write_point_cloud(path, cloud, up=source.options.up)


def _write_normals(source: ExportSource, path: Path, number: int) -> None:
    """Write a 16-bit PNG."""
    convention = source.options.normal_convention
    write_normal_map(path, source.result.normals(number), convention=convention)


def _write_lights(source: ExportSource, path: Path, number: int) -> None:
    """Write a folder with one picture per light: its contribution, as if it had shone alone."""
    from vntoolkit.io.light_files import write_diligent

    result = source.result
    response, known = result.rig.response, result.manifest.known
    strengths: FloatArray = np.linalg.norm(response.lights, axis=1)
    albedo = 1.0 if known.materials else known.relative_albedo or 1.0
    scale = _HEADROOM * max(1.0, float(albedo)) * float(strengths.max())
    rgb = result.linear(number).rgb - response.ambient
    contributions = rgb @ response.contributions_from_rgb.T / scale
    stored = np.rint(np.clip(contributions, 0, 1) * 65535).astype(np.uint16)
    write_diligent(
        path,
        [np.repeat(stored[..., k : k + 1], 3, axis=2) for k in range(3)],
        response.lights / strengths[:, None],
        np.repeat(strengths[:, None] / scale, 3, axis=1),
        result.normals(number),
        source.options.normal_convention,
    )


# The arrays of `--to npz`: of a frame, and of the registered surface.


def _write_arrays(source: ExportSource, path: Path, number: int) -> None:
    """Write everything of a frame as named arrays.

    normals (h, w, 3) in the asked convention, mask, confidence, error_deg; depth along the optical axis,
    depth_mask, depth_error_percent; labels; vertices, faces, vertex_normals, vertex_colours, uv of the
    frame's own mesh in the frame of files; camera_matrix. Parts that the frame lacks are left out.
    """
    from vntoolkit.io.maps_and_meshes.arrays import write_npz

    result, options, factor = source.result, source.options, source.lengths.factor
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
    write_npz(path, {name: np.asarray(values) for name, values in arrays.items() if values is not None})


def write_tracked_npz(path: Path, source: ExportSource) -> None:
    """Write the registered surface: vertices (frames, n, 3), faces, uv, uncertainty_px, frames, times_s,
    frame_rate_hz."""
    from vntoolkit.io.maps_and_meshes.arrays import StreamedArray, write_npz

    track, options, factor = source.track, source.options, source.lengths.factor
    assert track is not None
    wanted = set(source.result.numbers)
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

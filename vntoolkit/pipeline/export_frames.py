"""One exported file or folder per frame: meshes, arrays, normal maps, DiLiGenT-like objects."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray
from vntoolkit.errors import BadInput
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.diligent import write_diligent
from vntoolkit.io.glb import write_glb
from vntoolkit.io.maps import write_normal_map
from vntoolkit.io.meshes import write_mesh
from vntoolkit.io.npz import write_npz
from vntoolkit.pipeline.export_arrays import arrays_of_frame, write_tracked_npz
from vntoolkit.pipeline.export_options import ExportFormat, ExportOptions, file_lengths
from vntoolkit.pipeline.opened_result import OpenedResult, TrackedSurface

_HEADROOM = 1.25  # of a light's picture over the brightest that the rig's material gets


def numbers_with_mesh(result: OpenedResult, track: TrackedSurface | None) -> tuple[int, ...]:
    """Return the opened frames of the registered surface, or those with an own mesh; raise for none."""
    if track is not None:
        opened = set(result.numbers)
        found = tuple(number for number in track.numbers if number in opened)
    else:
        found = tuple(number for number in result.numbers if result.folder.mesh(number).exists())
    if not found:
        root = result.folder.root
        raise BadInput(f"{root}: holds no mesh of those frames; run `vntoolkit reconstruct --to mesh`")
    return found


def own_mesh(result: OpenedResult, number: int) -> Mesh:
    """Return a frame's own mesh, which was there a moment ago."""
    mesh = result.mesh(number)
    if mesh is None:
        raise BadInput(f"frame {number}: its mesh has vanished")
    return mesh


class FrameExport(ABC):
    """Writes one frame at a time; `suffix` of its files, empty for a folder a frame."""

    suffix = ""

    def __init__(self, result: OpenedResult, track: TrackedSurface | None, options: ExportOptions) -> None:
        self.result = result
        self.track = track
        self.options = options

    def numbers(self) -> tuple[int, ...]:
        """Return the frames that there are."""
        return self.result.numbers

    def place(self, out: Path, number: int) -> Path:
        """Return the file or folder of a frame."""
        return out / f"{number:06d}{self.suffix}"

    def last_file(self, out: Path, number: int) -> Path:
        """Return the file that is written last."""
        return self.place(out, number)

    def sources(self, number: int) -> list[Path]:
        """Return the files of the result that the frame is made from."""
        return [self.result.folder.normals(number)]

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
    """PLY, OBJ, or GLB a frame, of the registered surface or the frames' own."""

    def __init__(self, result: OpenedResult, track: TrackedSurface | None, options: ExportOptions) -> None:
        super().__init__(result, track, options)
        self.suffix = f".{options.to.value}"
        self._factor = file_lengths(options, result.length_unit).factor

    def numbers(self) -> tuple[int, ...]:
        return numbers_with_mesh(self.result, self.track)

    def sources(self, number: int) -> list[Path]:
        if self.track is not None:
            return [self.result.folder.root / "track" / "vertices.npy"]
        return [self.result.folder.mesh(number)]

    def write(self, out: Path, number: int) -> None:
        mesh = self.track.mesh(number) if self.track is not None else own_mesh(self.result, number)
        mesh = replace(mesh, vertices=mesh.vertices * self._factor)
        path = self.place(out, number)
        if self.options.to is ExportFormat.GLB:
            rate = self.result.manifest.input.frame_rate_hz
            write_glb(path, mesh, iter([mesh.vertices]), frame_rate_hz=rate)
        else:
            write_mesh(path, mesh, up=self.options.up)


class _NormalMaps(FrameExport):
    """16-bit PNG."""

    suffix = ".png"

    def write(self, out: Path, number: int) -> None:
        normal_map = self.result.normals(number)
        assert normal_map is not None
        path = self.place(out, number)
        write_normal_map(path, normal_map, convention=self.options.normal_convention)


class _Arrays(FrameExport):
    """Everything of a frame as named arrays."""

    suffix = ".npz"

    def __init__(self, result: OpenedResult, track: TrackedSurface | None, options: ExportOptions) -> None:
        super().__init__(result, track, options)
        self.factor = file_lengths(options, result.length_unit).factor

    def sources(self, number: int) -> list[Path]:
        folder = self.result.folder
        return [folder.normals(number), folder.depth(number), folder.shadows(number), folder.mesh(number)]

    def write(self, out: Path, number: int) -> None:
        write_npz(self.place(out, number), arrays_of_frame(self.result, number, self.options, self.factor))

    def finish(self, out: Path) -> None:
        if self.track is not None:
            numbers = self.result.numbers
            write_tracked_npz(out / "track.npz", self.track, numbers, self.options, self.factor)


class _Diligent(FrameExport):
    """Each light's share of the frame as a picture of its own, as if it had shone alone."""

    def __init__(self, result: OpenedResult, track: TrackedSurface | None, options: ExportOptions) -> None:
        super().__init__(result, track, options)
        if "background" in result.manifest.extra_files and result.background is None:
            raise BadInput("diligent: the result was made with a background; give it as --background")
        result.capture  # noqa: B018 - refused before anything is written
        lights = result.rig.response.lights
        strengths: FloatArray = np.linalg.norm(lights, axis=1)
        albedo = result.manifest.options.get("inversion.relative_albedo", 1.0)
        self._scale = _HEADROOM * max(1.0, float(albedo)) * float(strengths.max())
        self._directions = lights / strengths[:, None]
        self._intensities = np.repeat(strengths[:, None] / self._scale, 3, axis=1)

    def last_file(self, out: Path, number: int) -> Path:
        return self.place(out, number) / "filenames.txt"

    def write(self, out: Path, number: int) -> None:
        normal_map = self.result.normals(number)
        assert normal_map is not None
        response = self.result.rig.response
        rgb = self.result.linear(number).rgb - response.ambient
        shares = rgb @ response.contributions_from_rgb.T / self._scale
        stored = np.rint(np.clip(shares, 0, 1) * 65535).astype(np.uint16)
        images = [np.repeat(stored[..., k : k + 1], 3, axis=2) for k in range(3)]
        write_diligent(
            self.place(out, number),
            images,
            self._directions,
            self._intensities,
            normal_map,
            self.options.normal_convention,
        )


def frame_export(result: OpenedResult, track: TrackedSurface | None, options: ExportOptions) -> FrameExport:
    """Return what writes the frames of a format."""
    kinds: dict[ExportFormat, type[FrameExport]] = {
        ExportFormat.NPZ: _Arrays,
        ExportFormat.PNG: _NormalMaps,
        ExportFormat.DILIGENT: _Diligent,
    }
    return kinds.get(options.to, _Meshes)(result, track, options)

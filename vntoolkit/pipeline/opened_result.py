"""A result folder opened for reading: its frames, and the maps and meshes of each frame."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from vntoolkit.arrays import ByteArray, VisibilityLabels
from vntoolkit.errors import BadCapture, BadInput, VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, LengthUnit, NormalMap
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.maps_and_meshes.maps import read_depth_map, read_normal_map
from vntoolkit.io.results.frame_log import FrameEntry, FrameLog
from vntoolkit.io.results.manifest import (
    FRAME_FILES,
    FindingEntry,
    Manifest,
    ReconstructionFolder,
    missing_files,
    numbers_of_ranges,
    read_manifest,
    result_digest,
    rig_of_result,
)
from vntoolkit.io.results.numbered_files import numbers_on_disk
from vntoolkit.options.base import File
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear

if TYPE_CHECKING:
    from vntoolkit.geometry.mesh import Mesh
    from vntoolkit.io.footage.captures import Capture
    from vntoolkit.options.footage import SensorOptions
    from vntoolkit.pipeline.tracked_folder import Tracks

logger = logging.getLogger(__name__)
Map = TypeVar("Map", NormalMap, DepthMap, ByteArray)


@dataclass(frozen=True, eq=False, kw_only=True)
class OpenedResult:
    """A folder that `reconstruct` wrote, with or without tracks.

    numbers: frames with normals on disk, in order. footage: where the capture is now; empty for where it was
    when it was reconstructed. background: as for `open_capture`. Other parts that a frame lacks are None.
    """

    folder: ReconstructionFolder
    manifest: Manifest
    rig: Rig
    numbers: tuple[int, ...]
    footage: str
    background: Path | None = None

    @property
    def camera(self) -> Camera:
        """The camera that the maps and meshes belong to, without distortion."""
        return self.rig.camera.without_distortion()

    @property
    def digest(self) -> str:
        """Which reconstruction it is."""
        return result_digest(self.manifest)

    @cached_property
    def entries(self) -> dict[int, FrameEntry]:
        """What was logged of each frame, skipped ones too."""
        return FrameLog(self.folder.root).entries()

    @cached_property
    def findings(self) -> list[FindingEntry]:
        """What was found wrong, the gravest first: by the run, and with its files since."""
        manifest = self.manifest
        found = [*manifest.known.findings, *manifest.findings]
        if not manifest.finished:
            text = "the run was not finished: the same command goes on where it stopped"
            found.append(FindingEntry(check="unfinished", level="warning", text=text))
        gone = missing_files(self.folder.root, manifest, range(manifest.input.frame_count))
        found += [FindingEntry(check="incomplete", level="warning", text=text) for text in gone]
        return sorted(found, key=lambda finding: ("fatal", "warning", "note").index(finding.level))

    @property
    def lacks_background(self) -> bool:
        """Whether a background was subtracted that is not at hand now, so that `linear` holds it."""
        return "background" in self.manifest.extra_files and self.background is None

    @cached_property
    def frames_to_track(self) -> tuple[int, ...]:
        """The frames asked for, up to the last that has normals and depth. Raises `BadInput` for none."""
        manifest, root = self.manifest, self.folder.root
        asked = numbers_of_ranges(manifest.known.frames or [manifest.frames], manifest.input.frame_count)
        present = [n for n in asked if self.folder.has(n, "normals", "depth")]
        if not present:
            raise BadInput(
                f"{root}: no frame has both normals and depth; run `vntoolkit reconstruct --to depth`"
            )
        return tuple(asked[: asked.index(present[-1]) + 1])

    def normals(self, number: int) -> NormalMap:
        """Read a frame's normals. Raises `BadInput`, as the others do, for a map of another size."""
        path = self.folder.file("normals", number)
        return self._of_camera_size(path, read_normal_map(path))

    def depth(self, number: int) -> DepthMap | None:
        """Read a frame's depth."""
        return self._read_map("depth", number, read_depth_map)

    def labels(self, number: int) -> VisibilityLabels | None:
        """Read a frame's visibility labels."""
        from vntoolkit.io.maps_and_meshes.label_images import read_labels

        return self._read_map("shadows", number, read_labels)

    def materials(self, number: int) -> ByteArray | None:
        """Read the number of the material of each pixel; None where the subject is of the rig's alone."""
        from vntoolkit.io.maps_and_meshes.label_images import read_materials

        return self._read_map("materials", number, read_materials)

    def mesh(self, number: int) -> "Mesh | None":
        """Read a frame's own mesh, before registration."""
        from vntoolkit.io.maps_and_meshes.meshes import read_mesh

        path = self.folder.file("mesh", number)
        return read_mesh(path) if path.exists() else None

    def _read_map(self, kind: str, number: int, reader: Callable[[Path], Map]) -> Map | None:
        path = self.folder.file(kind, number)
        return self._of_camera_size(path, reader(path)) if path.exists() else None

    def _of_camera_size(self, path: Path, content: Map) -> Map:
        height, width = content.shape
        own = self.rig.camera
        if (width, height) != (own.width, own.height):
            raise BadInput(
                f"{path}: {width}×{height} pixels, but the camera has {own.width}×{own.height}; "
                "remove it and run `vntoolkit reconstruct` again: it makes what is missing"
            )
        return content

    @cached_property
    def length_unit(self) -> LengthUnit | None:
        """What a length of 1 in depth and meshes means; None where there is no depth."""
        depths = (self.depth(number) for number in self.numbers if self.folder.has(number, "depth"))
        first = next(depths, None)
        return None if first is None else first.unit

    @cached_property
    def track(self) -> "Tracks | None":
        """The registered moving mesh; None without one, or where it follows another reconstruction."""
        from vntoolkit.pipeline.tracked_folder import read_tracks

        root = self.folder.root / "track"
        if not (root / "track.json").exists():
            return None
        tracks = read_tracks(root)
        if tracks.record.get("result_sha256", self.digest) != self.digest:
            logger.warning(
                "%s: follows an earlier reconstruction and is left out; run `vntoolkit track %s --overwrite`",
                root,
                self.folder.root,
            )
            return None
        return None if tracks.template_vertices is None else tracks.with_uv(self.camera)

    def linear(self, number: int) -> LinearFrame:
        """Return the captured frame in linear light, background removed and undistorted."""
        from vntoolkit.io.footage.decoding import linear_frame_from_encoded, resampler_of

        capture = self.capture
        encoded = capture.encoded(number)
        frame = linear_frame_from_encoded(encoded, self.rig.transfer, capture.background)
        return resampler_of(self.rig).frame(frame)

    def picture(self, number: int) -> ByteArray | None:
        """Return the captured frame as a person would see it, (h, w, 3) sRGB; None without the footage."""
        try:
            linear = np.clip(self.linear(number).rgb, 0, 1)
        except VntError:
            return None
        encoded = encoded_from_linear(linear, Transfer(curve=TransferCurve.SRGB))
        return np.asarray(255 * encoded + 0.5).astype(np.uint8)

    @property
    def source(self) -> str:
        """Where the footage is: as stated, or where a relative name leads from the result or above it."""
        stated = self.manifest.input.source
        if self.footage or Path(stated).exists() or Path(stated).is_absolute():
            return self.footage or stated
        root = self.folder.root.resolve()
        found = (parent / stated for parent in (root, *root.parents) if (parent / stated).exists())
        return str(next(found, stated))

    @cached_property
    def capture(self) -> "Capture":
        """The footage; raise `BadInput` where it is not to be found, or is of another size or length."""
        from vntoolkit.io.footage.captures import CaptureOptions, open_capture
        from vntoolkit.options.footage import Gaps

        source = self.source
        options = CaptureOptions(
            transfer=self.rig.transfer,
            background=None if "matte.key" in self.manifest.options else self.background,
            gaps=Gaps.SKIP,
            sensor=_sensor_of(self.manifest.options),
        )
        try:
            capture = open_capture(source, options)
        except BadCapture as error:
            if Path(source).exists():
                raise
            raise BadCapture(f"{error}; if the footage has moved, give --footage") from error
        stated, info = self.manifest.input, capture.info
        if (info.width, info.height, info.frame_count) != (stated.width, stated.height, stated.frame_count):
            raise BadInput(
                f"{source}: {info.frame_count} frames of {info.width}×{info.height}, but the result was made "
                f"from {stated.frame_count} of {stated.width}×{stated.height}; name the footage it came from"
            )
        return capture

    @property
    def frames(self) -> tuple[int, ...]:
        """Numbers of the frames that have normals, in order."""
        return self.numbers


def read_result(
    folder: File,
    *,
    frames: str | None = None,
    footage: str = "",
    background: Path | None = None,
    says_missing: bool = True,
) -> OpenedResult:
    """Open a folder that `reconstruct` wrote: `.normals(3)`, `.depth(3)`, `.mesh(3)`, `.findings`, `.frames`.

    frames: only those of them, a:b:c. Raises `BadInput` for a folder of another kind. Says which frames are
    recorded as done while their files are gone. says_missing: False where that was said before.
    """
    root = Path(folder)
    manifest = read_manifest(root)
    asked = FrameRange.from_text(frames or "::")
    wanted = asked.numbers(manifest.input.frame_count)
    if says_missing:
        for line in missing_files(root, manifest, wanted):
            logger.warning("%s: incomplete: %s", root, line)
    # a folder may hold frames of an earlier, longer run: those count too
    present = numbers_on_disk(root / "normals", FRAME_FILES["normals"])
    numbers = tuple(number for number in present if number in wanted)
    if not numbers:
        held = (
            f"it holds {len(present)}, from {present[0]} to {present[-1]}" if present else "it holds no frame"
        )
        raise BadInput(f"{root}: holds none of the frames {asked.to_text()}; {held}")
    return OpenedResult(
        folder=ReconstructionFolder(root=root),
        manifest=manifest,
        rig=rig_of_result(manifest),
        numbers=numbers,
        footage=footage,
        background=background,
    )


def _sensor_of(options: Mapping[str, Any]) -> "SensorOptions":
    """Return how the footage of a result was read, of its manifest's options; raise `BadInput`."""
    from vntoolkit.options.footage import SensorOptions

    own = {name: value for name, value in options.items() if name.startswith("sensor.")}
    try:
        return SensorOptions(**{name.removeprefix("sensor."): value for name, value in own.items()})
    except (BadInput, TypeError) as problem:
        raise BadInput(f"reconstruction.json: {problem}") from problem

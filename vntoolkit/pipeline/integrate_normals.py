"""Anyone's normal maps to depth and meshes, in a folder as `reconstruct` writes."""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from os import PathLike
from pathlib import Path

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.checks import require_some
from vntoolkit.diagnosis.axes import likeliest_convention
from vntoolkit.errors import BadInput
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.maps import LengthUnit, NormalMap
from vntoolkit.integration.expected_error import with_expected_depth_error
from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
from vntoolkit.integration.prior import DepthPrior, with_prior_error
from vntoolkit.io.files import read_text
from vntoolkit.io.footage.captures import Capture, open_capture
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.sequence import natural_key, stated_numbers
from vntoolkit.io.maps_and_meshes.maps import read_depth_map
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.maps_and_meshes.stored_normals import (
    SUFFIXES,
    StoredNormals,
    read_stored_normals,
    stored_normals,
)
from vntoolkit.io.results import manifest as manifests
from vntoolkit.io.results.folder import begin_run, option_values, write_lock
from vntoolkit.io.results.frame_log import FrameEntry, FrameLog
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.io.results.reconstruction import (
    RECONSTRUCTION,
    entry_of_files,
    hashed,
    library_versions,
    write_manifest,
)
from vntoolkit.io.rigs import entry_from_rig, read_rig
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.options.depth import IntegrationOptions, MeshOptions
from vntoolkit.options.export import NormalConvention
from vntoolkit.options.normal_maps import IntegrateArguments
from vntoolkit.options.reconstruction import Product
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.outputs import FrameResult, write_frame

logger = logging.getLogger(__name__)
_MOST_BACKWARD = 0.25  # of the normals: more is no noise at the outline, but other axes
_OF_DILIGENT = ("normals.exr", "Normal_gt.mat", "Normal_est.mat", "normal.png", "normal_map.png")


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalSource:
    """Normal maps in order: their files, how many, and what reads some. companions: mask.png and K.txt."""

    files: tuple[Path, ...]
    count: int
    read: Callable[[Sequence[int], Mask | None], Iterator[tuple[int, StoredNormals]]]
    frame_rate_hz: float | None = None
    mask: Path | None = None
    camera: Path | None = None


def open_normals(source: str) -> NormalSource:
    """Find the normal maps of a file, a folder or a video. Raises `BadInput` where there is none."""
    path = Path(source)
    if not path.exists():
        raise BadInput(f"{source}: no such file or folder")
    if path.is_file() and path.suffix.lower() not in SUFFIXES:
        return _video_source(open_capture(source), path)
    files, folder = _files_of(path), path
    if not files:
        raise BadInput(
            f"{source}: expected a normal map ({', '.join(SUFFIXES)}), a folder of them or a video"
        )
    if path.is_file():
        folder = path.parent
    stated = stated_numbers(files)
    if stated and len(set(np.diff(stated))) > 1:
        logger.warning(
            "%s: numbers are missing between %s and %s: the maps become frames 0 to %d in the order of "
            "their names", source, files[0].name, files[-1].name, len(files) - 1,
        )  # fmt: skip

    def read(numbers: Sequence[int], mask: Mask | None) -> Iterator[tuple[int, StoredNormals]]:
        return ((number, read_stored_normals(files[number], mask)) for number in numbers)

    return NormalSource(
        files=files,
        count=len(files),
        read=read,
        mask=_beside(files, folder / "mask.png"),
        camera=_beside(files, folder / "K.txt"),
    )


def _beside(files: tuple[Path, ...], path: Path) -> Path | None:
    """Return a file that belongs to a map in the same folder, if there is one map."""
    return path if len(files) == 1 and path.exists() else None


def _files_of(path: Path) -> tuple[Path, ...]:
    if not path.is_dir():
        return (path,) if path.is_file() else ()
    for name in _OF_DILIGENT:
        if (path / name).exists():
            return (path / name,)
    path = path / "normals" if (path / "normals").is_dir() else path
    maps = (f for f in path.iterdir() if f.suffix.lower() in SUFFIXES and f.name != "mask.png")
    return tuple(sorted(maps, key=natural_key))


def _video_source(capture: Capture, path: Path) -> NormalSource:
    def read(numbers: Sequence[int], mask: Mask | None) -> Iterator[tuple[int, StoredNormals]]:
        wanted = set(numbers)
        for frame in capture.encoded_frames(numbers[0], numbers[-1] + 1):
            if frame.number in wanted:
                yield frame.number, stored_normals(frame.values, mask, name=frame.name)

    info = capture.info
    return NormalSource(files=(path,), count=info.frame_count, read=read, frame_rate_hz=info.frame_rate_hz)


def integrate_normals(asked: IntegrateArguments) -> Path:
    """Integrate the chosen maps one at a time, and write the folder that every later verb reads.

    An interrupted run goes on. The first map is integrated again: later depths are tied to it.
    """
    source = open_normals(str(asked.source))
    frames = FrameRange.from_text(asked.frames or "::")
    numbers = tuple(frames.numbers(source.count))
    require_some(np.ones(len(numbers), np.bool_), f"{asked.source}: frames {frames.to_text()}")
    if asked.prior is not None and len(numbers) > 1:
        raise BadInput(
            f"{asked.source}: --prior is of one normal map, got {len(numbers)}; choose one by --frames"
        )
    mask_file = asked.mask or source.mask
    mask = None if mask_file is None else read_mask(mask_file)
    root = Path(asked.out)
    folder, log = ReconstructionFolder(root=root), FrameLog(root)
    with write_lock(root):
        _, first = next(source.read(numbers[:1], mask))
        if mask_file is not None and asked.mask is None:
            logger.warning("%s: masked by %s beside it", asked.source, mask_file.name)
        convention = settled_convention(first, asked.convention, str(asked.source), "--convention")
        integrator = _FrameIntegrator(asked, _camera_of(asked, source, first.mask.shape), convention)
        manifest = _manifest(asked, source, integrator.rig, mask_file)
        goes_on = begin_run(root, RECONSTRUCTION, manifest, overwrite=asked.overwrite)
        kept = (
            {n for n in numbers if n in log.done() and folder.has(n, *manifest.outputs)} if goes_on else set()
        )
        progress.begin("integrate", len(numbers), len(kept))
        rest = [n for n in numbers[1:] if n not in kept]
        started = time.perf_counter()
        for number, stored in chain([(numbers[0], first)], source.read(rest, mask) if rest else ()):
            result = integrator.frame(number, stored)
            if number in kept:
                continue
            write_frame(folder, result)
            entry = FrameEntry(
                number=number,
                seconds=time.perf_counter() - started,
                valid_share=float(result.normal_map.mask.mean()),
            )
            log.append(entry)
            progress.step()
            started = time.perf_counter()
        log.close()
        write_manifest(root, manifest.model_copy(update={"finished": manifests.now_utc()}))
    return root


class _FrameIntegrator:
    """From vectors of a file to depth and a mesh, all frames by one camera and one convention."""

    def __init__(self, asked: IntegrateArguments, camera: Camera, convention: NormalConvention) -> None:
        self._asked, self._camera = asked, camera
        self._signs = np.array(convention.signs, np.float32)
        self._integrator = DepthIntegrator(camera, asked.part(IntegrationOptions))
        self._prior = _read_prior(asked, camera)
        self._anchor: DepthAnchor | None = None
        # a picture of normals is what three lamps along the axes would make: n = 2 value − 1
        half = 0.5 * np.array(convention.signs)
        response = LightResponse(matrix=np.diag(half), ambient=np.full(3, 0.5))
        self.rig = Rig(camera=camera, response=response)

    def frame(self, number: int, stored: StoredNormals) -> FrameResult:
        """Return normals, depth, and a mesh if asked for."""
        normal_map = self._normal_map(number, stored)
        depth_map = self._integrator.integrate(normal_map, prior=self._prior)
        if self._prior is None:
            self._anchor = self._anchor or DepthAnchor(depth_map)
            depth_map = self._anchor.align(depth_map, self._integrator.parts)
        if normal_map.error_deg is not None:
            depth_map = with_expected_depth_error(depth_map, normal_map, self._camera)
        if self._prior is not None:
            depth_map = with_prior_error(depth_map, self._prior)
        if depth_map.unit is LengthUnit.FREE and self._asked.distance is not None:
            scaled = depth_map.depth * self._asked.distance
            depth_map = replace(depth_map, depth=scaled, unit=LengthUnit.METRE)
        result = FrameResult(number=number, normal_map=normal_map, clipped_share=0.0, depth_map=depth_map)
        if self._asked.to is not Product.MESH:
            return result
        rgb = np.asarray(0.5 + 0.5 * stored.vectors, np.float32)
        mesh = mesh_from_depth(
            depth_map, self._camera, rgb=rgb, normal_map=normal_map, options=self._asked.part(MeshOptions)
        )
        return replace(result, mesh=mesh)

    def _normal_map(self, number: int, stored: StoredNormals) -> NormalMap:
        """Return the normals in the camera frame, without those that face away."""
        normals = stored.vectors * self._signs
        backward = stored.mask & (normals[..., 2] >= 0)
        share = float(backward.sum()) / float(stored.mask.sum())
        if share > _MOST_BACKWARD:
            raise BadInput(
                f"frame {number}: {share:.0%} of the normals face away from the viewer; give --convention "
                "opengl, directx or opencv, or a --mask of the subject"
            )
        if share > 0:
            logger.warning("frame %d: %.2g %% of the normals face away: left out", number, 100 * share)
        mask = stored.mask & ~backward
        return NormalMap(
            normals_in_camera=normals * mask[..., None],
            mask=mask,
            weight=stored.weight,
            error_deg=None if stored.error_deg is None else np.where(mask, stored.error_deg, 0),
        )


def settled_convention(
    stored: StoredNormals, given: NormalConvention | None, name: str | PathLike[str], flag: str
) -> NormalConvention:
    """Return the axes of a map: given, stated by its file, or the likeliest; say what was assumed."""
    for note in stored.notes:
        logger.warning("%s: %s", name, note)
    convention = given or stored.convention
    if convention is None:
        convention, why = likeliest_convention(stored.vectors, stored.mask)
        logger.warning("%s: read as %s (%s); %s decides", name, convention.value, why, flag)
    return convention


def _read_prior(asked: IntegrateArguments, camera: Camera) -> DepthPrior | None:
    """Read depth that is known, in the camera's unit, with its error."""
    if asked.prior is None:
        if asked.prior_error is not None:
            raise BadInput("prior error: give --prior, the depth that it belongs to")
        return None
    if asked.distance is not None:
        raise BadInput("prior: it states the distance; give --prior or --distance, not both")
    depth = read_depth_map(asked.prior)
    wanted = (camera.height, camera.width)
    _require_prior_size(asked.prior, depth.shape, wanted)
    if depth.unit is LengthUnit.FREE:
        raise BadInput(f"{asked.prior}: its scale is free; expected depth in metres")
    unit = "metres" if camera.is_perspective else "pixels"
    error: FloatArray | float
    if asked.prior_error is None:
        if depth.error_percent is None:
            raise BadInput(f"{asked.prior}: it states no error; give --prior-error, a number or an EXR")
        error = depth.error_percent * (float(np.ptp(depth.depth[depth.mask])) / 100.0)
    else:
        try:
            error = float(asked.prior_error) * (1e-3 if camera.is_perspective else 1.0)
        except ValueError:  # the name of a file
            stated = read_depth_map(asked.prior_error)
            _require_prior_size(Path(asked.prior_error), stated.shape, wanted)
            depth, error = replace(depth, mask=depth.mask & stated.mask), stated.depth
    logger.warning(
        "%s: depth in %s, median %.4g, %.0f %% of the pixels, error %.3g", asked.prior, unit,
        np.median(depth.depth[depth.mask]), 100.0 * depth.mask.mean(), np.median(error),
    )  # fmt: skip
    return DepthPrior(depth=depth.depth, mask=depth.mask, error=error)


def _require_prior_size(path: Path, shape: tuple[int, int], wanted: tuple[int, int]) -> None:
    if shape != wanted:
        raise BadInput(
            f"{path}: expected {wanted[1]}×{wanted[0]}, the size of the normals, got {shape[1]}×{shape[0]}"
        )


def _camera_of(asked: IntegrateArguments, source: NormalSource, shape: tuple[int, ...]) -> Camera:
    height, width = shape
    if asked.focal_px is not None:
        if asked.camera is not None:
            raise BadInput("camera: give --camera or --focal-px, not both")
        return Camera.pinhole(width=width, height=height, focal_px=asked.focal_px)
    given = asked.camera or source.camera
    if given is None:
        logger.warning(
            "%s: taken for orthographic; give --focal-px or --camera where it is perspective", asked.source
        )
        return Camera.orthographic(width=width, height=height)
    if given.suffix.lower() == ".json":
        rig = read_rig(given)
        rig.require_size(width, height, str(asked.source))
        return rig.camera
    return Camera(model=CameraModel.PINHOLE, width=width, height=height, matrix=read_camera_matrix(given))


def read_camera_matrix(path: Path) -> "np.ndarray[tuple[int, ...], np.dtype[np.float64]]":
    """Read the nine numbers of K from a text file."""
    words = read_text(path).replace(",", " ").split()
    try:
        return np.array([float(word) for word in words]).reshape(3, 3)
    except ValueError as error:
        raise BadInput(
            f"{path}: expected the 9 numbers of a 3 × 3 camera matrix, got {len(words)} words"
        ) from error


def _manifest(
    asked: IntegrateArguments, source: NormalSource, rig: Rig, mask_file: Path | None
) -> manifests.Manifest:
    written = ["normals", "depth", *(["mesh"] if asked.to is Product.MESH else [])]
    options = option_values(asked.part(IntegrationOptions), "integration.")
    options |= option_values(asked.part(MeshOptions), "meshing.")
    return manifests.Manifest(
        input=manifests.InputEntry(
            source=str(asked.source),
            files=hashed(source.files),
            width=rig.camera.width,
            height=rig.camera.height,
            frame_count=source.count,
            frame_rate_hz=source.frame_rate_hz,
        ),
        extra_files={
            name: entry_of_files(file, (file,))
            for name, file in (("mask", mask_file), ("prior", asked.prior))
            if file is not None
        },
        rig=entry_from_rig(rig),
        options=options | {"distance_m": asked.distance, "prior_error": asked.prior_error},
        frames=FrameRange.from_text(asked.frames or "::").to_text(),
        outputs=written,
        versions=library_versions(),
        started=manifests.now_utc(),
    )

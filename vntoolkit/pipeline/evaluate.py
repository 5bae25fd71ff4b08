"""Normals, cylinders, tracks and depth against references, frame by frame in constant memory."""

import logging
from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import Faces, FloatArray, Mask, Points, Vector3
from vntoolkit.checks import require_same_size, require_shape, require_some
from vntoolkit.diagnosis.axes import warn_of_flipped_axes
from vntoolkit.errors import BadInput
from vntoolkit.evaluation import angular_error, track_error
from vntoolkit.evaluation.cylinder import (
    Cylinder,
    axis_error_deg,
    radius_from_distance,
    side_angles,
    silhouette_from_image,
)
from vntoolkit.evaluation.cylinder_fit import fit_cylinder
from vntoolkit.evaluation.depth_error import disc_with_hole, peaks, tear
from vntoolkit.geometry.camera import Camera, CameraModel
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import read_json
from vntoolkit.io.maps_and_meshes.arrays import map_npy, read_npz
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.maps_and_meshes.stored_normals import SUFFIXES, read_stored_normals
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.depth import IntegrationOptions, Integrator
from vntoolkit.options.export import NormalConvention
from vntoolkit.pipeline.integrate_normals import read_camera_matrix, settled_convention
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.pipeline.simulate import SimulationFolder
from vntoolkit.pipeline.tracked_folder import read_tracks
from vntoolkit.pipeline.truth_comparison import true_normals

logger = logging.getLogger(__name__)
_SEED = 0  # the same folder gives the same numbers
TEAR_STEEPNESS = 1.0
_OBJECT_FILES = ("normal_map.png", "mask.png", "K.txt", "depth_gt.npz")


NormalPair = tuple[str, Path, Path]  # name of a frame, its measured map, its reference


@dataclass(frozen=True, kw_only=True, eq=False)
class NormalsComparison:
    """All frames. overall: over all pixels of all frames. curve_deg: (1000,) angles by rank. worst: name of
    the frame with the largest mean, its map of angles (h, w) in degrees and where they are valid.
    """

    overall: angular_error.AngularError
    frames: dict[str, angular_error.AngularError]
    curve_deg: FloatArray
    worst: str
    worst_deg: FloatArray
    worst_mask: Mask


def pairs_of(measured: Path, reference: Path) -> list[NormalPair]:
    """Pair two files, or the files of two folders by their names.

    A folder may be that of `reconstruct` or `simulate`; then its normals are taken. Raises `BadInput` where
    nothing pairs up.
    """
    if not measured.is_dir() and not reference.is_dir():
        return [(measured.stem, measured, reference)]
    if not (measured.is_dir() and reference.is_dir()):
        raise BadInput(f"{measured}, {reference}: give two files or two folders, not one of each")
    ours, theirs = _maps_in(measured), _maps_in(reference)
    names = [name for name in ours if name in theirs]
    if not names:
        raise BadInput(
            f"{measured} holds {len(ours)} normal maps and {reference} {len(theirs)}, none of one name: "
            "files are paired by their names without suffix"
        )
    return [(name, ours[name], theirs[name]) for name in names]


def compare_normal_files(
    pairs: list[NormalPair],
    conventions: tuple[NormalConvention | None, NormalConvention | None] = (None, None),
) -> NormalsComparison:
    """Compare pairs one at a time. conventions: of the measured and the reference files, None for as stated.

    Raises `BadInput`, with the files, for maps of different size or without a common valid pixel.
    """
    histogram, frames = angular_error.AngleHistogram(), {}
    worst, worst_mean = None, -1.0
    for name, angles, both in progress.counted(_angle_maps(pairs, conventions), "normals", len(pairs)):
        frames[name] = angular_error.summarise_angles(angles[both])
        histogram.add(angles[both])
        if frames[name].mean_deg > worst_mean:
            worst, worst_mean = (name, angles, both), frames[name].mean_deg
    if worst is None:
        raise BadInput("evaluate normals: no pair of maps was given")
    overall = next(iter(frames.values())) if len(frames) == 1 else histogram.summary()
    return NormalsComparison(
        overall=overall,
        frames=frames,
        curve_deg=histogram.values(),
        worst=worst[0],
        worst_deg=worst[1],
        worst_mask=worst[2],
    )


def _angle_maps(
    pairs: list[NormalPair], conventions: tuple[NormalConvention | None, NormalConvention | None]
) -> Iterator[tuple[str, FloatArray, Mask]]:
    """Axes and encoding are settled on the first map of each side."""
    flags = ("--measured-convention", "--reference-convention")
    settled: list[NormalConvention] = []
    for name, *paths in pairs:
        found = [read_stored_normals(path) for path in paths]
        settled = settled or [
            settled_convention(*each) for each in zip(found, conventions, paths, flags, strict=True)
        ]
        maps = [
            NormalMap(
                normals_in_camera=stored.vectors * np.array(convention.signs, np.float32), mask=stored.mask
            )
            for stored, convention in zip(found, settled, strict=True)
        ]
        try:
            angles, both = angular_error.angular_error_map(*maps)
        except BadInput as problem:
            raise BadInput(f"{paths[0]}, {paths[1]}: {problem}") from problem
        yield name, angles, both


def _maps_in(folder: Path) -> dict[str, Path]:
    inner = next((folder / part for part in ("normals", "truth/normals") if (folder / part).is_dir()), folder)
    files = sorted(path for path in inner.iterdir() if path.suffix.lower() in SUFFIXES)
    return {path.stem: path for path in files}


@dataclass(frozen=True, kw_only=True)
class TrueDeviation:
    """One frame against the simulator: of the fit's axis, of its radius, and of all normals."""

    axis_deg: float
    radius_percent: float
    normals_mean_deg: float
    normals_std_deg: float


@dataclass(frozen=True, kw_only=True)
class CylinderFrameError:
    """One frame: angles between its normals and the fitted cylinder's. truth: where it is known."""

    frame: int
    pixels: int
    mean_deg: float
    std_deg: float
    truth: TrueDeviation | None = None


@dataclass(frozen=True, kw_only=True)
class CylinderEvaluation:
    """A sequence: mean and standard deviation over all pixels of all frames; radius as the fit states it.

    times_s: when each frame was filmed, from the first of them.
    """

    radius: float
    times_s: tuple[float, ...]
    mean_deg: float
    std_deg: float
    frames: tuple[CylinderFrameError, ...]


@dataclass(frozen=True, kw_only=True)
class CylinderTruth:
    """The folder that `simulate` wrote for a cylinder whose axis is the object's y axis."""

    folder: SimulationFolder

    @cached_property
    def poses(self) -> FloatArray:
        """(frames, 4, 4) camera_from_object."""
        path = self.folder.truth / "poses.json"
        content = read_json(path)
        try:
            poses = np.array(content["camera_from_object"], dtype=np.float64)
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"{path}: expected camera_from_object, a 4 × 4 matrix a frame") from error
        require_shape(poses, (None, 4, 4), f"{path}: camera_from_object")
        return poses

    @cached_property
    def radius_m(self) -> float:
        """Radius in metres."""
        path = self.folder.truth / "scene.json"
        content = read_json(path)
        try:
            scene, facts = content["scene"], content["facts"]
            if scene == "cylinder":
                return float(facts["radius_m"])
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(f"{path}: expected scene, and facts with the radius_m of a cylinder") from error
        raise BadInput(f"{self.folder.root}: holds the scene {scene}, not a cylinder")

    def axis(self, number: int) -> tuple[Vector3, Vector3]:
        """Return direction and a point of the axis in the camera frame, metres."""
        if number >= len(self.poses):
            raise BadInput(
                f"{self.folder.root}: has {len(self.poses)} frames, the reconstruction frame {number}"
            )
        return self.poses[number, :3, 1], self.poses[number, :3, 3]


# Figure 7: normals of a sequence against one fitted cylinder, and the fit against the truth.


def evaluate_cylinder(result: OpenedResult, simulated: Path | None = None) -> CylinderEvaluation:
    """Fit one cylinder to all frames of a reconstruction and measure their normals against it.

    Measured are the pixels that hold a normal, within the silhouette, on the cylinder's side.

    simulated: folder that `simulate` wrote, for the truth. Raises `BadInput`, `SolverFailed` with the frame's
    place.
    """
    truth = None if simulated is None else CylinderTruth(folder=SimulationFolder(root=simulated))
    if truth is not None:
        truth.radius_m  # noqa: B018 - another scene is refused before minutes of fitting
    progress.begin("cylinder", 2 * len(result.numbers))  # each is fitted, then measured
    seen_of_all = (seen for _, seen in _observations(result))
    fits = fit_cylinder(seen_of_all, result.camera, np.random.default_rng(_SEED))
    frames, total = [], np.zeros(3)
    for cylinder, (number, seen) in zip(fits, _observations(result), strict=True):
        normal_map, silhouette = seen
        subject = replace(normal_map, mask=normal_map.mask & (silhouette > 0.5))
        angles_deg, side = side_angles(cylinder, subject, result.camera, f"frame {number}")
        angles = angles_deg[side]
        total += [len(angles), angles.sum(), (angles**2).sum()]
        frames.append(
            CylinderFrameError(
                frame=number,
                pixels=len(angles),
                mean_deg=float(angles.mean()),
                std_deg=float(angles.std()),
                truth=None if truth is None else _deviation(cylinder, normal_map, truth, result, number),
            )
        )
    mean = total[1] / total[0]
    return CylinderEvaluation(
        radius=fits[0].radius,
        times_s=tuple(result.manifest.input.times_of([frame.frame for frame in frames]).tolist()),
        mean_deg=float(mean),
        std_deg=float(np.sqrt(max(total[2] / total[0] - mean**2, 0.0))),
        frames=tuple(frames),
    )


def _observations(result: OpenedResult) -> Iterator[tuple[int, tuple[NormalMap, FloatArray]]]:
    """Number, normals and silhouette of every frame; without footage the normals' mask is the silhouette."""
    from_image = True
    for number in result.numbers:
        normal_map = result.normals(number)
        silhouette: FloatArray = normal_map.mask.astype(np.float64)
        if from_image:
            try:
                linear = result.linear(number)
            except BadInput as problem:
                logger.info("the silhouettes are those of the normal maps: %s", problem)
                from_image = False
            else:
                silhouette = silhouette_from_image(linear.rgb)
        yield number, (normal_map, silhouette)
        progress.step()


def _deviation(
    cylinder: Cylinder, normal_map: NormalMap, truth: CylinderTruth, result: OpenedResult, number: int
) -> TrueDeviation:
    direction, point = truth.axis(number)
    error = angular_error.compare_normals(normal_map, true_normals(truth.folder.root, number))
    radius = radius_from_distance(cylinder, result.camera, point)
    return TrueDeviation(
        axis_deg=axis_error_deg(cylinder, direction),
        radius_percent=100.0 * (radius / truth.radius_m - 1.0),
        normals_mean_deg=error.mean_deg,
        normals_std_deg=error.std_deg,
    )


# Tracks against the simulator's vertices, frame by frame.


def read_track_truth(folder: Path) -> tuple[Points, Faces, Camera]:
    """Open DIR/truth (or DIR) as `vntoolkit simulate` writes it. Raises `BadInput`.

    Return the vertices (frames, n, 3) in the camera frame, mapped from disk, the faces and the camera.
    """
    truth = folder / "truth" if (folder / "truth").is_dir() else folder
    if not (truth / "vertices.npy").exists():
        raise BadInput(f"{folder}: holds no truth; give the folder that `vntoolkit simulate` wrote")
    vertices = map_npy(truth / "vertices.npy")
    faces = read_mesh(truth / "template.ply").faces
    if vertices.ndim != 3 or vertices.shape[2] != 3 or int(faces.max(initial=0)) >= vertices.shape[1]:
        raise BadInput(f"{truth / 'vertices.npy'}: expected (frames, vertices, 3) of the mesh template.ply")
    return vertices, faces, read_rig(truth / "rig.json").camera


def evaluate_tracks(track_folder: Path, truth_folder: Path, every: int = 1) -> list[track_error.TrackError]:
    """Evaluate every `every`-th tracked frame and the last. Raises `BadInput` where the two differ."""
    (truth, faces, camera), tracks = read_track_truth(truth_folder), read_tracks(track_folder)
    sequence, numbers = tracks.sequence, tracks.numbers
    if not numbers or max(numbers) >= len(truth):
        raise BadInput(
            f"{track_folder}: its frames reach {max(numbers, default=0)}, the truth has {len(truth)}"
        )
    if tracks.template_vertices is None:
        raise BadInput(f"{track_folder}: the template frame {tracks.template} is not tracked yet")
    believed = tracks.camera
    template = believed.project(tracks.template_vertices)
    anchors = track_error.anchors_on_mesh(template, np.array(truth[tracks.template]), faces, camera)
    rows = sorted({*range(0, len(numbers), every), len(numbers) - 1})
    return list(
        track_error.track_errors(
            (_pixels(sequence, row, numbers[row], believed) for row in rows),
            ((numbers[row], np.array(truth[numbers[row]])) for row in rows),
            anchors, faces, camera, tracks.lost_px,
        )
    )  # fmt: skip


def _pixels(sequence: MeshSequence, row: int, number: int, camera: Camera) -> track_error.TrackedPixels:
    uncertainty = None if sequence.uncertainty_px is None else np.array(sequence.uncertainty_px[row])
    positions = camera.project(sequence.vertices[row])
    return track_error.TrackedPixels(frame=number, positions_px=positions, uncertainty_px=uncertainty)


def write_track_errors(path: Path, errors: list[track_error.TrackError]) -> None:
    """Write a table of tab-separated values, one frame a line; its columns are `TrackError`'s."""
    lines = ["\t".join(field.name for field in fields(track_error.TrackError))]
    for error in errors:
        cells = (f"{v:.4f}" if isinstance(v, float) else str(v) for v in vars(error).values())
        lines.append("\t".join(cells))
    write_text(path, "\n".join(lines) + "\n")


@dataclass(frozen=True, kw_only=True, eq=False)
class SurfaceError:
    """Depth errors of one integrator on one surface, in percent of its range, free offset removed.

    numbers: largest and rms after the mean is removed, mean after the median is. distances_percent: (h, w),
    0 outside mask.
    """

    surface: str
    is_torn: bool
    integrator: str
    numbers: dict[str, float]
    distances_percent: FloatArray
    mask: Mask


@dataclass(frozen=True, kw_only=True)
class ObjectError:
    """Absolute depth errors in millimetres on a real object, free scale set by the median."""

    name: str
    integrator: str
    pixels: int
    mean_mm: float
    median_mm: float


# Depth errors of every integrator, on analytic surfaces and on real scanned objects.


def surface_errors(size: int) -> Iterator[SurfaceError]:
    """Integrate smooth hills, whole and on a disc with a hole, and a torn surface, each by what can."""
    if size < 16:
        raise BadInput(f"evaluate integration: expected surfaces of at least 16 pixels, got {size}")
    hills, torn = peaks(size), tear(size, TEAR_STEEPNESS)
    full: Mask = np.ones((size, size), dtype=np.bool_)
    masked = (Integrator.POISSON, Integrator.DISCONTINUITY)
    plans = [
        (f"hills {size}", hills, full, tuple(Integrator)),
        (f"hills on a disc with a hole {size}", hills, disc_with_hole(size), masked),
        (f"torn {size}", torn, full, tuple(Integrator)),
    ]
    camera = Camera.orthographic(width=size, height=size)
    progress.begin("surfaces", sum(len(integrators) for *_, integrators in plans))
    for name, surface, mask, integrators in plans:
        depth, normals = surface
        normal_map = NormalMap(normals_in_camera=normals, mask=mask)
        for integrator in integrators:
            options = IntegrationOptions(integrator=integrator)
            found = DepthIntegrator(camera, options).integrate(normal_map)
            difference = found.depth.astype(np.float64) - depth
            inside, percent = difference[found.mask], 100.0 / float(np.ptp(depth[found.mask]))
            centred = percent * (inside - inside.mean())
            distances = np.where(found.mask, percent * np.abs(difference - np.median(inside)), 0.0)
            yield SurfaceError(
                surface=name,
                is_torn=surface is torn,
                integrator=integrator.value,
                numbers={
                    "mean": float(distances[found.mask].mean()),
                    "rms": float(np.sqrt((centred**2).mean())),
                    "largest": float(np.abs(centred).max()),
                },
                distances_percent=distances,
                mask=found.mask,
            )
            progress.step()


def objects_in(folder: Path) -> list[Path]:
    """Return the folders of objects with known depth. Raises `BadInput` where there is none."""
    found = [
        path
        for path in sorted(folder.iterdir() if folder.is_dir() else ())
        if all((path / name).exists() for name in _OBJECT_FILES)
    ]
    if not found:
        raise BadInput(f"{folder}: holds no folder with {', '.join(_OBJECT_FILES)}")
    return found


def read_object(folder: Path) -> tuple[Camera, NormalMap, FloatArray]:
    """Read camera, normals and true depth (h, w) in mm, NaN where unknown, of one real object."""
    mask = read_mask(folder / "mask.png")
    normal_map = read_normal_map(folder / "normal_map.png", mask=mask)
    warn_of_flipped_axes(folder / "normal_map.png", normal_map)
    height, width = mask.shape
    matrix = read_camera_matrix(folder / "K.txt")
    camera = Camera(model=CameraModel.PINHOLE, width=width, height=height, matrix=matrix)
    truth = read_npz(folder / "depth_gt.npz", "depth_gt").astype(np.float64)
    require_same_size(truth, f"{folder / 'depth_gt.npz'}", mask, "the mask")
    return camera, normal_map, truth


def real_object_errors(folder: Path) -> list[ObjectError]:
    """Integrate one real object without and with steps, and compare with the scanned depth."""
    camera, normal_map, truth = read_object(folder)
    seen = normal_map.mask & np.isfinite(truth)
    require_some(seen, f"{folder}: pixels with normal and depth")
    errors = []
    for integrator in (Integrator.POISSON, Integrator.DISCONTINUITY):
        options = IntegrationOptions(integrator=integrator)
        found = DepthIntegrator(camera, options).integrate(normal_map).depth[seen]
        distances = np.abs(found * np.median(truth[seen] / found) - truth[seen])
        errors.append(
            ObjectError(
                name=folder.name,
                integrator=integrator.value,
                pixels=int(seen.sum()),
                mean_mm=float(distances.mean()),
                median_mm=float(np.median(distances)),
            )
        )
    return errors

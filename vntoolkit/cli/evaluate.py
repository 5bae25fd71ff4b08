"""`vntoolkit evaluate …`: compare normals, meshes, cylinders, tracks and depth with a reference."""

import dataclasses
import logging
from dataclasses import dataclass, field
from operator import attrgetter
from pathlib import Path
from typing import Annotated

import numpy as np

from vntoolkit import progress
from vntoolkit.arrays import FloatArray
from vntoolkit.cli.output import (
    print_next,
    print_table,
    require_output,
    say,
    unused,
    write_json,
)
from vntoolkit.cli.verb import verb
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.evaluation import mesh_comparison
from vntoolkit.evaluation.angular_error import AngularError
from vntoolkit.evaluation.track_error import TrackError
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.results.folder import write_lock
from vntoolkit.options.base import File, Named, OptionalFile, Options, as_path, named, within
from vntoolkit.options.evaluation import Alignment, AlignmentName, MeasuredBy, MeasuredByName
from vntoolkit.options.export import NormalConvention, NormalConventionName
from vntoolkit.options.footage import MeshLimits, PictureLimits
from vntoolkit.options.shared import FrameOptions, MovedFootageOptions
from vntoolkit.pipeline import evaluate
from vntoolkit.pipeline.evaluate import evaluate_cylinder as run
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.report import figures

_LOGGER = logging.getLogger(__name__)

COLUMNS = ["", "pixels", "mean", "median", "std", "95 %", "< 5°", "< 10°", "< 20°"]

_OUT = Path("evaluation")
_SEED = 0  # of the vertices sampled for the alignment
_LINES, _TRACK_LINES = 10, 12  # of a table on the screen; the file has all frames


@dataclass(frozen=True, kw_only=True)
class _Written(Options):
    """Where an evaluation is written."""

    out: File = _OUT
    """Folder to write."""


@dataclass(frozen=True, kw_only=True)
class NormalsArguments(_Written, PictureLimits):
    """What `evaluate_normal_files` takes."""

    measured: File = field(kw_only=False)
    """A normal map as `integrate` reads them, or a folder of them, such as `vntoolkit reconstruct` writes."""
    reference: File = field(kw_only=False)
    """The reference: a map or a folder, such as `vntoolkit simulate` writes. Files are paired by name."""
    measured_convention: Named[NormalConvention | None, NormalConventionName | None] = named(None)
    """Axes of the measured map. Default: those that the file states, else what the first map itself tells."""
    reference_convention: Named[NormalConvention | None, NormalConventionName | None] = named(None)
    """Axes of the reference."""


@verb(NormalsArguments)
def evaluate_normal_files(asked: NormalsArguments) -> evaluate.NormalsComparison:
    """Print the angles in degrees between two normal maps, or between two folders of normal maps.

    Writes normals.json, the map of the worst frame's errors (normals_map.png) and the cumulative curve
    (normals_curve.png).
    """
    measured, reference, out = Path(asked.measured), Path(asked.reference), Path(asked.out)
    require_output(out / "normals.json")
    with write_lock(out):
        pairs = evaluate.pairs_of(measured, reference)
        found = evaluate.compare_normal_files(pairs, (asked.measured_convention, asked.reference_convention))
        content = {"measured": measured, "reference": reference}
        write_json(out / "normals.json", {**content, "overall": found.overall, "frames": found.frames})
        title = f"{found.worst}: mean {found.frames[found.worst].mean_deg:.2f}°"
        figures.write_error_map(out / "normals_map.png", found.worst_deg, found.worst_mask, title, "degrees")
        title = f"{measured.name} against {reference.name}"
        figures.write_cumulative_errors(
            out / "normals_curve.png", {"all frames": found.curve_deg}, title, "degrees"
        )
    step = max(1, -(-len(found.frames) // _LINES))
    rows = [error_row(name, error) for name, error in list(found.frames.items())[::step]]
    if len(found.frames) > 1:
        rows.append(error_row("all", found.overall))
    print_table("degrees between the normals", COLUMNS, rows)
    say(f"{asked.out}: normals.json, normals_map.png, normals_curve.png")
    _print_what_is_next(measured)
    return found


def error_row(name: str, error: AngularError) -> list[str]:
    """Return the cells of one row of `COLUMNS`."""
    angles = (error.mean_deg, error.median_deg, error.std_deg, error.p95_deg)
    shares = (error.below_5, error.below_10, error.below_20)
    return [name, str(error.pixels), *(f"{a:.2f}" for a in angles), *(f"{100 * s:.1f}%" for s in shares)]


@dataclass(frozen=True, kw_only=True)
class MeshArguments(_Written, MeshLimits):
    """What `evaluate_mesh` takes."""

    mesh: File = field(kw_only=False)
    """A PLY or OBJ file."""
    reference: File | None = field(default=None, kw_only=False)
    """The mesh to compare with. Without it, only the quality is measured."""
    measured_by: Named[MeasuredBy, MeasuredByName] = named(MeasuredBy.EMBREE)
    """embree: nearest points by Open3D, at any distance. pymeshlab: nearest points by MeshLab."""
    align: Named[Alignment, AlignmentName] = named(Alignment.NONE)
    """What may move: nothing, position and orientation (rigid), or the scale too (similarity)."""


@dataclass(frozen=True, kw_only=True)
class MeshEvaluation:
    """Distances to the reference, None without one; scale: of the alignment; quality: by a mesh's name."""

    distance: mesh_comparison.MeshDistance | None
    scale: float
    quality: dict[str, mesh_comparison.MeshQuality]


@verb(MeshArguments)
def evaluate_mesh(asked: MeshArguments) -> MeshEvaluation:
    """Print the distances between a mesh and a reference, in both directions, and the quality of both.

    A distance goes from a vertex of one mesh to the nearest point on the faces of the other. A file without
    faces is a point cloud: distances to it go to its points. Quality counts holes, non-manifold edges and the
    like. Writes mesh.json and mesh_curve.png.
    """
    mesh, out = Path(asked.mesh), Path(asked.out)
    reference = as_path(asked.reference)
    require_output(out / "mesh.json")
    with write_lock(out):
        measured = _read(mesh)
        if reference is None and not isinstance(measured, Mesh):
            raise BadMesh(f"{mesh}: expected a surface, got {len(measured.points)} vertices and no face")
        same_name = reference is not None and reference.name == mesh.name  # such as 000000.ply of two folders
        name = str if same_name else attrgetter("name")
        surfaces = {name(mesh): measured}
        content: dict[str, object] = {"mesh": mesh, "reference": reference}
        distance, scale = None, 1.0
        if reference is not None:
            surfaces[name(reference)] = target = _read(reference)
            distance, scale, to_reference = _compared(asked, measured, target)
            content |= {"distance": distance_summary(distance), "scale": scale}
            percent = 100.0 / distance.diagonal * to_reference
            figures.write_cumulative_errors(
                out / "mesh_curve.png", {name(mesh): percent}, f"to {name(reference)}", "% of the diagonal"
            )
        quality = {
            each: mesh_comparison.mesh_quality(surface)
            for each, surface in surfaces.items()
            if isinstance(surface, Mesh)
        }
        write_json(out / "mesh.json", {**content, "quality": quality})
    found = MeshEvaluation(distance=distance, scale=scale, quality=quality)
    _print_mesh(asked, found)
    return found


def _compared(
    asked: MeshArguments, measured: mesh_comparison.Compared, target: mesh_comparison.Compared
) -> tuple[mesh_comparison.MeshDistance, float, FloatArray]:
    """Return the distances both ways, the scale of the alignment, and the distance of each vertex."""
    if why := mesh_comparison.mismatch(measured, target):
        _LOGGER.warning("%s", why)
    generator = np.random.default_rng(_SEED)
    aligned, motion = mesh_comparison.align_mesh(measured, target, generator, asked.align)  # type: ignore[type-var]
    to_reference = mesh_comparison.vertex_distances(aligned, target, asked.measured_by)
    back = mesh_comparison.vertex_distances(target, aligned, asked.measured_by)
    distance = mesh_comparison.MeshDistance.from_vertices(to_reference, back, target.diagonal)
    return distance, motion.scale, to_reference


def _print_mesh(asked: MeshArguments, found: MeshEvaluation) -> None:
    """Print tables of the distances and of the quality."""
    if found.distance is not None:
        _print_distance(found.distance)
        if asked.align is Alignment.SIMILARITY:
            say(f"aligned with a scale of {found.scale:.4f}")
    _print_quality(found.quality)
    say(f"{asked.out}: mesh.json" + (", mesh_curve.png" if asked.reference else ""))
    if asked.reference is not None and asked.align is Alignment.NONE:
        pair = (str(asked.mesh), str(asked.reference))
        print_next("evaluate", "mesh", *pair, "--align", "rigid", "--out", str(asked.out))
    else:
        _print_what_is_next(Path(asked.mesh))


def distance_summary(distance: mesh_comparison.MeshDistance) -> dict[str, object]:
    """Return measured and derived values for JSON."""
    derived = {
        name: getattr(distance, name) for name in ("mean", "hausdorff", "mean_percent", "hausdorff_percent")
    }
    return {**dataclasses.asdict(distance), **derived}


def _read(path: Path) -> mesh_comparison.Compared:
    read = read_mesh(path)
    if not len(read.vertices):
        raise BadMesh(f"{path}: expected a surface or points, got no vertex; export it again")
    if len(read.faces):
        return read
    return PointCloud(points=read.vertices, normals=read.normals, colours=read.colours)


def _print_distance(distance: mesh_comparison.MeshDistance) -> None:
    rows = []
    for name, way in (
        ("mesh to reference", distance.to_reference),
        ("reference to mesh", distance.from_reference),
    ):
        values = (way.mean, way.root_mean_square, way.largest)
        shares = (100 * value / distance.diagonal for value in values)
        rows.append([name, *(f"{v:.6g}" for v in values), *(f"{s:.4f}" for s in shares)])
    columns = ["", "mean", "rms", "largest", "mean, %", "rms, %", "largest, %"]
    print_table(f"distances, and in % of the reference's diagonal {distance.diagonal:.6g}", columns, rows)
    say(f"mean {distance.mean_percent:.3f} %, Hausdorff {distance.hausdorff_percent:.3f} % of the diagonal")


def _print_quality(qualities: dict[str, mesh_comparison.MeshQuality]) -> None:
    rows = []
    for measure in dataclasses.fields(mesh_comparison.MeshQuality):
        values = [getattr(quality, measure.name) for quality in qualities.values()]
        rows.append(
            [
                measure.name.replace("_", " "),
                *("undefined" if value is None else f"{value:.6g}" for value in values),
            ]
        )
    print_table("quality", ["", *qualities], rows)


@dataclass(frozen=True, kw_only=True)
class CylinderArguments(_Written, FrameOptions, MovedFootageOptions, PictureLimits):
    """What `evaluate_cylinder` takes."""

    folder: File = field(kw_only=False)
    """The folder that `vntoolkit reconstruct` wrote."""
    truth: OptionalFile = named(None)
    """The folder that `vntoolkit simulate` wrote. With it, the fit itself is compared with the truth."""


@verb(CylinderArguments)
def evaluate_cylinder(asked: CylinderArguments) -> evaluate.CylinderEvaluation:
    """Fit one cylinder to a reconstruction of a moving cylinder; compare the normals with it (Figure 7).

    Writes cylinder.json and cylinder.png.
    """
    out = Path(asked.out)
    require_output(out / "cylinder.json")
    with write_lock(out):
        result = read_result(asked.folder, frames=asked.frames, footage=asked.footage)
        found = run(result, asked.truth)
        write_json(out / "cylinder.json", found)
        mean, std = (np.array([getattr(e, name) for e in found.frames]) for name in ("mean_deg", "std_deg"))
        title = f"{found.mean_deg:.2f} ± {found.std_deg:.2f} degrees over all frames"
        figures.write_error_over_time(out / "cylinder.png", np.array(found.times_s), mean, std, title)
    _print(found)
    say(f"{asked.out}: cylinder.json, cylinder.png")
    _print_what_is_next(Path(asked.folder))
    return found


def _print(found: evaluate.CylinderEvaluation) -> None:
    columns = ["frame", "pixels", "mean", "std"]
    with_truth = found.frames[0].truth is not None
    if with_truth:
        columns += ["true mean", "true std", "axis off", "radius off %"]
    step = max(1, -(-len(found.frames) // _LINES))
    rows = []
    for error in found.frames[::step]:
        row = [str(error.frame), str(error.pixels), f"{error.mean_deg:.2f}", f"{error.std_deg:.2f}"]
        if error.truth is not None:
            t = error.truth
            row += [f"{t.normals_mean_deg:.2f}", f"{t.normals_std_deg:.2f}"]
            row += [f"{t.axis_deg:.2f}", f"{t.radius_percent:+.2f}"]
        rows.append(row)
    print_table("degrees between normals and the fitted cylinder", columns, rows)
    say(
        f"{len(found.frames)} frames: {found.mean_deg:.2f} ± {found.std_deg:.2f} degrees (paper: 8.67 ± 4.29)"
    )
    truths = [error.truth for error in found.frames if error.truth is not None]
    if truths:
        axis = [t.axis_deg for t in truths]
        radius = [abs(t.radius_percent) for t in truths]
        say(
            f"the fit against the truth: axis {np.median(axis):.2f} degrees (worst {max(axis):.2f}), "
            f"radius {np.median(radius):.2f} % (worst {max(radius):.2f})"
        )


@dataclass(frozen=True, kw_only=True)
class TracksArguments(_Written, MeshLimits):
    """What `evaluate_tracks` takes."""

    folders: tuple[File, ...] = field(kw_only=False)
    """The folders that `vntoolkit track` wrote, or the folders that contain them as `track`."""
    truth: File
    """The folder that `vntoolkit simulate` wrote."""
    every: Annotated[int, within(1)] = 10
    """Evaluate every n-th frame, and the last one."""


@verb(TracksArguments)
def evaluate_tracks(asked: TracksArguments) -> dict[str, list[TrackError]]:
    """Print the end-point error of each frame in pixels, for all visible vertices and without the lost ones.

    A vertex counts in a frame if its true point is visible there. `outliers`: percentage of these vertices
    with an error above 4 pixels. `lost`: percentage that the tracker reports as lost. The last two columns
    leave the lost vertices out: read them together with that percentage. Writes a tab-separated table of all
    evaluated frames for each folder, NAME.tsv, and the error over the frames, tracks.png.
    """
    out = Path(asked.out)
    if not asked.folders:
        raise BadInput("evaluate tracks: FOLDER is missing (the folder that `vntoolkit track` wrote)")
    folders = {_name(Path(each)): Path(each) for each in asked.folders}
    if len(folders) < len(asked.folders):
        raise BadInput("evaluate tracks: expected folders with different names, got two of one name")
    tables = {name: out / f"{name}.tsv" for name in folders}
    for table in tables.values():
        require_output(table)
    results = {}
    for name, each in folders.items():
        target = each / "track" if (each / "track").is_dir() else each
        results[name] = evaluate.evaluate_tracks(target, Path(asked.truth), asked.every)
    with write_lock(out):
        for name, errors in results.items():
            evaluate.write_track_errors(tables[name], errors)
        figures.write_error_plot(out / "tracks.png", results)
    for name, errors in results.items():
        _print_table(name, errors)
    say(f"{asked.out}: {', '.join(f'{name}.tsv' for name in results)}, tracks.png")
    _print_what_is_next(Path(asked.folders[0]))
    return results


def _name(folder: Path) -> str:
    resolved = folder.resolve()
    return resolved.parent.name if resolved.name == "track" else resolved.name


def _print_table(name: str, errors: list[TrackError]) -> None:
    step = max(1, -(-(len(errors) - 1) // _TRACK_LINES))
    say(name)
    say("       all visible vertices                without those reported lost")
    say("frame  median px   95 % px outliers    lost  median px   95 % px")
    for error in [*errors[:-1:step], errors[-1]]:
        say(
            f"{error.frame:5d}  {error.median_px:9.2f} {error.p95_px:9.2f} {100 * error.outliers:7.1f}% "
            f"{100 * error.lost:6.1f}%  {error.found_median_px:9.2f} {error.found_p95_px:9.2f}"
        )


@dataclass(frozen=True, kw_only=True)
class IntegrationArguments(_Written, PictureLimits):
    """What `evaluate_integration` takes."""

    data: OptionalFile = named(None)
    """Folder with one folder per real object: normal_map.png, mask.png, K.txt, depth_gt.npz (millimetres)."""
    size: int = 256
    """Side of the analytic surfaces in pixels."""


@dataclass(frozen=True, kw_only=True)
class IntegrationEvaluation:
    """Depth errors of every integrator on analytic surfaces, and on real objects."""

    surfaces: list[evaluate.SurfaceError]
    objects: list[evaluate.ObjectError]


@verb(IntegrationArguments)
def evaluate_integration(asked: IntegrationArguments) -> IntegrationEvaluation:
    """Print the depth error of every integrator on analytic surfaces, and on real objects if given.

    Writes integration.json, the cumulative errors on the surface with a depth step (integration_curve.png)
    and the error map of the last integrator (integration_map.png).
    """
    out = Path(asked.out)
    require_output(out / "integration.json")
    with write_lock(out):
        objects = [] if asked.data is None else evaluate.objects_in(asked.data)
        rows = list(evaluate.surface_errors(asked.size))
        torn = [row for row in rows if row.is_torn]
        curves, last = {row.integrator: row.distances_percent[row.mask] for row in torn}, torn[-1]
        real = []
        for folder in progress.counted(objects, "objects", len(objects)):
            real += evaluate.real_object_errors(folder)
        plain = [{"surface": r.surface, "integrator": r.integrator, **r.numbers} for r in rows]
        write_json(out / "integration.json", {"surfaces": plain, "objects": real})
        figures.write_cumulative_errors(
            out / "integration_curve.png", curves, "torn surface", "error, % of the range"
        )
        title = f"{last.surface}, {last.integrator}"
        figures.write_error_map(
            out / "integration_map.png", last.distances_percent, last.mask, title, "% of the range"
        )
    found = IntegrationEvaluation(surfaces=rows, objects=real)
    _print_integration(out, found)
    return found


def _print_integration(out: Path, found: IntegrationEvaluation) -> None:
    """Print tables of the errors."""
    columns = ["surface", "integrator", "mean", "rms", "largest"]
    table = [
        [r.surface, r.integrator, *(f"{r.numbers[n]:.2e}" for n in ("mean", "rms", "largest"))]
        for r in found.surfaces
    ]
    print_table("depth error, % of the surface's range", columns, table, names=2)
    if found.objects:
        table = [[e.name, e.integrator, f"{e.mean_mm:.3f}", f"{e.median_mm:.3f}"] for e in found.objects]
        columns = ["object", "integrator", "mean", "median"]
        print_table("depth error on real objects, mm", columns, table, names=2)
    say(f"{out}: integration.json, integration_curve.png, integration_map.png")
    print_next("reconstruct", "capture.mkv", "--rig", "rig.json", "--out", unused("result"))


def _print_what_is_next(measured: Path) -> None:
    """Name the report of the reconstruction that a file or folder lies in, where it lies in one."""
    for folder in (measured, *list(measured.parents)[:2]):
        if (folder / "reconstruction.json").is_file():
            print_next("report", folder)
            return

"""`vntoolkit evaluate …`: compare normals, meshes, cylinders, tracks and depth with a reference."""

import dataclasses
import logging
from operator import attrgetter
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
from cyclopts import Parameter

from vntoolkit.cli.flags import Flags, Footage, Frames, verb
from vntoolkit.cli.output import print_next, print_table, progress_bar, require_output, write_json
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.evaluation import mesh_comparison
from vntoolkit.evaluation.angular_error import AngularError
from vntoolkit.evaluation.track_error import TrackError
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.geometry.point_cloud import PointCloud
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.maps_and_meshes.meshes import read_mesh
from vntoolkit.io.results.folder import write_lock
from vntoolkit.options.evaluation import Alignment, AlignmentOptions, MeasuredBy
from vntoolkit.options.export import NormalConvention
from vntoolkit.pipeline import evaluate
from vntoolkit.pipeline.evaluate import evaluate_cylinder as run
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.report import figures

_LOGGER = logging.getLogger(__name__)

COLUMNS = ["", "pixels", "mean", "median", "std", "95 %", "< 5°", "< 10°", "< 20°"]

_OUT = Path("evaluation")
Out: TypeAlias = Annotated[Path, Parameter(help="Folder to write.")]
_SEED = 0  # of the vertices sampled for the alignment
_LINES, _TRACK_LINES = 10, 12  # of a table on the screen; the file has all frames


@verb("max_megapixels")
def normals(
    measured: Path,
    reference: Path,
    *,
    out: Out = _OUT,
    measured_convention: NormalConvention | None = None,
    reference_convention: NormalConvention | None = None,
) -> None:
    """Print the angles in degrees between two normal maps, or between two folders of normal maps.

    Writes normals.json, the map of the worst frame's errors (normals_map.png) and the cumulative curve
    (normals_curve.png).

    Parameters
    ----------
    measured
        A normal map, EXR or PNG, or a folder of them, such as `vntoolkit reconstruct` writes.
    reference
        The reference: a map or a folder, such as `vntoolkit simulate` writes. Files are paired by name.
    measured_convention
        Axes of the measured map. Default: those that the file states, else x right, y up, z to the viewer.
    reference_convention
        Axes of the reference.
    """
    require_output(out / "normals.json")
    with write_lock(out):
        pairs = evaluate.pairs_of(measured, reference)
        with progress_bar("normals", len(pairs)) as advance:
            found = evaluate.compare_normal_files(
                pairs, (measured_convention, reference_convention), lambda _name: advance(1)
            )
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
        print(f"{out}: normals.json, normals_map.png, normals_curve.png")
    _print_what_is_next(measured)


def error_row(name: str, error: AngularError) -> list[str]:
    """Return the cells of one row of `COLUMNS`."""
    angles = (error.mean_deg, error.median_deg, error.std_deg, error.p95_deg)
    shares = (error.below_5, error.below_10, error.below_20)
    return [name, str(error.pixels), *(f"{a:.2f}" for a in angles), *(f"{100 * s:.1f}%" for s in shares)]


@verb("max_vertices")
def mesh(
    mesh: Path,
    reference: Path | None = None,
    *,
    measured_by: MeasuredBy = MeasuredBy.EMBREE,
    out: Out = _OUT,
    options: Annotated[AlignmentOptions | None, Flags(renamed={"free": "align"})] = None,
) -> None:
    """Print the distances between a mesh and a reference, in both directions, and the quality of both.

    A distance goes from a vertex of one mesh to the nearest point on the faces of the other. A file without
    faces is a point cloud: distances to it go to its points. Quality counts holes, non-manifold edges and the
    like. Writes mesh.json and mesh_curve.png.

    Parameters
    ----------
    mesh
        A PLY or OBJ file.
    reference
        The mesh to compare with. Without it, only the quality is measured.
    measured_by
        embree: nearest points by Open3D, at any distance. pymeshlab: nearest points by MeshLab.
    """
    require_output(out / "mesh.json")
    with write_lock(out):
        options = options or AlignmentOptions()
        measured = _read(mesh)
        if reference is None and not isinstance(measured, Mesh):
            raise BadMesh(f"{mesh}: expected a surface, got {len(measured.points)} vertices and no face")
        same_name = reference is not None and reference.name == mesh.name  # such as 000000.ply of two folders
        name = str if same_name else attrgetter("name")
        surfaces = {name(mesh): measured}
        content: dict[str, object] = {"mesh": mesh, "reference": reference}
        if reference is not None:
            surfaces[name(reference)] = target = _read(reference)
            if why := mesh_comparison.mismatch(measured, target):
                _LOGGER.warning("%s", why)
            with progress_bar(
                "vertices", len(mesh_comparison.positions(measured)) + len(mesh_comparison.positions(target))
            ) as advance:
                generator = np.random.default_rng(_SEED)
                aligned, motion = mesh_comparison.align_mesh(measured, target, generator, options)  # type: ignore[type-var]
                to_reference = mesh_comparison.vertex_distances(aligned, target, measured_by, advance)
                back = mesh_comparison.vertex_distances(target, aligned, measured_by, advance)
            distance = mesh_comparison.MeshDistance.from_vertices(to_reference, back, target.diagonal)
            content |= {"distance": distance_summary(distance), "scale": motion.scale}
            percent = 100.0 / distance.diagonal * to_reference
            figures.write_cumulative_errors(
                out / "mesh_curve.png", {name(mesh): percent}, f"to {name(reference)}", "% of the diagonal"
            )
            _print_distance(distance)
            if options.free is Alignment.SIMILARITY:
                print(f"aligned with a scale of {motion.scale:.4f}")
        qualities = {
            each: mesh_comparison.mesh_quality(surface)
            for each, surface in surfaces.items()
            if isinstance(surface, Mesh)
        }
        write_json(out / "mesh.json", {**content, "quality": qualities})
        _print_quality(qualities)
        print(f"{out}: mesh.json" + (", mesh_curve.png" if reference else ""))
    if reference is not None and options.free is Alignment.NONE:
        print_next("evaluate", "mesh", mesh, reference, "--align", "rigid", "--out", out)
    else:
        _print_what_is_next(mesh)


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
    print(f"mean {distance.mean_percent:.3f} %, Hausdorff {distance.hausdorff_percent:.3f} % of the diagonal")


def _print_quality(qualities: dict[str, mesh_comparison.MeshQuality]) -> None:
    rows = []
    for field in dataclasses.fields(mesh_comparison.MeshQuality):
        values = [getattr(quality, field.name) for quality in qualities.values()]
        rows.append(
            [
                field.name.replace("_", " "),
                *("undefined" if value is None else f"{value:.6g}" for value in values),
            ]
        )
    print_table("quality", ["", *qualities], rows)


@verb("max_megapixels")
def cylinder(
    folder: Path,
    *,
    truth: Path | None = None,
    frames: Frames = "::",
    footage: Footage = "",
    out: Out = _OUT,
) -> evaluate.CylinderEvaluation:
    """Fit one cylinder to a reconstruction of a moving cylinder; compare the normals with it (Figure 7).

    Writes cylinder.json and cylinder.png.

    Parameters
    ----------
    folder
        The folder that `vntoolkit reconstruct` wrote.
    truth
        The folder that `vntoolkit simulate` wrote. With it, the fit itself is compared with the truth.
    """
    require_output(out / "cylinder.json")
    with write_lock(out):
        result = open_result(folder, frames=FrameRange.from_text(frames), footage=footage)
        with progress_bar("cylinder", 2 * len(result.numbers)) as advance:
            found = run(result, truth, lambda _number: advance(1))
        write_json(out / "cylinder.json", found)
        times = np.array([error.frame for error in found.frames]) / found.frame_rate_hz
        mean, std = (np.array([getattr(e, name) for e in found.frames]) for name in ("mean_deg", "std_deg"))
        title = f"{found.mean_deg:.2f} ± {found.std_deg:.2f} degrees over all frames"
        figures.write_error_over_time(out / "cylinder.png", times, mean, std, title)
        _print(found)
        print(f"{out}: cylinder.json, cylinder.png")
        _print_what_is_next(folder)
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
    print(
        f"{len(found.frames)} frames: {found.mean_deg:.2f} ± {found.std_deg:.2f} degrees (paper: 8.67 ± 4.29)"
    )
    truths = [error.truth for error in found.frames if error.truth is not None]
    if truths:
        axis = [t.axis_deg for t in truths]
        radius = [abs(t.radius_percent) for t in truths]
        print(
            f"the fit against the truth: axis {np.median(axis):.2f} degrees (worst {max(axis):.2f}), "
            f"radius {np.median(radius):.2f} % (worst {max(radius):.2f})"
        )


@verb("max_vertices")
def tracks(
    folder: Path,
    *others: Path,
    truth: Path,
    every: int = 10,
    out: Out = _OUT,
    lost_px: float | None = None,
) -> None:
    """Print the end-point error of each frame in pixels, for all visible vertices and without the lost ones.

    A vertex counts in a frame if its true point is visible there. `outliers`: percentage of these vertices
    with an error above 4 pixels. `lost`: percentage that the tracker reports as lost. The last two columns
    leave the lost vertices out: read them together with that percentage. Writes a tab-separated table of all
    evaluated frames for each folder, NAME.tsv, and the error over the frames, tracks.png.

    Parameters
    ----------
    folder
        The folder that `vntoolkit track` wrote, or the folder that contains it as `track`.
    others
        More such folders, to compare.
    truth
        The folder that `vntoolkit simulate` wrote.
    every
        Evaluate every n-th frame, and the last one.
    lost_px
        A vertex counts as lost where its expected error is above this, in pixels. Default: what `track` used.
    """
    if every < 1:
        raise BadInput(f"every: expected 1 or more, got {every}")
    folders = {_name(each): each for each in (folder, *others)}
    if len(folders) <= len(others):
        raise BadInput("evaluate tracks: expected folders with different names, got two of one name")
    tables = {name: out / f"{name}.tsv" for name in folders}
    for table in tables.values():
        require_output(table)
    results = {}
    for name, each in folders.items():
        target = each / "track" if (each / "track").is_dir() else each
        results[name] = evaluate.evaluate_tracks(target, truth, every, lost_px)
    with write_lock(out):
        for name, errors in results.items():
            evaluate.write_track_errors(tables[name], errors)
            _print_table(name, errors)
        figures.write_error_plot(out / "tracks.png", results)
        print(f"{out}: {', '.join(table.name for table in tables.values())}, tracks.png")
    _print_what_is_next(folder)


def _name(folder: Path) -> str:
    resolved = folder.resolve()
    return resolved.parent.name if resolved.name == "track" else resolved.name


def _print_table(name: str, errors: list[TrackError]) -> None:
    step = max(1, -(-(len(errors) - 1) // _TRACK_LINES))
    print(name)
    print("       all visible vertices                without those reported lost")
    print("frame  median px   95 % px outliers    lost  median px   95 % px")
    for error in [*errors[:-1:step], errors[-1]]:
        print(
            f"{error.frame:5d}  {error.median_px:9.2f} {error.p95_px:9.2f} {100 * error.outliers:7.1f}% "
            f"{100 * error.lost:6.1f}%  {error.found_median_px:9.2f} {error.found_p95_px:9.2f}"
        )


@verb("max_megapixels")
def integration(*, data: Path | None = None, size: int = 256, out: Out = _OUT) -> None:
    """Print the depth error of every integrator on analytic surfaces, and on real objects if given.

    Writes integration.json, the cumulative errors on the surface with a depth step (integration_curve.png)
    and the error map of the last integrator (integration_map.png).

    Parameters
    ----------
    data
        Folder with one folder per real object: normal_map.png, mask.png, K.txt, depth_gt.npz (millimetres).
    size
        Side of the analytic surfaces in pixels.
    """
    require_output(out / "integration.json")
    with write_lock(out):
        objects = [] if data is None else evaluate.objects_in(data)
        cases = evaluate.surface_cases(size)
        rows, curves, last = [], {}, None
        with progress_bar("integration", len(cases) + len(objects)) as advance:
            for case in cases:
                error = case.measure()
                rows.append(error)
                if case.is_torn:
                    curves[error.integrator] = error.distances_percent[error.mask]
                    last = error
                advance(1)
            real = []
            for folder in objects:
                real += evaluate.real_object_errors(folder)
                advance(1)
        plain = [{"surface": r.surface, "integrator": r.integrator, **r.numbers} for r in rows]
        write_json(out / "integration.json", {"surfaces": plain, "objects": real})
        columns = ["surface", "integrator", "mean", "rms", "largest"]
        table = [
            [r.surface, r.integrator, *(f"{r.numbers[n]:.2e}" for n in ("mean", "rms", "largest"))]
            for r in rows
        ]
        print_table("depth error, % of the surface's range", columns, table, names=2)
        if real:
            table = [[e.name, e.integrator, f"{e.mean_mm:.3f}", f"{e.median_mm:.3f}"] for e in real]
            print_table(
                "depth error on real objects, mm", ["object", "integrator", "mean", "median"], table, names=2
            )
        figures.write_cumulative_errors(
            out / "integration_curve.png", curves, "torn surface", "error, % of the range"
        )
        if last is not None:
            title = f"{last.surface}, {last.integrator}"
            figures.write_error_map(
                out / "integration_map.png", last.distances_percent, last.mask, title, "% of the range"
            )
        print(f"{out}: integration.json, integration_curve.png, integration_map.png")
    chosen = ("--integrator", "discontinuity", "--out", "result")
    print_next("reconstruct", "capture.mkv", "--rig", "rig.json", *chosen)


def _print_what_is_next(measured: Path) -> None:
    """Name the report of the reconstruction that a file or folder lies in, where it lies in one."""
    for folder in (measured, *list(measured.parents)[:2]):
        if (folder / "reconstruction.json").is_file():
            print_next("report", folder)
            return

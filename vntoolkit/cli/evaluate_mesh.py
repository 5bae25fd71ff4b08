"""`vntoolkit evaluate mesh`: distances between two meshes both ways, and the quality of each."""

from __future__ import annotations

import dataclasses
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from vntoolkit.cli.flags import flags_from
from vntoolkit.cli.limits import limits_on
from vntoolkit.cli.outputs import require_output
from vntoolkit.cli.tables import print_table, write_json
from vntoolkit.errors import BadMesh
from vntoolkit.evaluation.mesh_alignment import Alignment, AlignmentOptions, align_mesh
from vntoolkit.evaluation.mesh_distance import MeshDistance, mesh_distance
from vntoolkit.evaluation.mesh_quality import MeshQuality, mesh_quality
from vntoolkit.evaluation.vertex_distance import vertex_distances
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.meshes import read_mesh
from vntoolkit.report.error_figures import write_cumulative_errors

if TYPE_CHECKING:
    AlignmentFlags: TypeAlias = AlignmentOptions | None
else:
    AlignmentFlags = flags_from(AlignmentOptions, free="align")

_SEED = 0  # of the vertices sampled to align by


@limits_on("max_vertices")
def mesh(
    mesh: Path,
    reference: Path | None = None,
    *,
    out: Path = Path("evaluation"),
    options: AlignmentFlags = None,
) -> None:
    """Print how far a mesh lies from a reference, both ways, and what the next program stumbles over in it.

    Distances are measured by pymeshlab from the vertices of one to the faces of the other. Writes mesh.json
    and mesh_curve.png.

    Parameters
    ----------
    mesh
        A PLY or OBJ file.
    reference
        Another; without it only the quality is measured.
    out
        Folder to write.
    """
    require_output(out / "mesh.json")
    options = options or AlignmentOptions()
    measured = _read(mesh)
    same_name = reference is not None and reference.name == mesh.name  # such as 000000.ply of two folders
    name = str if same_name else attrgetter("name")
    qualities = {name(mesh): mesh_quality(measured)}
    content: dict[str, object] = {"mesh": mesh, "reference": reference, "quality": qualities}
    if reference is not None:
        target = _read(reference)
        qualities[name(reference)] = mesh_quality(target)
        aligned, motion = align_mesh(measured, target, np.random.default_rng(_SEED), options)
        distance = mesh_distance(aligned, target)
        content |= {"distance": distance_summary(distance), "scale": motion.scale}
        percent = 100.0 / distance.diagonal * vertex_distances(aligned, target)
        write_cumulative_errors(
            out / "mesh_curve.png", {name(mesh): percent}, f"to {name(reference)}", "% of the diagonal"
        )
        _print_distance(distance)
        if options.free is Alignment.SIMILARITY:
            print(f"aligned with a scale of {motion.scale:.4f}")
    write_json(out / "mesh.json", content)
    _print_quality(qualities)
    print(f"{out}: mesh.json" + (", mesh_curve.png" if reference else ""))


def distance_summary(distance: MeshDistance) -> dict[str, object]:
    """Return the measured values and those derived, for JSON."""
    derived = {
        name: getattr(distance, name) for name in ("mean", "hausdorff", "mean_percent", "hausdorff_percent")
    }
    return {**dataclasses.asdict(distance), **derived}


def _read(path: Path) -> Mesh:
    read = read_mesh(path)
    if not len(read.faces):
        raise BadMesh(f"{path}: has {len(read.vertices)} vertices but no face, so it is no surface")
    return read


def _print_distance(distance: MeshDistance) -> None:
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


def _print_quality(qualities: dict[str, MeshQuality]) -> None:
    rows = []
    for field in dataclasses.fields(MeshQuality):
        values = [getattr(quality, field.name) for quality in qualities.values()]
        rows.append([field.name.replace("_", " "), *(f"{value:.6g}" for value in values)])
    print_table("quality", ["", *qualities], rows)

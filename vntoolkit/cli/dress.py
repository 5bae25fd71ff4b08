"""`vntoolkit dress`: put a captured garment on an animated skeleton."""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path

from vntoolkit.cli.output import MESH, print_next_program, require_output, say
from vntoolkit.cli.verb import verb
from vntoolkit.io.motion.garment_fits import read_garment_fit
from vntoolkit.io.results.folder import read_lock, write_lock
from vntoolkit.options.base import File, OptionalFile, named
from vntoolkit.options.dressing import ClockOptions, DressOptions, GarmentFitOptions, WeightOptions
from vntoolkit.options.footage import MeshLimits
from vntoolkit.pipeline.dress import (
    captured_look,
    read_motion,
    read_tracked_cloth,
    require_figure_name,
    write_dressed_figure,
)
from vntoolkit.pipeline.dress import dress as dressed_figure
from vntoolkit.report.mesh_views import write_preview


@dataclass(frozen=True, kw_only=True)
class DressArguments(DressOptions, GarmentFitOptions, WeightOptions, ClockOptions, MeshLimits):
    """What `dress` takes."""

    folder: File = field(kw_only=False)
    """Folder that `vntoolkit track` wrote."""
    motion: File
    """Motion capture: .bvh, or .amc with its .asf beside it."""
    out: File
    """The file to write: .usdc (with skeleton), .glb (short clips), or one mesh per frame, cloth_%04d.ply or
    .obj."""
    skeleton: OptionalFile = named(None)
    """The .asf file of an .amc file, if their names differ."""
    fit: OptionalFile = named(None)
    """JSON file that corrects the automatic fit: scale, rotation_deg, translation_m, landmarks, pose_deg,
    bind_frame."""
    preview: bool = False
    """Also write a contact sheet and a turntable video beside the result. Red shows what the cloth cannot
    follow: triangles stretched above 2×, and arms outside their sleeves."""


def _preview_name(out: Path) -> str:
    return out.stem.split("%")[0].rstrip("_") or "dress"


@verb(DressArguments)
def dress(asked: DressArguments) -> Path:
    """Attach a mesh registered by `vntoolkit track` to a skeleton animated by motion capture."""
    folder, out = Path(asked.folder), Path(asked.out)
    require_figure_name(out)
    require_output(out)
    alone = write_lock(out.parent) if out.suffix.lower() in MESH else contextlib.nullcontext()
    with read_lock(folder), alone:
        dressed = dressed_figure(
            read_tracked_cloth(folder),
            read_motion(Path(asked.motion), asked.skeleton),
            asked.part(DressOptions),
            None if asked.fit is None else read_garment_fit(asked.fit),
        )
        summary = write_dressed_figure(dressed, out, *captured_look(folder))
        if asked.preview:
            write_preview(out.parent, _preview_name(out), dressed)
    cut = f"; {dressed.cut_triangles} triangles cut" if dressed.cut_triangles else ""
    rate = f"{dressed.clock.frame_rate_hz:g} frames per second"
    say(f"{out}: {summary.frames} frames of {len(dressed.template.vertices)} vertices, {rate}{cut}")
    say(f"worn as {dressed.fitting.garment.value}: {summary.findings.sentence}")
    if summary.fold_error is not None:
        say(f"skin: folds within {1000 * summary.fold_error:.2g} mm; --carrier cache writes them exactly")
    if asked.preview:
        stem = _preview_name(out)
        say(f"{out.parent / stem}_sheet.png, {stem}_turntable.mkv")
    print_next_program(out.with_name(out.name % 0) if out.suffix.lower() in MESH else out)
    return out

"""`vntoolkit dress`: put a captured garment on an animated skeleton."""

import contextlib
from functools import partial
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from vntoolkit.cli.flags import Flags, verb
from vntoolkit.cli.output import MESH, ProgressBars, print_next_program, require_output
from vntoolkit.io.motion.garment_fits import read_garment_fit
from vntoolkit.io.results.folder import read_lock, write_lock
from vntoolkit.options.dressing import DressOptions
from vntoolkit.pipeline.dress import (
    captured_look,
    dress,
    read_motion,
    read_tracked_cloth,
    require_figure_name,
    write_dressed_figure,
)
from vntoolkit.report.mesh_views import write_preview


@verb("max_vertices")
def run(
    folder: Path,
    *,
    motion: Path,
    out: Path,
    skeleton: Path | None = None,
    fit: Path | None = None,
    preview: Annotated[bool, Parameter(negative=())] = False,
    options: Annotated[DressOptions | None, Flags(renamed={"frame_rate_hz": "frame-rate"})] = None,
) -> None:
    """Attach a mesh registered by `vntoolkit track` to a skeleton animated by motion capture.

    Parameters
    ----------
    folder:
        Folder that `vntoolkit track` wrote.
    motion:
        Motion capture: .bvh, or .amc with its .asf beside it.
    out:
        The file to write: .usdc (with skeleton), .glb (short clips), or one mesh per frame, cloth_%04d.ply or
        .obj.
    skeleton:
        The .asf file of an .amc file, if their names differ.
    fit:
        JSON file that corrects the automatic fit: scale, rotation_deg, translation_m, landmarks, pose_deg,
        bind_frame.
    preview:
        Also write a contact sheet and a turntable video beside the result. Red shows what the cloth cannot
        follow: triangles stretched above 2×, and arms outside their sleeves.
    """
    require_figure_name(out)
    require_output(out)
    several = out.suffix.lower() in MESH
    alone = write_lock(out.parent) if several else contextlib.nullcontext()
    with read_lock(folder), alone:
        dressed = dress(
            read_tracked_cloth(folder),
            read_motion(motion, skeleton),
            options,
            None if fit is None else read_garment_fit(fit),
        )
        with ProgressBars() as bars:
            bars.begin("dress", len(dressed), 0)
            summary = write_dressed_figure(dressed, out, bars.step, captured_look(folder))
        cut = f"; {dressed.cut_triangles} triangles cut" if dressed.cut_triangles else ""
        rate = f"{dressed.clock.frame_rate_hz:g} frames per second"
        print(f"{out}: {summary.frames} frames of {len(dressed.template.vertices)} vertices, {rate}{cut}")
        print(f"worn as {dressed.fitting.garment.value}: {summary.findings.sentence}")
        if summary.fold_error is not None:
            print(
                f"skin: folds within {1000 * summary.fold_error:.2g} mm; --carrier cache writes them exactly"
            )
        if preview:
            stem = out.stem.split("%")[0].rstrip("_") or "dress"
            with ProgressBars() as bars:
                write_preview(
                    out.parent, stem, dressed, on_start=partial(bars.begin, "preview"), on_picture=bars.step
                )
            print(f"{out.parent / stem}_sheet.png, {stem}_turntable.mkv")
    print_next_program(out.with_name(out.name % 0) if several else out)

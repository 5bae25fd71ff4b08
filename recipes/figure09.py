"""Figure 9: the sweater from new views, at a few moments of its dance.

    python recipes/figure09.py --out out/figure09 [--frames 150] [--size 640x480]  # 2 min; --quick 15 s

Simulates the scene, reconstructs every tenth frame with the scene's own rig, and draws each moment as
captured, its normals, and its mesh as plaster from five directions.

figure09.png: a moment a row: captured, normals, the mesh from angles around the upright axis.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

import vntoolkit as vt
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.footage.frame_range import sampled
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.pipeline.truth_comparison import compare_with_truth
from vntoolkit.report.mesh_views import View, picture_of
from vntoolkit.report.pictures import Picture, cropped, picture_of_normals, write_tiles
from vntoolkit.report.recipes_page import number, write_numbers

AZIMUTHS_DEG = (-60.0, -30.0, 0.0, 30.0, 60.0)
STEP = 10


def views(mesh: Mesh, width: int, height: int) -> dict[str, Picture]:
    """Return the mesh from all directions, without its captured colours, so that the shape shows."""
    plaster = replace(mesh, colours=None)
    front = View.around(mesh, width, height, elevation_deg=8.0)
    turned = ((azimuth, replace(front, azimuth_deg=azimuth)) for azimuth in AZIMUTHS_DEG)
    return {f"from {azimuth:.0f}°": picture_of([plaster], view) for azimuth, view in turned}


def moment(result: OpenedResult, frame: int) -> dict[str, Picture]:
    """Return one row: captured, normals, views, cut to the same height."""
    captured, normal_map, mesh = result.picture(frame), result.normals(frame), result.mesh(frame)
    assert captured is not None and mesh is not None  # noqa: PT018
    flat = cropped([captured, picture_of_normals(normal_map)], normal_map.mask)
    height, width = flat[0].shape[:2]
    return {"captured": flat[0], "normals": flat[1], **views(mesh, width, height)}


def main(out: Path, frames: int = 150, size: str = "640x480") -> None:
    """Write `figure09.png` and `numbers.json` into the folder `out`; go on where an earlier run stopped."""
    capture, made = out / "capture", out / "reconstruction"
    vt.simulate("sweater", out=capture, frames=f"0:{frames}:{STEP}", size=size)
    result = vt.reconstruct(capture / "capture.mkv", rig=capture / "truth" / "rig.json", out=made)
    shown = sampled(result.numbers, 5)
    rows, names = [moment(result, number) for number in shown], [f"frame {number}" for number in shown]
    write_tiles(out / "figure09.png", rows, names, height_px=240)
    errors = np.median([frame.normals.median_deg for frame in compare_with_truth(result, capture)])
    median = number("sweater's normals, median of medians", float(errors), "degrees")
    print(write_numbers(out, [median]))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/figure09"), help="folder to write")
    parser.add_argument("--frames", type=int, default=150)
    parser.add_argument("--size", default="640x480")
    parser.add_argument("--quick", action="store_true", help="three moments at 320x240")
    arguments = parser.parse_args()
    frames, size = (30, "320x240") if arguments.quick else (arguments.frames, arguments.size)
    main(arguments.out, frames, size)

"""Figure 9: the sweater from views that the camera never had, a few moments of its dance.

    python recipes/figure09.py --out out/figure09 [--frames 150] [--size 640x480]  # 2 min; --quick 15 s

Simulates the scene, reconstructs every tenth frame with the scene's own rig, and draws each moment as
captured, its normals, and its mesh as plaster from five directions.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.cli.reconstruct import reconstruct
from vntoolkit.cli.simulate import simulate
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.images import write_png
from vntoolkit.pipeline.opened_result import OpenedResult, open_result
from vntoolkit.pipeline.truth_comparison import compare_with_truth
from vntoolkit.report.numbers import number, write_numbers
from vntoolkit.report.pictures import Picture, picture_of_normals, strip_of
from vntoolkit.report.raycast_view import View, picture_of
from vntoolkit.report.samples_section import sampled

AZIMUTHS_DEG = (-60.0, -30.0, 0.0, 30.0, 60.0)
STEP = 10


def views(mesh: Mesh, width: int, height: int) -> list[Picture]:
    """Return the mesh from all directions, without its captured colours, so that the shape shows."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    front = View(
        centre=(low + high) / 2,
        height=1.15 * float(np.max((high - low)[:2] / [width / height, 1])),
        elevation_deg=8.0,
        width_px=width,
        height_px=height,
    )
    plaster = replace(mesh, colours=None)
    return [picture_of([plaster], replace(front, azimuth_deg=azimuth)) for azimuth in AZIMUTHS_DEG]


def moment(result: OpenedResult, frame: int) -> Picture:
    """Return one row: captured, normals, views."""
    captured, normal_map, mesh = result.picture(frame), result.normals(frame), result.mesh(frame)
    assert captured is not None and normal_map is not None and mesh is not None  # noqa: PT018
    height, width = captured.shape[:2]
    strip = strip_of([captured, picture_of_normals(normal_map), *views(mesh, width, height)], 240)
    return np.pad(strip, ((0, 6), (0, 0), (0, 0)), constant_values=255)


def main(out: Path, frames: int = 150, size: str = "640x480") -> None:
    """Write `figure09.png` and `numbers.json` into the folder `out`; go on where an earlier run stopped."""
    capture, made = out / "capture", out / "reconstruction"
    simulate("sweater", out=capture, frames=f"0:{frames}:{STEP}", size=size)
    reconstruct(str(capture / "capture.mkv"), rig=capture / "truth" / "rig.json", out=made)
    result = open_result(made)
    write_png(out / "figure09.png", np.concatenate([moment(result, n) for n in sampled(result.numbers, 5)]))
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

"""Figure 2: a face in makeup of one colour, its normals by the board calibration.

    python recipes/figure02.py --out out/figure02 [--quick]        # quick: 1 min of processor time

The board carries a sample in the makeup's colour; it gives camera and M, and every pixel of the face then
gives its normal (brostow2011, III-A).

figure02.png: a frame a row: captured, normals, the integrated depth as relief, the normals' error.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.evaluation.angular_error import compare_normals
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.rigs import write_rig
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.calibration import BoardOptions
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.pipeline.calibrate import CalibrationJob, calibrate_board
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob, simulate
from vntoolkit.report.pictures import ErrorScale, row_of_frame, write_tiles
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

SCALE = ErrorScale(most=40.0)
FACE_FRAMES = (0, 110, 290, 520)  # at rest, smiling, grimacing, speaking


def main(out: Path, size: tuple[int, int] = (960, 720), step: int = 4) -> None:
    """Write figure02.png, rig.json and numbers.json into the folder `out`."""
    options = SceneOptions(width=size[0], height=size[1])
    folder = SimulationFolder(root=out / "board")
    sample = replace(options, sample="face_makeup")
    simulate(SimulationJob(scene="board", folder=folder, options=sample, frames=FrameRange(step=step)))
    job = CalibrationJob(source=str(folder.video))
    rig, _ = calibrate_board(job, BoardLayout(), BoardOptions())
    write_rig(out / "rig.json", rig)
    scene = build_scene("face_makeup", options)
    integrator = DepthIntegrator(scene.camera)
    rows, errors = [], []
    for frame in FACE_FRAMES:
        rendered = render_frame(scene, frame)
        found = normals_from_frame(rendered.linear, rig.response, rendered.truth.normals.mask)
        errors.append(compare_normals(found, rendered.truth.normals))
        depth = integrator.integrate(NormalMap(normals_in_camera=found.normals_in_camera, mask=found.mask))
        rows.append(row_of_frame(rendered.linear, found, depth, scene.camera, rendered.truth.normals, SCALE))
    write_tiles(out / "figure02.png", rows, [f"frame {frame}" for frame in FACE_FRAMES], scale=SCALE)
    numbers = [
        number("made-up face, mean error of the normals", np.mean([e.mean_deg for e in errors]), "degrees"),
        number("made-up face, median error", np.mean([e.median_deg for e in errors]), "degrees"),
        number("residual of the board", rig.quality.residual_deg, "degrees"),
    ]
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/figure02"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="smaller pictures, fewer of them")
    arguments = parser.parse_args()
    main(arguments.out, *(((640, 480), 10) if arguments.quick else ()))

"""M from a bare head that turns against M from a board, on the same face in makeup.

    python recipes/head_and_board.py --out out/head_and_board [--quick]     # 2 min of processor time

Makeup changes the skin's albedo, so each row of the head's M is scaled to come closest to the board's;
nothing is fitted to the face. Both then give the normals of the made-up face (brostow2011, III-A and IV).
The true Ms of bare and made-up skin still differ after this scaling, which bounds the result from below.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Matrix3
from vntoolkit.evaluation.angular_error import compare_normals
from vntoolkit.geometry.board_layout import BoardLayout
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.calibration import BoardOptions
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.response import LightResponse
from vntoolkit.pipeline.calibrate import CalibrationJob, calibrate_board
from vntoolkit.pipeline.calibrate_head import calibrate_head
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob, simulate
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

FACE_FRAMES = (0, 290)


def main(out: Path, size: tuple[int, int] = (960, 720), step: int = 2) -> None:
    """Write both captures and numbers.json into the folder `out`."""
    options = SceneOptions(width=size[0], height=size[1])
    turn, board = (SimulationFolder(root=out / name) for name in ("head_turn", "board"))
    sample = replace(options, sample="face_makeup")
    simulate(SimulationJob(scene="head_turn", folder=turn, options=options, frames=FrameRange(step=step)))
    simulate(SimulationJob(scene="board", folder=board, options=sample, frames=FrameRange(step=2 * step)))
    head_rig, _ = calibrate_head(CalibrationJob(source=str(turn.video), camera=turn.truth / "rig.json"))
    board_rig, _ = calibrate_board(CalibrationJob(source=str(board.video)), BoardLayout(), BoardOptions())
    made_up = build_scene("face_makeup", options)
    true = [true_response(scene, Nuisances()) for scene in (build_scene("face", options), made_up)]
    found_m = (head_rig.response.matrix, board_rig.response.matrix)
    pairs = {"calibrated": found_m, "true": (true[0].matrix, true[1].matrix)}
    apart: dict[str, list[float]] = {"calibrated": [], "true": []}
    errors = []
    for frame in FACE_FRAMES:
        rendered = render_frame(made_up, frame)
        truth = rendered.truth.normals
        for name, (head, other) in pairs.items():
            responses = [LightResponse(matrix=m) for m in (scaled(head, other), other)]
            found = [normals_from_frame(rendered.linear, each, truth.mask) for each in responses]
            normals = [each.normals_in_camera[found[0].mask & found[1].mask] for each in found]
            apart[name].append(float(angles_deg(*normals).mean()))
            errors += [[compare_normals(each, truth).median_deg for each in found]]
    what, medians = "made-up face, ", np.mean(errors[::2], axis=0)
    numbers = [
        number(what + "M from the head against M from the board", np.mean(apart["calibrated"]), "degrees"),
        number(what + "true M of bare against made-up skin", np.mean(apart["true"]), "degrees"),
        number(what + "M from the head: median error", medians[0], "degrees"),
        number(what + "M from the board: median error", medians[1], "degrees"),
    ]
    print(write_numbers(out, numbers))


def scaled(head: Matrix3, board: Matrix3) -> Matrix3:
    """Scale each row of the head's M so that it comes closest to the board's: another albedo a channel."""
    return ((board * head).sum(axis=1) / np.square(head).sum(axis=1))[:, None] * head


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/head_and_board"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="smaller pictures, fewer of them")
    arguments = parser.parse_args()
    main(arguments.out, *(((640, 480), 3) if arguments.quick else ()))

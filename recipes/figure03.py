"""Figure 3: calibrate on a bare head that turns, then reconstruct the same face while it moves.

    python recipes/figure03.py --out out/figure03 [--quick]        # quick: 480x360, 2 min of processor time

The turning head gives poses, its own shape and M (brostow2011, IV); the face's frames then give normals,
which are compared with those of the true M.

figure03.png: a frame a row: captured, normals, the integrated depth as relief, the normals' error.
calibration.png: the head's tracks, its shape in the silhouettes, the samples of M, the turn, the lights.
"""

import argparse
from pathlib import Path

import numpy as np

from vntoolkit.evaluation.angular_error import compare_normals
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.maps_and_meshes.meshes import write_mesh
from vntoolkit.io.rigs import write_rig
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import calibrate_head
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob, simulate
from vntoolkit.report.head import write_head_figure
from vntoolkit.report.pictures import ErrorScale, row_of_frame, write_tiles
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

SCALE = ErrorScale(most=40.0)
FACE_FRAMES = (0, 110, 290, 520)  # at rest, smiling, grimacing, speaking


def main(out: Path, size: tuple[int, int] = (960, 720), faces: tuple[int, ...] = FACE_FRAMES) -> None:
    """Write figure03.png, calibration.png, head.ply, rig.json and numbers.json into the folder `out`."""
    options = SceneOptions(width=size[0], height=size[1])
    folder = SimulationFolder(root=out / "head_turn")
    simulate(SimulationJob(scene="head_turn", folder=folder, options=options, frames=FrameRange()))
    job = CalibrationJob(source=str(folder.video), camera=folder.truth / "rig.json")
    rig, result = calibrate_head(job)
    write_rig(out / "rig.json", rig)
    write_mesh(out / "head.ply", result.mesh)
    write_head_figure(out / "calibration.png", job, result)
    scene = build_scene("face", options)
    best = true_response(scene, Nuisances())
    integrator = DepthIntegrator(scene.camera)
    rows, errors, bounds = [], [], []
    for frame in faces:
        rendered = render_frame(scene, frame)
        truth, mask = rendered.truth.normals, rendered.truth.normals.mask
        found = normals_from_frame(rendered.linear, rig.response, mask)
        errors.append(compare_normals(found, truth).mean_deg)
        bounds.append(compare_normals(normals_from_frame(rendered.linear, best, mask), truth).mean_deg)
        depth = integrator.integrate(NormalMap(normals_in_camera=found.normals_in_camera, mask=found.mask))
        rows.append(row_of_frame(rendered.linear, found, depth, scene.camera, rendered.truth.normals, SCALE))
    write_tiles(out / "figure03.png", rows, [f"frame {frame}" for frame in faces], scale=SCALE)
    numbers = [
        number("bare face, M from the head: mean error", np.mean(errors), "degrees"),
        number("bare face, true M: mean error", np.mean(bounds), "degrees"),
        number("turn of the head", result.motion.turn_deg, "degrees"),
        number("calibration", sum(result.stage_seconds.values()), "s"),
    ]
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/figure03"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="smaller pictures, one of them a face")
    arguments = parser.parse_args()
    main(arguments.out, *(((480, 360), (0,)) if arguments.quick else ()))

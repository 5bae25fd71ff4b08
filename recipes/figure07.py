"""Figure 7: the normals of a moving cylinder against one cylinder fitted to the whole sequence.

    python recipes/figure07.py --out out/figure07 [--quick]        # 15 min on a free machine, --quick 1 min

Simulates the calibration board all over the field, fits M as polynomials of the pixel (near lights),
simulates the cylinder (3 s), reconstructs it and measures; then again with one M for the whole field. Given
for free: the camera, since a board does not determine the principal point of so long a lens.

figure07.png: mean and standard deviation of the angle to the fitted cylinder, over time.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import vntoolkit as vt
from vntoolkit.pipeline.evaluate import CylinderEvaluation
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.rigid.board_and_cylinder import SWEPT_LAYOUT


def measured(out: Path, name: str, degree: int, frames: str) -> CylinderEvaluation:
    """Calibrate with polynomials of `degree`, reconstruct the cylinder and measure its normals."""
    rig, result, truth = out / f"{name}.json", out / name, out / "cylinder"
    lens = truth / "truth" / "rig.json"
    film, layout = out / "board" / "capture.mkv", dataclasses.asdict(SWEPT_LAYOUT)
    vt.calibrate_board(film, out=rig, camera=lens, degree=degree, **layout)
    vt.reconstruct(truth / "capture.mkv", rig=rig, out=result, frames=frames, to="normals")
    return vt.evaluate_cylinder(result, truth=truth, out=out / f"{name}_error")


def main(out: Path, quick: bool = False) -> None:
    """Write figure07.png and numbers.json into the folder `out`; go on where an earlier run stopped."""
    vt.simulate("board_sweep", out=out / "board", frames="::6" if quick else "::3")
    vt.simulate("cylinder", out=out / "cylinder", frames="::30" if quick else "::")
    found = measured(out, "varying", 1, "::")
    single = measured(out, "single", 0, "::" if quick else "::20")
    truths = [error.truth for error in found.frames if error.truth is not None]
    numbers = [
        number("cylinder, mean error", found.mean_deg, "degrees", 8.67),
        number("cylinder, standard deviation", found.std_deg, "degrees", 4.29),
        number("the same with one M for the whole field, mean", single.mean_deg, "degrees"),
        number("the same with one M for the whole field, standard deviation", single.std_deg, "degrees"),
        number(
            "fitted axis against the truth, median", float(np.median([t.axis_deg for t in truths])), "degrees"
        ),
        number("fitted axis against the truth, worst frame", max(t.axis_deg for t in truths), "degrees"),
        number(
            "fitted radius against the truth, worst frame", max(abs(t.radius_percent) for t in truths), "%"
        ),
    ]
    (out / "figure07.png").write_bytes((out / "varying_error" / "cylinder.png").read_bytes())
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/figure07"), help="folder to write")
    parser.add_argument(
        "--quick", action="store_true", help="every 30th frame of the cylinder, every 6th of the board"
    )
    arguments = parser.parse_args()
    main(arguments.out, arguments.quick)

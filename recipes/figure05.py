"""Figure 5: the surface with shadows treated as shading (A) and with shadows detected and recovered (B).

    python recipes/figure05.py --out out/figure05 [--scene spandex]        # 20 s

Prints the mean errors of normals and depth, over the figure and over one-shadow pixels, and the time.

figure05.png: normals, the surface from the side, and the normals' error, of A above and B below.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.evaluation.angular_error import angles_between_deg
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.photometry.frame import count_lit
from vntoolkit.report.figures import Recovery, write_recovery_figure
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import SceneOptions, build_scene

TITLES = {"A": "shadows taken for shading", "B": "shadows found and recovered"}


def depth_error_mm(found: np.ndarray, true_m: np.ndarray) -> float:
    """Return the mean depth error after the free scale is fixed by the median distance."""
    return float(1000 * np.abs(found * np.median(true_m) / np.median(found) - true_m).mean())


def main(out: Path, scene_name: str = "face") -> None:
    """Write `figure05.png` and `numbers.json` into the folder `out`."""
    scene = build_scene(scene_name, SceneOptions())
    rendered = render_frame(scene, 0)
    response, truth = true_response(scene, Nuisances()), rendered.truth
    mask = truth.normals.mask
    detector, recoveries, numbers = ShadowDetector(response, camera=scene.camera), {}, []
    plain = replace(normals_from_frame(rendered.linear, response, mask), weight=None)
    for _ in range(2):  # the first time compiles
        started = time.perf_counter()
        labels = detector.labels(rendered.linear, mask)
        found = recover_normals(rendered.linear, labels, response, mask, camera=scene.camera)
        DepthIntegrator(scene.camera).integrate(found)
        seconds = time.perf_counter() - started
    for name, normals in (("A", plain), ("B", found)):
        depth = DepthIntegrator(scene.camera).integrate(normals)
        mask = truth.normals.mask & depth.mask
        recoveries[f"{name}, {TITLES[name]}"] = Recovery(normals=normals, depth=depth)
        angles = angles_between_deg(normals.normals_in_camera, truth.normals.normals_in_camera)
        here, one_shadow = f"{scene_name}, {TITLES[name]}", mask & (count_lit(truth.labels) == 2)
        depth_mm = depth_error_mm(depth.depth[mask], truth.depth.depth[mask])
        numbers += [
            number(f"{here}: normals, mean error", float(angles[mask].mean()), "degrees"),
            number(f"{here}: normals in one shadow, mean error", float(angles[one_shadow].mean()), "degrees"),
            number(f"{here}: depth, mean error", depth_mm, "mm"),
        ]
    what = f"{scene_name}, {rendered.linear.rgb.shape[1]} pixels wide: shadows found, recovered, integrated"
    numbers.append(number(what, seconds, "s a frame", 10))
    out.mkdir(parents=True, exist_ok=True)
    write_recovery_figure(out / "figure05.png", recoveries, scene.camera, truth.normals)
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/figure05"), help="folder to write")
    parser.add_argument("--scene", default="face", help="face or spandex")
    arguments = parser.parse_args()
    main(arguments.out, arguments.scene)

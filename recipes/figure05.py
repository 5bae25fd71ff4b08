"""Figure 5: the surface with shadows treated as shading (A) and with shadows detected and recovered (B).

    python recipes/figure05.py --out out/figure05 [--scene spandex]        # 20 s

Prints the mean errors of normals and depth, over the figure and over one-shadow pixels, and the time.

figure05.png: normals, the surface from the side, and the normals' error, of A above and B below.
"""

import argparse
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import count_lit
from vntoolkit.report import pictures
from vntoolkit.report.mesh_views import View, picture_of
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

SCALE = pictures.ErrorScale(most=40.0)
TITLES = {"A": "shadows taken for shading", "B": "shadows found and recovered"}


def depth_error_mm(found: np.ndarray, true_m: np.ndarray) -> float:
    """Return the mean depth error after the free scale is fixed by the median distance."""
    return float(1000 * np.abs(found * np.median(true_m) / np.median(found) - true_m).mean())


def write_figure(
    path: Path | str,
    recoveries: Mapping[str, tuple[NormalMap, DepthMap]],
    camera: Camera,
    truth: NormalMap | None = None,
) -> None:
    """Write normals, a view of the surface from the side, and the error of each way of `recoveries`."""
    rows: list[dict[str, pictures.Picture]] = []
    names = []
    for name, (normal_map, depth_map) in recoveries.items():
        mask = normal_map.mask
        normals = pictures.cropped([pictures.picture_of_normals(normal_map)], mask, 0)[0]
        height, width = normals.shape[:2]
        row = {
            "normals": normals,
            "surface from the side": seen_from_the_side(depth_map, camera, width, height),
        }
        mean = ""
        if truth is not None:
            both = mask & truth.mask
            cosine = (normal_map.normals_in_camera * truth.normals_in_camera).sum(-1)
            error = np.where(both, np.rad2deg(np.arccos(np.clip(cosine, -1, 1))), 0.0)
            row["error of the normals"] = pictures.cropped(
                [pictures.picture_of_errors(error, both, SCALE)], mask, 0
            )[0]
            mean = f": mean error {error[both].mean():.1f}°"
        rows.append(row)
        names.append(f"{name}{mean}")
    pictures.write_tiles(path, rows, names, scale=None if truth is None else SCALE)


def seen_from_the_side(depth: DepthMap, camera: Camera, width: int, height: int) -> pictures.Picture:
    """Return a picture of the surface, from the left and a little from above."""
    mesh = mesh_from_depth(depth, camera)
    low, high = np.percentile(mesh.vertices, [1, 99], axis=0)
    view = View(
        centre=(low + high) / 2,
        height=1.2 * float(high[1] - low[1]),
        azimuth_deg=-50.0,
        elevation_deg=10.0,
        width_px=width,
        height_px=height,
    )
    return picture_of([mesh], view)


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
        recoveries[f"{name}, {TITLES[name]}"] = (normals, depth)
        angles = angles_deg(normals.normals_in_camera, truth.normals.normals_in_camera)
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
    write_figure(out / "figure05.png", recoveries, scene.camera, truth.normals)
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/figure05"), help="folder to write")
    parser.add_argument("--scene", default="face", help="face or spandex")
    arguments = parser.parse_args()
    main(arguments.out, arguments.scene)

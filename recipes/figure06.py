"""Figure 6: one coloured frame against classical photometric stereo under three white lights, on a jacket.

    python recipes/figure06.py --out out/figure06 [--quick]        # 25 s; --quick 10 s

Integrates a mesh from each method's normals, where both are valid, and aligns the coloured one to the white
one by a similarity. Both methods know the lights.

figure06.png: both meshes from 30 degrees to the side.
figure06_curve.svg: their distance, in % of the diagonal of the jacket's box.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.evaluation.angular_error import compare_normals
from vntoolkit.evaluation.mesh_comparison import align_mesh, mesh_distance, vertex_distances
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.normals.photometric_stereo import normals_from_lights
from vntoolkit.options.evaluation import Alignment
from vntoolkit.options.simulation import Lighting, Nuisances, SceneOptions
from vntoolkit.report.figures import write_cumulative_errors
from vntoolkit.report.mesh_views import View, picture_of
from vntoolkit.report.pictures import write_tiles
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.image_formation import exposure_of_scene, light_colours_of, true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

LAMPS = (Lighting.WHITE_1, Lighting.WHITE_2, Lighting.WHITE_3)


def white_photograph(options: SceneOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the grey photograph (h, w) under one white lamp, ambient light removed, and its light (3,)."""
    scene = build_scene("jacket", options)
    exposure = exposure_of_scene(scene, Nuisances())
    ambient = (scene.surface.reference_weights @ exposure.ambient_colours).mean()
    grey = render_frame(scene, 0, seed=scene.lights.bits[0] + 1).linear.rgb.mean(axis=2) - ambient
    return grey, light_colours_of(scene, exposure)[0].mean() * exposure.directions[0]


def main(out: Path, quick: bool = False) -> None:
    """Write figure06.png, figure06_curve.svg and numbers.json into the folder `out`."""
    options = SceneOptions(width=320, height=240) if quick else SceneOptions()
    scene, free = build_scene("jacket", options), Alignment.SIMILARITY
    coloured = render_frame(scene, 0)
    truth = coloured.truth.normals
    photographs = [white_photograph(replace(options, lighting=lamp)) for lamp in LAMPS]
    images, lights = (np.array(each) for each in zip(*photographs, strict=True))
    maps = {
        "white": normals_from_lights(images, lights, truth.mask),
        "coloured": normals_from_frame(coloured.linear, true_response(scene, Nuisances()), truth.mask),
    }
    both, meshes = maps["white"].mask & maps["coloured"].mask, {}
    for name, found in maps.items():
        depth = DepthIntegrator(scene.camera).integrate(replace(found, mask=both, weight=None))
        meshes[name] = mesh_from_depth(depth, scene.camera)
    laid, _ = align_mesh(meshes["coloured"], meshes["white"], np.random.default_rng(0), free)
    distance = mesh_distance(laid, meshes["white"])
    depth = coloured.truth.depth
    true = mesh_from_depth(replace(depth, mask=depth.mask & both), scene.camera)
    off = {}
    for name, mesh in meshes.items():  # normals leave the distance to the camera free: the true one, to start
        start = mesh.with_vertices(mesh.vertices * true.vertices[:, 2].mean() / mesh.vertices[:, 2].mean())
        off[name] = mesh_distance(
            align_mesh(start, true, np.random.default_rng(0), free)[0], true
        ).mean_percent
    percent = {"distance": 100 * vertex_distances(laid, meshes["white"]) / distance.diagonal}
    numbers = [
        number("jacket, mean distance", distance.mean_percent, "% of the diagonal", 1.4),
        *(number(f"{n}: from the true surface", off[n], "% of the diagonal") for n in maps),
        *(number(f"{n}: error", compare_normals(m, truth).mean_deg, "degrees") for n, m in maps.items()),
    ]
    view = View.around(meshes["white"], 525, 420, azimuth_deg=-30)
    left, right = (picture_of([mesh], view) for mesh in (meshes["white"], laid))
    write_tiles(out / "figure06.png", [{"three white lights": left, "one coloured frame": right}])
    write_cumulative_errors(out / "figure06_curve.svg", percent, "jacket", "distance, % of the diagonal")
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/figure06"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="320x240")
    arguments = parser.parse_args()
    main(arguments.out, arguments.quick)

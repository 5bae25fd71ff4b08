"""Gallery: the simulator's scenes and what becomes of them, on one page.

    python recipes/gallery.py --out out/gallery [--quick]        # 3 min of processor time, --quick 1 min

Each scene is filmed with a real camera's faults. M is the true one of the middle of the picture; shadows are
found and their normals recovered.

gallery.html: a row a scene: captured, normals, relief, the normals' error, the mesh from the side.
gallery.png: the same rows.
"""

import argparse
from dataclasses import replace
from pathlib import Path

from vntoolkit.geometry.mesh import Mesh
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.report.mesh_views import View, picture_of
from vntoolkit.report.page import PageSection, figure_from_pixels, write_page
from vntoolkit.report.pictures import ErrorScale, Picture, row_of_frame, tiled, write_tiles
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import Scene, build_scene

SCALE = ErrorScale(most=40.0)
SHOWN = {  # scene -> frame, and what it is
    "sphere": (0, "a matte ball"),
    "cylinder": (60, "cloth around a tube"),
    "jacket": (0, "a jacket"),
    "spandex": (10, "legs in tights"),
    "face": (110, "a bare face"),
    "face_makeup": (290, "a face in make-up of one colour"),
}
TURNED_DEG = 35.0


def made(scene: Scene, number: int) -> tuple[Mesh, dict[str, Picture]]:
    """Return the mesh of a frame, and its row of pictures."""
    rendered, response = render_frame(scene, number), true_response(scene, Nuisances())
    truth, camera = rendered.truth.normals, scene.camera
    labels = ShadowDetector(response, camera=camera).labels(rendered.linear, truth.mask)
    found = recover_normals(rendered.linear, labels, response, truth.mask, camera=camera)
    depth = DepthIntegrator(camera).integrate(found)
    row = row_of_frame(rendered.linear, found, depth, camera, truth, SCALE)
    return mesh_from_depth(depth, camera, normal_map=found), row


def main(out: Path, size: tuple[int, int] = (640, 480), quick: bool = False) -> None:
    """Write gallery.html and gallery.png into the folder `out`."""
    options = SceneOptions(width=size[0], height=size[1])
    rows, names = [], []
    for name, (number, what) in list(SHOWN.items())[:: 3 if quick else 1]:
        mesh, row = made(build_scene(name, options), number)
        height, width = row["captured"].shape[:2]
        view = View.around(mesh, width, height, azimuth_deg=TURNED_DEG, elevation_deg=8.0)
        rows.append(row | {"mesh, from the side": picture_of([replace(mesh, colours=None)], view)})
        names.append(what)
    write_tiles(out / "gallery.png", rows, names, scale=SCALE)
    figures = tuple(
        figure_from_pixels(tiled([row], [name], scale=SCALE), name, wide=True)
        for row, name in zip(rows, names, strict=True)
    )
    section = PageSection(title="Scenes", paragraphs=("M is the true one of the middle.",), figures=figures)
    write_page(out / "gallery.html", "Gallery", [section])
    print(out / "gallery.html")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/gallery"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="two scenes at 320x240")
    arguments = parser.parse_args()
    main(arguments.out, *(((320, 240), True) if arguments.quick else ()))

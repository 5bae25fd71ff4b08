"""Gallery: the simulator's scenes and what becomes of them, as one page and one moving picture.

    python recipes/gallery.py --out out/gallery [--quick]        # 4 min of processor time, --quick 1 min

Each scene is filmed with a real camera's faults. M is the true one of the middle of the picture; shadows are
found and their normals recovered.

gallery.html: a row a scene: captured, normals, relief, the normals' error, the mesh from the side.
gallery.png: the same rows. moving.webp: a dancing sweater, the video beside its mesh.
"""

import argparse
import io
from dataclasses import replace
from pathlib import Path

from PIL import Image

from vntoolkit.geometry.mesh import Mesh
from vntoolkit.integration.integrate import DepthAnchor, DepthIntegrator
from vntoolkit.io.atomic import write_bytes
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.report.page import PageSection, figure_from_pixels, write_page
from vntoolkit.report.pictures import ErrorScale, displayed, row_of_frame, tiled, write_tiles
from vntoolkit.report.raycast_view import View, picture_of
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import Scene, SceneOptions, build_scene

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
MOVING = range(0, 48, 2)  # frames of the sweater
SHOWN_HZ = 15


class Maker:
    """Turns frames of one scene into normals, depth and mesh; keeps what goes from frame to frame."""

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.response = true_response(scene, Nuisances())
        self.detector = ShadowDetector(self.response, camera=scene.camera)
        self.integrator = DepthIntegrator(scene.camera)
        self.anchor: DepthAnchor | None = None

    def make(self, number: int) -> tuple[object, Mesh, dict]:
        """Return the rendered frame, its mesh and its row of pictures."""
        rendered = render_frame(self.scene, number)
        truth, mask = rendered.truth.normals, rendered.truth.normals.mask
        labels = self.detector.labels(rendered.linear, mask)
        camera = self.scene.camera
        found = recover_normals(rendered.linear, labels, self.response, mask, camera=camera)
        depth = self.integrator.integrate(found)
        depth = depth if self.anchor is None else self.anchor.align(depth)
        self.anchor = self.anchor or DepthAnchor(depth)
        mesh = mesh_from_depth(depth, camera, normal_map=found)
        return rendered, mesh, row_of_frame(rendered.linear, found, depth, camera, truth, SCALE)


def main(out: Path, size: tuple[int, int] = (640, 480), quick: bool = False) -> None:
    """Write gallery.html, gallery.png and moving.webp into the folder `out`."""
    options = SceneOptions(width=size[0], height=size[1])
    rows, names = [], []
    for name, (number, what) in list(SHOWN.items())[:: 3 if quick else 1]:
        _, mesh, row = Maker(build_scene(name, options)).make(number)
        height, width = row["captured"].shape[:2]
        view = View.around(mesh, width, height, azimuth_deg=TURNED_DEG, elevation_deg=8.0)
        rows.append(row | {"mesh, from the side": picture_of([replace(mesh, colours=None)], view)})
        names.append(what)
    write_tiles(out / "gallery.png", rows, names, scale=SCALE)
    film = moving_picture(build_scene("sweater", options), list(MOVING)[:: 6 if quick else 1])
    write_bytes(out / "moving.webp", film)
    figures = tuple(
        figure_from_pixels(tiled([row], [name], scale=SCALE), name, wide=True)
        for row, name in zip(rows, names, strict=True)
    )
    section = PageSection(title="Scenes", paragraphs=("M is the true one of the middle.",), figures=figures)
    write_page(out / "gallery.html", "Gallery", [section])
    print(out / "gallery.html")


def moving_picture(scene: Scene, numbers: list[int]) -> bytes:
    """Return an animated WebP: each frame as captured, beside its mesh from the side."""
    maker, view, pictures = Maker(scene), None, []
    for number in numbers:
        rendered, mesh, _ = maker.make(number)
        captured = displayed(rendered.linear.rgb)
        height, width = captured.shape[:2]
        view = view or View.around(mesh, width, height, azimuth_deg=TURNED_DEG, elevation_deg=8.0)
        canvas = Image.new("RGB", (2 * width, height))
        canvas.paste(Image.fromarray(captured), (0, 0))
        canvas.paste(Image.fromarray(picture_of([replace(mesh, colours=None)], view)), (width, 0))
        pictures.append(canvas)
    file = io.BytesIO()
    pictures[0].save(
        file,
        format="WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 / SHOWN_HZ),
        loop=0,
        quality=70,
    )
    return file.getvalue()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/gallery"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="two scenes and four moments, at 320x240")
    arguments = parser.parse_args()
    main(arguments.out, *(((320, 240), True) if arguments.quick else ()))

"""Mistakes: what the usual ones of lamps, camera and reading do to a face, side by side, for the guide.

    python recipes/mistakes.py --out out/mistakes       # 1 min of processor time

A face in make-up of one colour is filmed by the simulator and reconstructed with the true M of the middle of
the picture. Each row has one mistake; no finding is heeded.

mistakes.jpg: a row a mistake: as read, normals, their errors in degrees, the mesh from the side.
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.footage.image_writing import encoded_image
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.transfer import Transfer, TransferCurve, encoded_from_linear
from vntoolkit.report.mesh_views import View, picture_of
from vntoolkit.report.pictures import ErrorScale, Picture, row_of_frame, tiled
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import SimulatedFrame, render_frame
from vntoolkit.simulation.scene import Scene, build_scene

FRAME = 290
SCALE = ErrorScale(most=40.0)
TURNED_DEG = 35.0
NEARER = 0.2  # of the lamps' distance, where they stand too near
SHOWN = {
    "captured": "as read",
    "normals": "normals",
    "error of the normals": "errors",
    "side": "from the side",
}
CLEAN = replace(Nuisances(), shadows=False, gloss=False)  # one mistake at a time

Read = Callable[[np.ndarray], np.ndarray]
READ_WRONGLY: dict[str, Read] = {
    "nothing wrong": lambda rgb: rgb,
    "red and blue exchanged": lambda rgb: rgb[..., ::-1],
    "an sRGB curve read as linear": lambda rgb: encoded_from_linear(rgb, Transfer(curve=TransferCurve.SRGB)),
    "another white balance than at calibration": lambda rgb: rgb * (1.1, 1.0, 0.9),
    "clipped at a third of the light": lambda rgb: np.minimum(3.0 * rgb, 1.0),
}


def row(frame: SimulatedFrame, rgb: np.ndarray, scene: Scene, camera: Camera) -> dict[str, Picture]:
    """Return the pictures of one frame read as `rgb`, integrated with `camera`."""
    read = LinearFrame(rgb=np.ascontiguousarray(rgb, np.float32), clipped=np.zeros(rgb.shape[:2], bool))
    truth = frame.truth.normals
    found = normals_from_frame(read, true_response(scene, CLEAN), truth.mask)
    depth = DepthIntegrator(camera).integrate(found)
    pictures = row_of_frame(read, found, depth, camera, truth, SCALE)
    height, width = pictures["captured"].shape[:2]
    mesh = mesh_from_depth(depth, camera, normal_map=found)
    view = View.around(mesh, width, height, azimuth_deg=TURNED_DEG, elevation_deg=8.0)
    pictures["side"] = picture_of([replace(mesh, colours=None)], view)
    return {SHOWN[name]: picture for name, picture in pictures.items() if name in SHOWN}


def main(out: Path, size: tuple[int, int] = (480, 360)) -> None:
    """Write mistakes.jpg into the folder `out`."""
    scene = build_scene("face_makeup", SceneOptions(width=size[0], height=size[1]))
    frame = render_frame(scene, FRAME, nuisances=CLEAN)
    light = np.clip(frame.linear.rgb, 0.0, 1.0)
    rows = {name: row(frame, wrong(light), scene, scene.camera) for name, wrong in READ_WRONGLY.items()}
    near = scene.centre + NEARER * (scene.lights.positions - scene.centre)
    close = replace(scene, lights=replace(scene.lights, positions=near))
    filmed = render_frame(close, FRAME, nuisances=CLEAN)
    rows["lamps near the subject, one M for all"] = row(filmed, filmed.linear.rgb, close, scene.camera)
    wide = Camera.pinhole(width=size[0], height=size[1], focal_px=float(scene.camera.matrix[0, 0]) / 4)
    rows["another zoom than at calibration"] = row(frame, light, scene, wide)
    sheet = tiled(list(rows.values()), list(rows), scale=SCALE, height_px=150)
    write_bytes(out / "mistakes.jpg", encoded_image(sheet, ".jpg", quality=88))
    print(out / "mistakes.jpg")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/mistakes"), help="folder to write")
    main(parser.parse_args().out)

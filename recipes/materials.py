"""Table: subjects of many colours, and the same subjects in one colour.

    python recipes/materials.py --out out/materials [--quick]        # 8 min; quick 1 min

The rig is learned once: three stills of a grey ball, one under each lamp alone. With it a sweater is
reconstructed that is plain, striped, printed with a logo of four colours, woven in a tartan; then a face in
make-up of one colour, and bare, with lips and freckles. All nuisances of a camera are on. The camera of the
ball and of each scene is given; it stands in one place and zooms. The error is that of the normals of pixels
that all three lamps reach, by default options (`--materials auto`) and as if all were of one material
(`--materials calibrated`).

Many colours that are not told apart look like a wrong transfer curve; that check is allowed to fail.

materials.png: a scene a row: captured, normals as of one material, normals and materials as found.
"""

import argparse
from pathlib import Path

import numpy as np

import vntoolkit as vt
from vntoolkit.arrays import FloatArray
from vntoolkit.evaluation.angular_error import angular_error_map, summarise_angles
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.label_images import read_labels
from vntoolkit.io.maps_and_meshes.maps import read_normal_map
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.opened_result import OpenedResult
from vntoolkit.report.pictures import Picture, cropped, pictures_of_frame, write_tiles
from vntoolkit.report.recipes_page import number, write_numbers

IN_ONE_COLOUR = {
    "sweater_stripes": "sweater",
    "sweater_logo": "sweater",
    "sweater_tartan": "sweater",
    "face": "face_makeup",
}
LAMPS = ("red", "green", "blue")
ALL_LAMPS = 7  # shadow label of a pixel that all three reach


def main(out: Path, frames: str = "0:121:40", size: str = "640x480") -> None:
    """Write materials.png and numbers.json into the folder `out`."""
    lamps = lamps_of_studio(out, size)
    results = {}
    for scene in dict.fromkeys([*IN_ONE_COLOUR.values(), *IN_ONE_COLOUR]):
        film = vt.simulate(scene, out=out / scene, frames=frames, size=size)
        camera = vt.read_rig(film / "truth/rig.json").camera
        write_rig(out / f"{scene}.json", lamps.through(camera))
        for materials in ("auto", "calibrated"):
            results[scene, materials] = vt.reconstruct(
                film / "capture.mkv", rig=out / f"{scene}.json", out=out / f"{scene}_{materials}",
                to="normals", materials=materials, allow=("transfer",),
            )  # fmt: skip
    angles = {key: errors_deg(out / key[0], result) for key, result in results.items()}
    numbers, rows = [], []
    for scene, plain in IN_ONE_COLOUR.items():
        found = len(results[scene, "auto"].manifest.known.materials)
        numbers.append(number(f"{scene}: materials found", found, ""))
        one = summarise_angles(angles[plain, "auto"])
        for materials in ("calibrated", "auto"):
            error = summarise_angles(angles[scene, materials])
            name = f"{scene}, {materials}"
            numbers.append(number(f"{name}: mean error", error.mean_deg, "degrees"))
            numbers.append(
                number(f"{name}: more than in one colour", error.mean_deg - one.mean_deg, "degrees")
            )
            numbers.append(
                number(
                    f"{name}: more than in one colour, median", error.median_deg - one.median_deg, "degrees"
                )
            )
        rows.append(tiles(results[scene, "calibrated"], results[scene, "auto"]))
    print(write_numbers(out, numbers))
    write_tiles(out / "materials.png", rows, list(IN_ONE_COLOUR))


def lamps_of_studio(out: Path, size: str) -> Rig:
    """Calibrate on three stills of a ball, each under one lamp alone; the camera is given."""
    for lamp in LAMPS:
        film = vt.simulate("sphere", out=out / f"ball_{lamp}", frames="0:1", size=size, lighting=lamp)
        write_png(out / "ball" / f"{lamp}.png", vt.open_capture(film / "capture.mkv").encoded(0).values)
    seen = vt.simulate("sphere", out=out / "ball_seen", frames="0:1", size=size)  # for its camera alone
    return vt.calibrate_sphere(out / "ball", out=out / "ball_rig.json", camera=seen / "truth/rig.json")


def errors_deg(film: Path, result: OpenedResult) -> FloatArray:
    """Errors of the normals (n,) at pixels that all three lamps reach."""
    angles = []
    for place in result.numbers:
        error, both = angular_error_map(
            result.normals(place), read_normal_map(film / f"truth/normals/{place:06d}.exr")
        )
        lit = read_labels(film / f"truth/visibility/{place:06d}.png") == ALL_LAMPS
        angles.append(error[both & lit])
    return np.concatenate(angles)


def tiles(plainly: OpenedResult, found: OpenedResult) -> dict[str, Picture]:
    """Return the pictures of the first frame by their headings."""
    first = found.numbers[0]
    as_one, as_many = (pictures_of_frame(r, first, ground=255) for r in (plainly, found))
    pictures = {"captured": as_many["captured"], "normals, as of one material": as_one["normals"]}
    pictures["normals"] = as_many["normals"]
    pictures["materials"] = as_many.get("materials", as_many["captured"])
    return dict(zip(pictures, cropped(list(pictures.values()), found.normals(first).mask), strict=True))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/materials"), help="folder to write")
    parser.add_argument("--quick", action="store_true", help="smaller pictures, one frame of each scene")
    arguments = parser.parse_args()
    main(arguments.out, *(("0:1", "320x240") if arguments.quick else ()))

"""The README's picture: a captured frame, its normals, the relief and the mesh.

python recipes/readme_picture.py [--demo out/demo] [--out docs/pipeline.jpg]      # 5 s after `make demo`
"""

import argparse
from dataclasses import replace
from pathlib import Path

from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.footage.images import encoded_image, resized_image
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.report.pictures import cropped, picture_of_depth, picture_of_normals, tiled
from vntoolkit.report.raycast_view import View, picture_of

WIDTH_PX = 1600
TURNED_DEG = 40.0
HEADINGS = ("captured", "normals", "relief of the depth")


def main() -> None:
    """Write the strip."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--demo", type=Path, default=Path("out/demo"))
    parser.add_argument("--out", type=Path, default=Path("docs/pipeline.jpg"))
    arguments = parser.parse_args()
    result = open_result(arguments.demo / "reconstruction")
    number = result.numbers[len(result.numbers) // 2]
    normal_map, depth_map, mesh = result.normals(number), result.depth(number), result.mesh(number)
    maps = [
        result.picture(number),
        picture_of_normals(normal_map),
        picture_of_depth(depth_map, result.camera),
    ]
    row = dict(zip(HEADINGS, cropped(maps, normal_map.mask, margin_px=8), strict=True))
    height, width = row[HEADINGS[0]].shape[:2]
    view = View.around(mesh, width, height, azimuth_deg=TURNED_DEG, elevation_deg=8.0)
    row["mesh, from the side"] = picture_of([replace(mesh, colours=None)], view)
    strip = resized_image(tiled([row]), WIDTH_PX)
    write_bytes(arguments.out, encoded_image(strip, ".jpg", quality=92))
    print(arguments.out)


if __name__ == "__main__":
    main()

"""The README's picture: a captured frame, its normals, the relief and the mesh.

python recipes/readme_picture.py [--demo out/demo] [--out docs/pipeline.jpg]      # 5 s after `make demo`
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.images import encoded_image, resized_image
from vntoolkit.pipeline.opened_result import open_result
from vntoolkit.report.pictures import cropped, picture_of_depth, picture_of_normals
from vntoolkit.report.raycast_view import View, picture_of

WIDTH_PX = 1600
TURNED_DEG = 40.0
PLASTER = 0.45


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
    maps = cropped(maps, normal_map.mask, margin_px=16)
    height, width = maps[0].shape[:2]
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    plaster = replace(mesh, colours=np.full(mesh.vertices.shape, PLASTER, np.float32))
    view = View(
        centre=(low + high) / 2,
        height=1.15 * float((high - low)[1]),
        azimuth_deg=TURNED_DEG,
        elevation_deg=8.0,
        width_px=2 * width,
        height_px=2 * height,
    )
    turned = resized_image(picture_of([plaster], view), max(height, width))
    strip = np.concatenate([*maps, turned[:height, :width]], axis=1)
    write_bytes(arguments.out, encoded_image(resized_image(strip, WIDTH_PX), ".jpg"))
    print(arguments.out)


if __name__ == "__main__":
    main()

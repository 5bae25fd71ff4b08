"""The README's pictures: a captured frame with what becomes of it, and the video beside its moving mesh.

python recipes/readme_picture.py [--demo out/demo] [--out docs/pipeline.jpg]      # 20 s after `make demo`

The moving picture, moving.webp, is written into the same folder.
"""

import argparse
import io
from dataclasses import replace
from pathlib import Path

from PIL import Image

from vntoolkit.io.atomic import write_bytes
from vntoolkit.io.footage.image_writing import encoded_image, resized_image
from vntoolkit.pipeline.opened_result import OpenedResult, read_result
from vntoolkit.report.mesh_views import View, picture_of
from vntoolkit.report.pictures import cropped, picture_of_depth, picture_of_normals, tiled

WIDTH_PX = 1600
TURNED_DEG = 40.0
MOVING_PX = 760  # width, at which most screens show it
MOST_MOMENTS = 40
SHOWN_MS = 66  # each
HEADINGS = ("captured", "normals", "relief of the depth")


def main() -> None:
    """Write the strip."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--demo", type=Path, default=Path("out/demo"))
    parser.add_argument("--footage", default="", help="where the demo's footage is now, if it was moved")
    parser.add_argument("--out", type=Path, default=Path("docs/pipeline.jpg"))
    arguments = parser.parse_args()
    result = read_result(arguments.demo / "reconstruction", footage=arguments.footage)
    result.capture  # noqa: B018 - raises, with the remedy, where the footage is not there
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
    moving = arguments.out.with_name("moving.webp")
    write_bytes(moving, moving_picture(result))
    print(arguments.out, moving)


def moving_picture(result: OpenedResult) -> bytes:
    """Return an animated WebP: each frame as captured, beside its mesh from the side, there and back."""
    shown, view = [], None
    for number in result.numbers[:MOST_MOMENTS]:
        captured, mesh = result.picture(number), replace(result.mesh(number), colours=None)
        height, width = captured.shape[:2]
        view = view or View.around(mesh, width, height, azimuth_deg=TURNED_DEG, elevation_deg=8.0)
        pair = Image.new("RGB", (2 * width, height))
        pair.paste(Image.fromarray(captured), (0, 0))
        pair.paste(Image.fromarray(picture_of([mesh], view)), (width, 0))
        shown.append(pair.resize((MOVING_PX, round(MOVING_PX * height / (2 * width)))))
    loop, file = [*shown[1:], *shown[-2:0:-1]], io.BytesIO()
    shown[0].save(
        file, "WEBP", save_all=True, append_images=loop, duration=SHOWN_MS, loop=0, quality=60, method=4
    )
    return file.getvalue()


if __name__ == "__main__":
    main()

"""Times of the default as ratios to a plain frame, so that a slower default is seen on any machine.

python -m benchmarks.ratios [--size 640x360] [--frames 10] [--out DIR]      # half a minute

A plain frame goes from 8-bit samples to normals and depth without shadows. The sheet is that of
`benchmarks.pipeline`; "a third" is its ellipse. Times are medians.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

from benchmarks.pipeline import (
    footage,
    middle_third,
    milliseconds_in_memory,
    options_of,
    reconstruct_video,
    rig_of,
    with_shadows,
    write_h264,
)
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import Product
from vntoolkit.report.recipes_page import number, write_numbers


def measure(width: int, height: int, frames: int) -> dict[str, float]:
    """Return milliseconds a frame by what is done."""
    rig, third = rig_of(width, height), middle_third(width, height)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_video(folder / "plain.mkv", footage(width, height, frames), 60.0)
        plain = list(open_capture(folder / "plain.mkv").encoded_frames(0, frames))
        dark = with_shadows(plain)
        write_h264(folder / "dark.mp4", (frame.values for frame in dark), width, height)
        write_mask(folder / "figure.png", third)
        to_mesh = options_of(ShadowMethod.ROBUST, Product.MESH)
        meshes = (str(folder / "dark.mp4"), str(folder / "out"), 1, to_mesh, folder / "figure.png")
        reconstruct_video(*meshes)  # compiles
        return {
            "plain frame": milliseconds_in_memory(plain, rig, ShadowMethod.NONE, frames),
            "shadows sought, none there": milliseconds_in_memory(plain, rig, ShadowMethod.ROBUST, frames),
            "with shadows, every pixel": milliseconds_in_memory(dark, rig, ShadowMethod.ROBUST, frames),
            "with shadows, a third": milliseconds_in_memory(dark, rig, ShadowMethod.ROBUST, frames, third),
            "a third, H.264 to meshes on disk": 1000.0 / reconstruct_video(*meshes),
        }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="640x360")
    parser.add_argument("--frames", type=int, default=10)
    parser.add_argument("--out", type=Path, help="folder for numbers.json")
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    times = measure(width, height, arguments.frames)
    for what, milliseconds in times.items():
        print(f"{what:34} {milliseconds:8.1f} ms {milliseconds / times['plain frame']:7.1f} plain frames")
    if arguments.out:
        numbers = [number(what, each / times["plain frame"], "plain frames") for what, each in times.items()]
        write_numbers(arguments.out, [number("a plain frame", times["plain frame"], "ms"), *numbers])


if __name__ == "__main__":
    main()

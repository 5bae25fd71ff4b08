"""Figure 11: a captured sweater on a skeleton animated by motion capture.

    python recipes/figure11.py --out out/figure11 [--motion 131_01.bvh …] [--track DIR] [--quick]   # 2 min

Without --track DIR (written by `vntoolkit track`) the moving mesh is that of the simulated `sweater`, one
second of it, played back and forth. Writes a USD, a contact sheet and a turntable for every motion.

walk_published_sheet.png: the walk, weights as published; time runs to the right, a direction a row.
walk_heat_sheet.png: the same with weights by heat diffusion along the cloth, the default.
"""

import argparse
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.results.sequences import MeshSequenceWriter, read_mesh_sequence
from vntoolkit.options.dressing import ClockOptions, DressOptions, Falloff, Loop, WeightOptions
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.pipeline.dress import dress, read_motion, read_tracked_cloth, write_dressed_figure
from vntoolkit.report.mesh_views import PreviewOptions, write_preview
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.lights import FRAME_RATE_HZ
from vntoolkit.simulation.scene import build_scene

WALK = Path(__file__).parents[1] / "data" / "walk.bvh"
WOOL = (0.62, 0.48, 0.36)
STYLES = {
    "published": DressOptions(weights=WeightOptions(falloff=Falloff.INVERSE), max_stretch=0),
    "heat": DressOptions(),
}


def simulated_sweater(folder: Path, frames: int) -> MeshSequence:
    """Simulate the first frames of the dancing sweater into a folder, and open it."""
    scene = build_scene("sweater", SceneOptions())
    first = scene.vertices(0)
    colours = np.tile(np.array(WOOL, np.float32), (len(first), 1))
    template = Mesh(vertices=first, faces=scene.surface.faces, colours=colours)
    with MeshSequenceWriter(folder, template, frame_rate_hz=FRAME_RATE_HZ) as writer:
        for frame in range(frames):
            writer.append(scene.vertices(frame))
    return read_mesh_sequence(folder)


def main(
    out: Path, motions: tuple[Path, ...] = (WALK,), track: Path | None = None, quick: bool = False
) -> None:
    """Dress the figure of every motion and write the results into the folder `out`."""
    numbers = []
    captured, seconds, views = (6, 0.5, 6) if quick else (60, 3.0, 60)
    clock = ClockOptions(loop=Loop.PING_PONG, stop=seconds)
    cloth = simulated_sweater(out / "sweater", captured) if track is None else read_tracked_cloth(track)
    for motion, (style, options) in itertools.product(motions, STYLES.items()):
        name = f"{motion.stem}_{style}"
        dressed = dress(cloth, read_motion(motion), replace(options, clock=clock))
        written, here = write_dressed_figure(dressed, out / f"{name}.usdc"), f"{motion.stem}, {style}"
        write_preview(out, name, dressed, PreviewOptions(turn_frames=views))
        found = written.findings
        numbers += [
            number(f"{here}: dressed frames written", written.frames, "frames"),
            number(f"{here}: triangles stretched above 2x", 100 * float(found.stretched.mean()), "%"),
            number(f"{here}: the same in the worst frame", 100 * float(found.stretched.max()), "%"),
            number(f"{here}: arms off their sleeves' axes at most", float(found.off_axis.max()), "radii"),
        ]
        print(f"{out / name}.usdc; see {name}_sheet.png, {name}_turntable.mkv")
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/figure11"), help="folder to write")
    parser.add_argument("--motion", type=Path, nargs="+", default=[WALK], help=".bvh, or .amc beside .asf")
    parser.add_argument("--track", type=Path, help="folder that `vntoolkit track` wrote")
    parser.add_argument("--quick", action="store_true", help="fewer frames of the cloth and of the walk")
    arguments = parser.parse_args()
    main(arguments.out, tuple(arguments.motion), arguments.track, arguments.quick)

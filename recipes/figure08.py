"""Figure 8: a checkerboard on the sweater, tracked by each method side by side.

    python recipes/figure08.py --out out/figure08 [--frames 1000] [--scene sweater]  # 1000 frames: about 2 h

Simulates the scene, reconstructs it with the scene's own rig, tracks it by every method, and writes one sheet
a frame chosen (methods side by side), the checkerboard videos, and a table of the error by frame.
"""

import argparse
from pathlib import Path

import numpy as np

from vntoolkit.cli.simulate import simulate
from vntoolkit.io.images import read_image, write_png
from vntoolkit.io.rigs import read_rig
from vntoolkit.pipeline.block_work import ReconstructionJob
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.evaluate_tracks import evaluate_tracks, write_track_errors
from vntoolkit.pipeline.options import Product, ReconstructOptions
from vntoolkit.pipeline.outputs import ReconstructionFolder
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.track import TrackJob, track
from vntoolkit.report.numbers import number, write_numbers
from vntoolkit.tracking.published import Tracker, options_of

METHODS = (
    Tracker.NO_REGISTRATION,
    Tracker.FLOW,
    Tracker.TRANSLATION,
    Tracker.LAPLACIAN_TEMPLATE,
    Tracker.DEFAULT,
)


def reconstruction(scene: str, frames: int, out: Path) -> Path:
    """Film the scene and turn the video into normals and depth; go on where an earlier run stopped."""
    capture, result = out / "capture", out / "reconstruction"
    if not (capture / "truth" / "vertices.npy").exists():
        simulate(scene, out=capture, frames=f"0:{frames}")
    rig = read_rig(capture / "truth" / "rig.json")
    job = ReconstructionJob(
        source=str(capture / "capture.mkv"),
        rig=rig,
        options=ReconstructOptions(to=Product.DEPTH),
        folder=ReconstructionFolder(root=result),
    )
    reconstruct(job)
    return result


def main(out: Path, frames: int = 1000, scene: str = "sweater") -> None:
    """Write sheets, videos and tables into the folder `out`."""
    folder = reconstruction(scene, frames, out)
    sheets, numbers = [], []
    for method in METHODS:
        target = out / method.value
        track(TrackJob(folder=folder, options=options_of(method), out=target))
        sheets.append(read_image(write_checkerboard(folder, target).sheet))
        errors = evaluate_tracks(target, out / "capture", every=10)
        write_track_errors(target / "errors.tsv", errors)
        last = errors[-1]
        for what, value in (("median", last.median_px), ("95 %", last.p95_px)):
            numbers.append(number(f"{method.value}, frame {last.frame}, {what} of the drift", value, "px"))
    write_png(out / f"{scene}.png", np.concatenate(sheets))
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--scene", default="sweater")
    arguments = parser.parse_args()
    main(arguments.out, arguments.frames, arguments.scene)

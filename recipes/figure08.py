"""Figure 8: a checkerboard on the face, tracked by each method side by side.

    python recipes/figure08.py --out out/figure08 [--frames 1000]  # 1000 frames: about 2 h; --quick 1 min

Calibrates, simulates, reconstructs, and tracks by every method.

checkerboards.png: moments of the second half, a column for each method.
errors.svg: median and 95th percentile of the error of the visible vertices, in pixels, by frame.
"""

import argparse
from pathlib import Path

import vntoolkit as vt
from vntoolkit.evaluation.track_error import TrackError
from vntoolkit.options.tracking import TrackArguments, Tracker
from vntoolkit.pipeline.checkerboard import write_checkerboard
from vntoolkit.pipeline.evaluate import evaluate_tracks, write_track_errors
from vntoolkit.pipeline.track import track
from vntoolkit.report.figures import write_error_plot, write_moments
from vntoolkit.report.recipes_page import number, write_numbers

COMPARED = ("no-registration", "flow", "translation", "laplacian", "arap", "default")
FIELD_WIDTH_M = {"face": 0.355, "sweater": 1.42}  # the scenes' own; the board is filmed at the same zoom


def reconstruction(scene: str, frames: int, out: Path, views: str) -> Path:
    """Film the scene, and a board that holds its material; calibrate; write normals and depth.

    Goes on where an earlier run stopped.
    """
    rig = out / "rig.json"
    if not rig.exists():
        width = FIELD_WIDTH_M[scene]
        vt.simulate("board", out=out / "board", frames=views, field_width_m=width, sample=scene)
        vt.calibrate_board(out / "board/capture.mkv", out=rig)
    vt.simulate(scene, out=out / "capture", frames=f"0:{frames}")
    film, result = out / "capture/capture.mkv", out / "reconstruction"
    vt.reconstruct(film, rig=rig, out=result, to="depth", shadows="none")
    return out / "reconstruction"


def compare(folder: Path, out: Path) -> dict[str, list[TrackError]]:
    """Track by every method, write checkerboards side by side, tables and the plot; return the errors."""
    errors, moments = {}, {}
    for method in COMPARED:
        target = out / method
        track(TrackArguments(folder, method=Tracker(method), out=target))
        moments[method] = write_checkerboard(folder, target)
        errors[method] = evaluate_tracks(target, out / "capture", every=10)
        write_track_errors(out / f"{method}.tsv", errors[method])
    write_moments(out / "checkerboards.png", moments)
    write_error_plot(out / "errors.svg", errors)
    return errors


def main(out: Path, frames: int = 1000, scene: str = "face", quick: bool = False) -> None:
    """Write pictures, tables and `numbers.json` into the folder `out`."""
    frames, views = (3, "::15") if quick else (frames, "::5")
    errors = compare(reconstruction(scene, frames, out, views), out)
    last = {name: rows[-1] for name, rows in errors.items()}
    numbers = []
    for name, error in last.items():
        here = f"{name}, last of {frames} frames"
        numbers += [
            number(f"{here}: median", error.median_px, "px"),
            number(f"{here}: 95th percentile", error.p95_px, "px"),
            number(f"{here}: visible", 100 * (1 - error.lost), "%"),
            number(f"{here}: 95th percentile of the visible", error.found_p95_px, "px"),
        ]
    print(write_numbers(out, numbers))


def run(documentation: str, name: str, scene: str) -> None:
    """Read the command line and go."""
    parser = argparse.ArgumentParser(description=documentation, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out") / name, help="folder to write")
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--quick", action="store_true", help="3 frames, fewer of the board")
    main(**vars(parser.parse_args()), scene=scene)


if __name__ == "__main__":
    run(__doc__, "figure08", "face")

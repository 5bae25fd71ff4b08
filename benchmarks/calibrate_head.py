"""Time and memory of `vntoolkit calibrate head`, stage by stage.

    python benchmarks/calibrate_head.py capture.mkv --camera truth/rig.json [--frames 0:60]

Simulated `head_turn`, 90 frames of 960×720, one thread: 30 s of processor time in all (poses 8, hull 3,
stereo and fusion 12, the rest tracks and light), 0.86 GB at most.
"""

import argparse
import resource
import time
from pathlib import Path

from vntoolkit.io.frame_range import FrameRange
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import calibrate_head


def main(source: str, camera: Path | None, frames: str) -> None:
    job = CalibrationJob(source=source, camera=camera, frames=FrameRange.from_text(frames))
    processor, wall = time.process_time(), time.perf_counter()
    _, result = calibrate_head(job)
    for stage, seconds in result.stage_seconds.items():
        print(f"{stage:8s} {seconds:7.1f} s")
    processor = time.process_time() - processor
    print(f"{'all':8s} {time.perf_counter() - wall:7.1f} s, {processor:.1f} s of processor time")
    print(f"memory   {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:7.0f} MB")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", help="footage of a turning head")
    parser.add_argument("--camera", type=Path, default=None, help="a rig.json whose camera is taken")
    parser.add_argument("--frames", default="::", help="which frames, a:b:c")
    arguments = parser.parse_args()
    main(arguments.source, arguments.camera, arguments.frames)

"""Two Dask workers against one on the same machine: frames a second, 1280×720 video to normals and depth.

python -m benchmarks.cluster [--shadows none] [--frames N] [--rounds 3] [--out FILE.json]   # idle, 10 min

With default options 64 frames; with --shadows none 480 frames, in half the time.

Workers are started before the clock, and one block a worker is done first, so that compiling does not count.
A worker has one thread; decoding takes `threads` of the job, which is 1 here. One and two workers take turns
in going first, and rates are medians over the rounds: pages of memory that nobody has touched since the
machine started cost a virtual machine up to ten times more, so whoever comes later has it easier.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from benchmarks.pipeline import footage, options_of, rig_of
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.pipeline.cluster import connected
from vntoolkit.pipeline.reconstruct import BLOCK_FRAMES, reconstruct
from vntoolkit.pipeline.request import Request


def frames_per_second(job: Request, workers: int, frames: int) -> float:
    with connected("local", workers) as client:
        address = client.scheduler.address
        warm = replace(job, folder=ReconstructionFolder(root=job.folder.root / "warm"))
        reconstruct(warm, frames=FrameRange(stop=workers * BLOCK_FRAMES), scheduler=address)
        timed = replace(job, folder=ReconstructionFolder(root=job.folder.root / f"{workers}"))
        started = time.perf_counter()
        reconstruct(timed, frames=FrameRange(stop=frames), scheduler=address)
        seconds = time.perf_counter() - started
    shutil.rmtree(job.folder.root)
    return frames / seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--frames", type=int)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--shadows", choices=[method.value for method in ShadowMethod], default="robust")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    shadows = ShadowMethod(arguments.shadows)
    frames = arguments.frames or (480 if shadows is ShadowMethod.NONE else 64)
    rates: dict[int, list[float]] = {1: [], 2: []}
    with tempfile.TemporaryDirectory() as name:
        video = Path(name) / "footage.mkv"
        write_video(video, footage(width, height, frames), 60.0)
        job = Request(
            source=str(video),
            rig=rig_of(width, height),
            options=options_of(shadows),
            folder=ReconstructionFolder(root=Path(name) / "out"),
        )
        load = os.getloadavg()[0]
        for number in range(arguments.rounds):
            for workers in (1, 2) if number % 2 == 0 else (2, 1):
                rates[workers].append(frames_per_second(job, workers, frames))
    one, two = (statistics.median(rates[workers]) for workers in (1, 2))
    found = {"load_before": load, "one_worker_hz": one, "two_workers_hz": two, "ratio": two / one}
    for key, value in found.items():
        print(f"{key:16s} {value:8.2f}")
    for workers, each in rates.items():
        print(f"{workers} in each round   " + "  ".join(f"{rate:.2f}" for rate in each))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Speed and memory of dressing: 100 and 300 frames of a 184,000-vertex mesh, skinned and written as USD.

    python -m benchmarks.skinning [--blend dual-quaternion]      # 20 s, 900 MB in the temporary folder

Every length runs in a process of its own. Prints its seconds and the peak of its memory: equal peaks mean
that memory does not grow with the number of frames.
"""

import argparse
import multiprocessing
import os
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from vntoolkit.geometry.mesh import Mesh, MeshSequence
from vntoolkit.io.maps_and_meshes.usd import write_usd_meshes
from vntoolkit.options.dressing import Blend, ClockOptions, DressOptions, Loop
from vntoolkit.pipeline.dress import dress, read_motion, write_dressed_figure

VERTICES_ACROSS, VERTICES_DOWN = 460, 400  # 184,000
CLOTH_FRAMES = 30


def sheet(across: int, down: int) -> Mesh:
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, across), np.linspace(-0.3, 0.3, down))
    vertices = np.stack([x, y, 5 + 0.1 * x**2], axis=-1).reshape(-1, 3)
    i = np.arange(across * down).reshape(down, across)
    upper = np.stack([i[:-1, :-1], i[1:, :-1], i[:-1, 1:]], axis=-1).reshape(-1, 3)
    lower = np.stack([i[1:, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 3)
    colours = np.full((len(vertices), 3), 0.5, dtype=np.float32)
    return Mesh(vertices=vertices, faces=np.concatenate([upper, lower]), colours=colours)


def anonymous_peak_mb(reset: bool) -> float:
    """Peak of anonymous memory as the kernel counts it; mapped files (the captured frames) are not in it."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5")
        return 0.0
    fields = dict(
        line.split(":") for line in Path("/proc/self/status").read_text().splitlines() if ":" in line
    )
    return (int(fields["VmHWM"].split()[0]) - int(fields["RssFile"].split()[0])) / 1024


def dress_and_write(frames: int, blend: Blend, folder: Path) -> str:
    """Dress and write so many frames in this process; return the line to print."""
    mesh = sheet(VERTICES_ACROSS, VERTICES_DOWN)
    cloth = MeshSequence(template=mesh, vertices=np.load(folder / "v.npy", mmap_mode="r"))
    motion = read_motion("data/walk.bvh")
    speed = 0.9  # the walk lasts 4.8 s, 300 frames 5 s
    clock = ClockOptions(stop=speed * (frames - 1) / 60, speed=speed, loop=Loop.PING_PONG)
    anonymous_peak_mb(reset=True)
    start = time.perf_counter()
    dressed = dress(cloth, motion, DressOptions(clock=clock, blend=blend))
    attached = time.perf_counter() - start
    count = write_dressed_figure(dressed, folder / "cloth.usdc").frames
    seconds = time.perf_counter() - start
    size, peak = (folder / "cloth.usdc").stat().st_size / 1e6, anonymous_peak_mb(reset=False)
    return f"{count:4d} frames: {seconds:6.2f} s (attach {attached:.2f}), {size:.0f} MB, peak {peak:.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--blend", type=Blend, default=Blend.LINEAR)
    blend = parser.parse_args().blend
    mesh = sheet(VERTICES_ACROSS, VERTICES_DOWN)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        stored = np.lib.format.open_memmap(
            folder / "v.npy", mode="w+", dtype=np.float32, shape=(CLOTH_FRAMES, len(mesh.vertices), 3)
        )
        for frame in range(CLOTH_FRAMES):
            stored[frame] = mesh.vertices + np.array([0, 0, 0.001 * frame])
        stored.flush()
        alone = multiprocessing.get_context(
            "spawn"
        )  # what one length leaves behind is not the next one's peak
        with ProcessPoolExecutor(1, mp_context=alone, max_tasks_per_child=1) as processes:
            for frames in (5, 100, 300):  # the first compiles
                print(processes.submit(dress_and_write, frames, blend, folder).result())
        small = [sheet(158, 158 + frame % 3) for frame in range(50)]
        start = time.perf_counter()
        write_usd_meshes(folder / "meshes.usdc", small, frame_rate_hz=60)
        size, seconds = (folder / "meshes.usdc").stat().st_size / 1e6, time.perf_counter() - start
        print(f"50 meshes of 25,000 vertices, changing topology: {seconds:.2f} s, {size:.1f} MB")


if __name__ == "__main__":
    main()

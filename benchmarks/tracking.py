"""Seconds per frame of tracking, by stage, on a wrinkled sheet.

python -m benchmarks.tracking [--large]      # 2 min

184,000 vertices within 1280×720, or with --large 307,000 (640×480, every pixel). Prints the minimum and the
median over the frames, the least processor time of all threads (which other work on the machine hardly
changes), and the peak of memory, early and late.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.options.tracking import Tracker, TrackingOptions
from vntoolkit.tracking.tracker import SurfaceTracker


def sheet(width: int, height: int, mask: np.ndarray, frame: int) -> tuple[NormalMap, DepthMap]:
    """Wrinkles, fine and coarse, of a sheet (h, w) that slides by 0.8 px a frame.

    The slopes are those of one height: of others the tracker would take the curl for noise.
    """
    u, v = np.meshgrid(np.arange(width) - 0.8 * frame, np.arange(height) - 0.3 * frame)
    depth, p, q = 500.0 + 0.0 * u, 0.0 * u, 0.0 * u
    for slope, x, y in (
        (0.2, 0.45, 0.2),
        (0.2, -0.3, 0.4),
        (0.15, 0.1, -0.6),
        (0.1, 0.11, 0.22),
        (0.1, 0.14, -0.05),
    ):
        phase, size = x * u + y * v, slope / np.hypot(x, y)
        depth += size * np.sin(phase)
        p += size * x * np.cos(phase)
        q += size * y * np.cos(phase)
    normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    if not mask.all():  # a sheet that fills the picture does so in every frame
        columns, rows = np.flatnonzero(mask.any(axis=0)), np.flatnonzero(mask.any(axis=1))
        mask = (u >= columns[0]) & (u <= columns[-1]) & (v >= rows[0]) & (v <= rows[-1])
    return NormalMap(normals_in_camera=normals.astype(np.float32), mask=mask), DepthMap(
        depth=depth, mask=mask
    )


def paint(width: int, height: int, frame: int) -> np.ndarray:
    """Spots that slide with the wrinkles."""
    u, v = np.meshgrid(np.arange(width) - 0.8 * frame, np.arange(height) - 0.3 * frame)
    return np.float32(1.0 + 0.1 * np.sin(u / 3.0) * np.sin(v / 4.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--large", action="store_true")
    parser.add_argument("--frames", type=int, default=12)
    arguments = parser.parse_args()
    width, height = (640, 480) if arguments.large else (1280, 720)
    mask = np.ones((height, width), dtype=bool)
    if not arguments.large:
        mask[:] = False
        mask[180:540, 384:896] = True  # 184,320 vertices
    camera = Camera.orthographic(width=width, height=height)
    methods = (Tracker.DEFAULT, Tracker.TRANSLATION, Tracker.LAPLACIAN_PREVIOUS, Tracker.FLOW)
    cases = {method.value: TrackingOptions(method=method) for method in methods}
    for name, options in cases.items():
        first = sheet(width, height, mask, 0)
        start = time.perf_counter()
        tracker = SurfaceTracker(*first, camera, options, paint=paint(width, height, 0))
        set_up = time.perf_counter() - start
        times, busy = [], []
        for k in range(1, arguments.frames + 1):
            maps, painted = sheet(width, height, mask, k), paint(width, height, k)
            start, before = time.perf_counter(), time.process_time()
            tracker.step(*maps, paint=painted)
            times.append(time.perf_counter() - start)
            busy.append(time.process_time() - before)
        times, busy = times[2:], busy[2:]  # the first two compile and warm up
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(
            f"{name:30s} {len(tracker.template.pixels)} vertices: set-up {set_up:5.2f} s, frame min "
            f"{1e3 * min(times):4.0f} ms, median {1e3 * float(np.median(times)):4.0f} ms, "
            f"processor {1e3 * min(busy):4.0f} ms, peak {peak:.0f} MB"
        )


if __name__ == "__main__":
    main()

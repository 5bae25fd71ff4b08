"""Time and file size of animated exports: 50 frames of 25,000 vertices.

python -m benchmarks.export      # 10 s
"""

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import DepthMap
from vntoolkit.io.maps_and_meshes.glb import write_glb
from vntoolkit.io.maps_and_meshes.usd import write_usd_meshes, write_usd_sequence
from vntoolkit.meshing.surface import mesh_from_depth

FRAMES, SIDE, RUNS, RATE_HZ = 50, 158, 7, 60.0


def main() -> None:
    """Print the least and the median time and the size of each kind of file."""
    rng = np.random.default_rng(0)
    depth = np.full((SIDE, SIDE), 10.0)
    mesh = mesh_from_depth(
        DepthMap(depth=depth, mask=depth > 0),
        Camera.orthographic(width=SIDE, height=SIDE),
        rgb=rng.random((SIDE, SIDE, 3)).astype(np.float32),
    )
    frames = [
        (mesh.vertices + rng.normal(0, 0.3, mesh.vertices.shape)).astype(np.float32) for _ in range(FRAMES)
    ]
    meshes = [mesh.with_vertices(vertices) for vertices in frames]
    print(f"{FRAMES} frames of {len(mesh.vertices)} vertices and {len(mesh.faces)} triangles")
    with tempfile.TemporaryDirectory() as folder:
        usd, glb = Path(folder) / "a.usdc", Path(folder) / "a.glb"
        measure(
            "USD, one topology",
            usd,
            lambda: write_usd_sequence(usd, mesh, iter(frames), frame_rate_hz=RATE_HZ),
        )
        measure(
            "USD, changing topology", usd, lambda: write_usd_meshes(usd, iter(meshes), frame_rate_hz=RATE_HZ)
        )
        measure("GLB, morph targets", glb, lambda: write_glb(glb, mesh, iter(frames), frame_rate_hz=RATE_HZ))


def measure(name: str, path: Path, write: Callable[[], int]) -> None:
    """Print wall and processor time: on a busy machine the second is the one to compare."""
    wall, processor = [], []
    for _ in range(RUNS):
        started, worked = time.perf_counter(), time.process_time()
        write()
        wall.append(time.perf_counter() - started)
        processor.append(time.process_time() - worked)
    size = path.stat().st_size / 1e6
    print(
        f"{name:24s} least {min(wall):.3f} s, median {np.median(wall):.3f} s, "
        f"processor {np.median(processor):.3f} s, {size:.1f} MB"
    )


if __name__ == "__main__":
    main()

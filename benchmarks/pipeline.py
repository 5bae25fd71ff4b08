"""Frames a second from 8-bit footage to normals and depth, with and without disk, and peak memory.

python -m benchmarks.pipeline [--size 1280x720] [--frames 300] [--memory] [--out FILE.json]      # 4 min

A rippled sheet fills the picture, so every pixel is worked on. The video is FFV1 with a grey level of noise,
which costs more to decode than to reconstruct, and H.264 as cameras write it. Where shadows are looked for,
each light is missing over two discs. The last rate is of a masked ellipse, a third of that picture, from
H.264 to normals, depth, labels and meshes on disk. Times are medians; --memory reconstructs 200 and 2000
frames, each in a process of its own (10 min).
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import numpy.typing as npt

from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.captures import open_capture
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.io.footage.video import write_video
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.results.manifest import ReconstructionFolder
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.reconstruction import MaterialSearch, Product, ReconstructOptions
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import Carried, FrameProcessor
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.request import Request

_LIGHTS = np.array([[-0.35, 0.1, -0.93], [0.25, 0.3, -0.92], [0.05, -0.4, -0.91]])
_REPEATS = 3
_DISTINCT = 12  # different frames; the video repeats them
# A child's ru_maxrss begins at its parent's; the high-water mark of its own address space does not.
_PEAK = """
import sys
from pathlib import Path
from benchmarks.pipeline import reconstruct_video
reconstruct_video(*sys.argv[1:])
status = Path("/proc/self/status").read_text()
print(next(line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:")))
"""


def rig_of(width: int, height: int) -> Rig:
    return Rig(
        camera=Camera.orthographic(width=width, height=height), response=LightResponse(matrix=0.8 * _LIGHTS)
    )


def footage(width: int, height: int, count: int) -> Iterator[npt.NDArray[np.uint8]]:
    """Ripples that travel over a sheet, lit by three lights, with a grey level of noise."""
    rng = np.random.default_rng(0)
    v, u = np.mgrid[:height, :width] / height
    frames = []
    for k in range(_DISTINCT):
        phase = 2 * np.pi * k / _DISTINCT
        first, second = np.cos(9 * u + 4 * v + phase), np.cos(7 * v - 3 * u - phase)
        p = 0.6 * first - 0.15 * second
        q = 0.6 * 4 / 9 * first + 0.15 * 7 / 3 * second
        normals = np.stack([p, q, -np.ones_like(p)], axis=-1)
        normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
        rgb = 255 * 0.8 * np.clip(normals @ _LIGHTS.T, 0, 1) + rng.normal(0, 1, (height, width, 3))
        frames.append(np.clip(rgb, 0, 255).astype(np.uint8))
    return (frames[k % _DISTINCT] for k in range(count))


def write_h264(
    path: Path, frames: Iterator[npt.NDArray[np.uint8]], width: int, height: int, rate_hz: int = 60
) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=rate_hz, options={"crf": "16", "preset": "veryfast"})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv444p"
        for frame in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def options_of(shadows: ShadowMethod = ShadowMethod.NONE, to: Product = Product.DEPTH) -> ReconstructOptions:
    return ReconstructOptions(to=to, shadows=shadows, materials=MaterialSearch.CALIBRATED)


def with_shadows(frames: list[EncodedFrame]) -> list[EncodedFrame]:
    """Each light is missing over two discs that travel with the ripples: 12 % of the picture in all."""
    height, width = frames[0].values.shape[:2]
    v, u = np.mgrid[:height, :width] / height
    out = []
    for number, frame in enumerate(frames):
        values = frame.values.copy()
        for k in range(3):
            for side in range(2):
                x, y = 0.3 + 0.4 * k + 0.01 * (number % _DISTINCT), 0.3 + 0.35 * side + 0.05 * k
                values[..., k][(u - x) ** 2 + (v - y) ** 2 < 0.108**2] //= 32
        out.append(replace(frame, values=values))
    return out


def middle_third(width: int, height: int) -> npt.NDArray[np.bool_]:
    """An ellipse that fills a third of the picture."""
    v, u = np.mgrid[:height, :width]
    x, y = (u + 0.5) / width - 0.5, (v + 0.5) / height - 0.5
    return np.asarray((x / 0.258) ** 2 + (y / 0.411) ** 2 < 1.0)


def milliseconds_in_memory(
    encoded: list[EncodedFrame],
    rig: Rig,
    shadows: ShadowMethod,
    frames: int,
    mask: npt.NDArray[np.bool_] | None = None,
) -> float:
    """Encoded frame to normals and depth, nothing read or written while the clock runs."""
    processor = FrameProcessor(rig, options_of(shadows), mask, None)
    spent, carried = [], Carried()
    for k in range(frames + 2):
        started = time.perf_counter()
        processor.process(encoded[k % len(encoded)], None, carried)
        spent.append(time.perf_counter() - started)
    return 1000 * statistics.median(spent[2:])  # the first two compile and fill caches


def reconstruct_video(
    video: str, out: str, jobs: int = 1, options: ReconstructOptions | None = None, mask: Path | None = None
) -> float:
    """Video file to results on disk, by default normals and depth without shadows; return frames a second."""
    info = open_capture(video).info
    job = Request(
        source=video,
        rig=rig_of(info.width, info.height),
        options=options or options_of(),
        folder=ReconstructionFolder(root=Path(out)),
        mask=mask,
    )
    started = time.perf_counter()
    summary = reconstruct(job, jobs=jobs, overwrite=True)
    return summary.done / (time.perf_counter() - started)


def peak_megabytes(folder: Path, width: int, height: int, frames: int) -> float:
    video = folder / f"{frames}.mkv"
    write_video(video, footage(width, height, frames), 60.0)
    command = [sys.executable, "-c", _PEAK, str(video), str(folder / str(frames))]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    return int(done.stdout.split()[-1]) / 1024


def measure(width: int, height: int, frames: int, memory: bool) -> dict[str, float]:
    rig = rig_of(width, height)
    found: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        videos = {"ffv1": folder / "footage.mkv", "h264": folder / "footage.mp4"}
        write_video(videos["ffv1"], footage(width, height, frames), 60.0)
        write_h264(videos["h264"], footage(width, height, frames), width, height)
        ffv1 = videos["ffv1"]
        encoded = list(open_capture(str(ffv1)).encoded_frames(0, min(frames, _DISTINCT)))
        found["in_memory_ms"] = milliseconds_in_memory(encoded, rig, ShadowMethod.NONE, min(frames, 100))
        third, dark = middle_third(width, height), with_shadows(encoded)
        for key, given, mask in (
            ("in_memory_with_shadows_ms", dark, None),
            ("in_memory_third_with_shadows_ms", dark, third),
            ("in_memory_nothing_shadowed_ms", encoded, None),
        ):
            found[key] = milliseconds_in_memory(given, rig, ShadowMethod.ROBUST, 10, mask)
        for codec, video in videos.items():
            started = time.perf_counter()
            decoded = sum(1 for _ in open_capture(str(video)).encoded_frames(0, frames))
            found[f"decode_{codec}_ms"] = 1000 * (time.perf_counter() - started) / decoded
            for jobs in (1, 2):
                rates = [reconstruct_video(str(video), str(folder / "out"), jobs) for _ in range(_REPEATS)]
                found[f"{codec}_to_disk_{jobs}_jobs_hz"] = statistics.median(rates)
        shadowed, figure = folder / "shadowed.mp4", folder / "figure.png"
        stored = (dark[k % len(dark)].values for k in range(min(frames, 150)))
        write_h264(shadowed, stored, width, height)
        write_mask(figure, third)
        meshes = options_of(ShadowMethod.ROBUST, Product.MESH)
        found["h264_third_with_shadows_to_mesh_hz"] = statistics.median(
            reconstruct_video(str(shadowed), str(folder / "meshes"), 1, meshes, figure)
            for _ in range(_REPEATS)
        )
        if memory:
            for count in (200, 2000):
                found[f"peak_mb_{count}_frames"] = peak_megabytes(folder, width // 2, height // 2, count)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", default="1280x720")
    parser.add_argument("--frames", type=int, default=300)
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--out", type=Path)
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    found = measure(width, height, arguments.frames, arguments.memory)
    for name, value in found.items():
        print(f"{name:32s} {value:10.1f}")
    if arguments.out:
        arguments.out.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()

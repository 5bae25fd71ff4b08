"""Accuracy and speed of the integrators, beside what other programs reach on the same surfaces.

python -m benchmarks.integration [--data FOLDER] [--out FILE.json] [--largest N]

FOLDER holds the normal maps of five real objects (one folder each: normal_map.png, mask.png, K.txt,
depth_gt.npz in millimetres); without it that part is skipped. Times are minima of several runs.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from vntoolkit.evaluation.depth_error import disc_with_hole, peaks, tear
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.options.depth import IntegrationOptions, Integrator
from vntoolkit.pipeline.evaluate import depth_error_percent, read_object, real_object_errors

# Mean absolute error in mm: Cao et al.'s code, and the best least-squares program, on the same maps.
PEERS_ON_OBJECTS = {
    "pot2": (0.220, 0.158),
    "cow": (0.058, 0.168),
    "bear": (0.334, 0.133),
    "goblet": (9.02, 3.88),
    "reading": (0.257, 0.842),
}
PEERS_ON_TEAR = "Cao et al. 0.42 % in 9.7 s; least squares 15 %"
PEERS_ON_MASK = "7 to 69 s"


def fastest(work: Callable[[], Any], repeats: int = 5) -> float:
    """Least wall time of `work` in seconds, over `repeats` runs after one that does not count."""
    work()
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times)


def smooth_surfaces(largest: int) -> list[dict[str, Any]]:
    rows = []
    sizes = [n for n in (128, 256, 512, 1024, 2048, 4096) if n <= largest]
    for size in sizes:
        depth, normals = peaks(size)
        camera = Camera.orthographic(width=size, height=size)
        full = np.ones((size, size), dtype=bool)
        for integrator, mask, name in (
            (Integrator.FOURIER, full, "fourier"),
            (Integrator.COSINE, full, "cosine"),
            (Integrator.POISSON, full, "poisson"),
            (Integrator.POISSON, disc_with_hole(size), "poisson, disc with hole"),
        ):
            options = IntegrationOptions(integrator=integrator)
            normal_map = NormalMap(normals_in_camera=normals, mask=mask)
            found = DepthIntegrator(camera, options).integrate(normal_map)
            rows.append({"surface": f"peaks {size}", "integrator": name, **depth_error_percent(found, depth)})
    return rows


def masked_speed() -> dict[str, Any]:
    """1024×1024 disc with a hole: cold, with kept operator, and on a video that moves slowly."""
    size = 1024
    _, normals = peaks(size)
    mask = disc_with_hole(size)
    camera = Camera.orthographic(width=size, height=size)
    options = IntegrationOptions(integrator=Integrator.POISSON)
    first = NormalMap(normals_in_camera=normals, mask=mask)
    cold = fastest(lambda: DepthIntegrator(camera, options).integrate(first))
    moved = NormalMap(normals_in_camera=np.roll(normals, 1, axis=1), mask=mask)
    integrator = DepthIntegrator(camera, options)
    frames = [first, moved]

    def two_frames() -> None:
        for frame in frames:
            integrator.integrate(frame)

    return {"cold_s": cold, "video_s_per_frame": fastest(two_frames) / 2, "peers": PEERS_ON_MASK}


def torn_surface() -> dict[str, Any]:
    rows: dict[str, Any] = {"peers": PEERS_ON_TEAR}
    for steepness in (0.25, 0.5, 1.0, 2.0):
        depth, normals = tear(256, steepness)
        camera = Camera.orthographic(width=256, height=256)
        full = NormalMap(normals_in_camera=normals, mask=np.ones(depth.shape, dtype=bool))
        robust = IntegrationOptions(integrator=Integrator.DISCONTINUITY)
        least_squares = DepthIntegrator(camera).integrate(full)
        found = DepthIntegrator(camera, robust).integrate(full)
        rows[f"steepness {steepness:g}"] = {
            **depth_error_percent(found, depth),
            "least_squares": depth_error_percent(least_squares, depth)["rms"],
            "seconds": fastest(lambda c=camera, f=full, o=robust: DepthIntegrator(c, o).integrate(f), 3),
        }
    return rows


def real_objects(folder: Path) -> dict[str, Any]:
    rows: dict[str, Any] = {}
    for name, (bilateral, least_squares) in PEERS_ON_OBJECTS.items():
        row: dict[str, Any] = {"cao_mm": bilateral, "least_squares_mm": least_squares}
        for error in real_object_errors(folder / name):
            row[f"{error.integrator}_mm"] = error.mean_mm
        camera, normal_map, _ = read_object(folder / name)
        options = IntegrationOptions(integrator=Integrator.DISCONTINUITY)
        row["discontinuity_s"] = fastest(
            lambda c=camera, n=normal_map, o=options: DepthIntegrator(c, o).integrate(n), 3
        )
        rows[name] = row
    return rows


def frame_speed() -> dict[str, float]:
    """1280×720, full rectangle: milliseconds a frame."""
    _, normals = peaks(720, 1280)
    camera = Camera.orthographic(width=1280, height=720)
    normal_map = NormalMap(normals_in_camera=normals, mask=np.ones((720, 1280), dtype=bool))
    integrator = DepthIntegrator(camera)
    return {
        "normals_to_depth_ms": 1e3 * fastest(lambda: integrator.integrate(normal_map), 30),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = os.environ.get("VNTOOLKIT_REAL_DATA")
    parser.add_argument(
        "--data", type=Path, default=Path(default) / "normal_integration" if default else None
    )
    parser.add_argument("--out", type=Path, default=Path("integration.json"))
    parser.add_argument("--largest", type=int, default=4096)
    arguments = parser.parse_args()
    result: dict[str, Any] = {
        "load_before": os.getloadavg()[0],
        "smooth": smooth_surfaces(arguments.largest),
        "masked": masked_speed(),
        "tear": torn_surface(),
        "frame": frame_speed(),
        "objects": real_objects(arguments.data) if arguments.data else "no --data",
        "load_after": os.getloadavg()[0],
    }
    arguments.out.write_text(json.dumps(result, indent=1))
    print_result(result)


def print_result(result: dict[str, Any]) -> None:
    print(f"machine load {result['load_before']:.1f} before, {result['load_after']:.1f} after\n")
    print(
        "| smooth surface | integrator | largest error, % of range | root mean square, % |\n|---|---|---|---|"
    )
    for row in result["smooth"]:
        print(f"| {row['surface']} | {row['integrator']} | {row['largest']:.1e} | {row['rms']:.1e} |")
    masked, frame = result["masked"], result["frame"]
    print(
        f"\nmasked Poisson 1024×1024: cold {masked['cold_s']:.3f} s, video "
        f"{masked['video_s_per_frame']:.3f} s a frame (peers {masked['peers']})"
    )
    print(
        f"1280×720: normals to depth {frame['normals_to_depth_ms']:.1f} ms, "
        f"slopes to depth {frame['slopes_to_depth_ms']:.1f} ms\n"
    )
    print(
        "| torn surface 256×256 | ours, rms % | ours, mean % | least squares, rms % | s |\n"
        "|---|---|---|---|---|"
    )
    for name, row in result["tear"].items():
        if isinstance(row, dict):
            print(
                f"| {name} | {row['rms']:.2f} | {row['mean']:.2f} "
                f"| {row['least_squares']:.1f} | {row['seconds']:.2f} |"
            )
    print(f"({PEERS_ON_TEAR})")
    if isinstance(result["objects"], dict):
        print("\n| object | discontinuity, mm | poisson, mm | Cao et al., mm | best least squares, mm | s |")
        print("|---|---|---|---|---|---|")
        for name, row in result["objects"].items():
            print(
                f"| {name} | {row['discontinuity_mm']:.3f} | {row['poisson_mm']:.3f} | {row['cao_mm']:.3f} "
                f"| {row['least_squares_mm']:.3f} | {row['discontinuity_s']:.2f} |"
            )


if __name__ == "__main__":
    main()

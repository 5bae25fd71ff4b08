"""Depth of normal maps of real objects, by `vntoolkit integrate`, against their scanned depth.

    python -m benchmarks.integration --data DIR [--out DIR]     # 2 min

DIR holds the maps of scans (normal_integration: a folder an object with normal_map.png, mask.png, K.txt and
depth_gt.npz in millimetres), and maps of the same objects that a network estimated (normals_estimated). A
depth has one free scale, set by the median. Prints the mean distance in millimetres: by the default, by least
squares (`--integrator poisson`), and what the best other programs reach on the same maps.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

import vntoolkit as vt
from vntoolkit.io.maps_and_meshes.maps import read_depth_map
from vntoolkit.pipeline.evaluate import read_object
from vntoolkit.report.recipes_page import number, write_numbers

# Mean distance in mm on the scans' maps: Cao et al.'s code (BiNI), and the best least-squares program.
PEERS = {
    "pot2": (0.220, 0.158),
    "cow": (0.058, 0.168),
    "bear": (0.334, 0.133),
    "goblet": (9.02, 3.88),
    "reading": (0.257, 0.842),
}
ESTIMATED = ("bear", "cow", "pot2", "reading")
METHODS = {"default": "discontinuity", "least squares": "poisson"}


def distance_mm(normals: Path, folder: Path, integrator: str) -> tuple[float, float]:
    """Integrate a normal map with the camera and mask of an object's folder: mean distance, and seconds."""
    _, known, truth = read_object(folder)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        vt.integrate(
            normals, out=Path(scratch) / "depth", mask=folder / "mask.png", camera=folder / "K.txt",
            integrator=integrator, to="depth",
        )  # fmt: skip
        seconds = time.perf_counter() - began
        found = read_depth_map(next((Path(scratch) / "depth" / "depth").glob("*.exr")))
    seen = known.mask & found.mask & np.isfinite(truth)
    depth = found.depth[seen] * np.median(truth[seen] / found.depth[seen])
    return float(np.abs(depth - truth[seen]).mean()), seconds


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=os.environ.get("VNTOOLKIT_REAL_DATA"))
    parser.add_argument("--out", type=Path, help="folder for numbers.json")
    arguments = parser.parse_args()
    if arguments.data is None:
        raise SystemExit("give --data FOLDER: the folder with normal_integration and normals_estimated")
    objects, estimated = arguments.data / "normal_integration", arguments.data / "normals_estimated"
    maps = [("scanned", name, objects / name / "normal_map.png") for name in PEERS]
    maps += [("estimated", name, estimated / f"{name}.png") for name in ESTIMATED]
    numbers = []
    for kind, name, path in maps:
        for method, integrator in METHODS.items():
            error, seconds = distance_mm(path, objects / name, integrator)
            numbers.append(number(f"{kind} {name}, {method}: mean distance", error, "mm"))
            print(f"{numbers[-1].what}: {error:.3f} mm, {seconds:.1f} s", flush=True)
        if kind == "scanned":
            for peer, error in zip(("Cao et al.", "other least squares"), PEERS[name], strict=True):
                numbers.append(number(f"{kind} {name}, {peer}: mean distance", error, "mm"))
    if arguments.out:
        write_numbers(arguments.out, numbers)


if __name__ == "__main__":
    main()

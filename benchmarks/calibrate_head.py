"""Calibration on a simulated head turn: poses, shapes and M against the truth, time and memory by stage.

    python -m benchmarks.calibrate_head [FOLDER] [--camera true] [--features sift] [--out FILE]    # 4 min

FOLDER: what `vntoolkit simulate head_turn --size 960x720 --out FOLDER` wrote; without it, 45 frames of 3
degrees are simulated first (5 min more). Shapes: the hull, screened Poisson over the depths of stereo, and
that refined by normals, each against the part of the true surface that some frame sees. The calibration is
given the footage alone; with `--camera true`, the true focal length too. Before they are compared, shapes are
moved, turned and scaled onto the truth, and M is multiplied by one free factor, the skin's albedo.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.head_truth import HeadTruth
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.head import Features, HeadOptions
from vntoolkit.options.simulation import SceneOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.pipeline.calibrate import CalibrationJob
from vntoolkit.pipeline.calibrate_head import calibrate_head
from vntoolkit.pipeline.simulate import SimulationFolder, SimulationJob, simulate


def measure(folder: Path, source: str, frames: str, features: Features, camera: str) -> dict[str, Any]:
    options = HeadOptions(features=features)
    true_rig = read_rig(folder / "truth" / "rig.json")
    given = folder / "truth" / "rig.json" if camera == "true" else None
    job = CalibrationJob(source=source, camera=given, frames=FrameRange.from_text(frames))
    processor, wall = time.process_time(), time.perf_counter()
    rig, result = calibrate_head(job, options)
    processor, wall = time.process_time() - processor, time.perf_counter() - wall
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    truth = HeadTruth(folder / "truth")
    errors = truth.pose_errors_deg(result)
    found, true = rig.response.matrix, true_rig.response.matrix
    scale = (found * true).sum() / np.square(found).sum()
    normals = spread_normals()
    return {
        "frames": len(result.footage.numbers),
        "features": features.value,
        "given": "the true camera" if camera == "true" else "the footage alone",
        "focal_length_percent": float(100 * (rig.camera.matrix[0, 0] / true_rig.camera.matrix[0, 0] - 1)),
        "poses_mean_deg": float(errors.mean()),
        "poses_worst_deg": float(errors.max()),
        "hull": truth.shape_errors(result.hull, result),
        "poisson": truth.shape_errors(result.fused, result),
        "refined": truth.shape_errors(result.mesh, result),
        "response_percent_but_for_one_scale": float(
            100 * np.linalg.norm(scale * found - true) / np.linalg.norm(true)
        ),
        "normals_by_it_deg": float(angles_deg(normals @ true.T @ np.linalg.inv(found).T, normals).mean()),
        "changes_of_response_percent": [100 * change for change in result.refined.changes],
        "stage_seconds": dict(result.stage_seconds),
        "seconds": wall,
        "processor_seconds": processor,
        "memory_mb": memory,
    }


def spread_normals() -> np.ndarray:
    """Return normals (n, 3) up to 60 degrees from the viewer, what a frame of a face shows."""
    normals = np.random.default_rng(0).standard_normal((20_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return normals[normals[:, 2] < -0.5]


def main(arguments: argparse.Namespace) -> None:
    with tempfile.TemporaryDirectory(prefix="vntoolkit-") as scratch:
        folder = arguments.folder or Path(scratch) / "head_turn"
        if arguments.folder is None:
            size = SceneOptions(width=960, height=720)
            target = SimulationFolder(root=folder)
            simulate(SimulationJob(scene="head_turn", folder=target, options=size, frames=FrameRange(step=2)))
        source = arguments.source or str(folder / "capture.mkv")
        numbers = measure(folder, source, arguments.frames, Features(arguments.features), arguments.camera)
    text = json.dumps(numbers, indent=1)
    print(text)
    if arguments.out:
        arguments.out.write_text(text + "\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path, nargs="?", help="a simulated head turn")
    parser.add_argument("--source", help="other footage of the same turn, such as a degraded copy")
    parser.add_argument("--frames", default="::", help="which frames, a:b:c")
    parser.add_argument("--features", choices=[each.value for each in Features], default="tracks")
    parser.add_argument("--camera", choices=["found", "true"], default="found", help="what is given")
    parser.add_argument("--out", type=Path, help="JSON file to write")
    main(parser.parse_args())

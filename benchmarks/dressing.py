"""How well a tracked garment follows motions: stretched triangles, arms in sleeves, arms overhead.

    python -m benchmarks.dressing TRACK MOTION... [--cuts 20] [--seed 22] [--every 5]

TRACK is a folder that `vntoolkit track` wrote; MOTION are .bvh files, or .amc files beside their .asf.
Dresses the first 100 frames of each motion, then random cuts of 100 frames, each with default options, and
measures every fifth frame. Prints a line each: shares of triangles above 2× and 3× in the mean and the worst
frame, the largest distance of elbow and wrist from the sleeve's axis in its radii, and the weight of the arms
on the trunk. Last, a figure lifts both arms overhead: how much wider the outline becomes below the armpits.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vntoolkit.geometry.mesh import MeshSequence
from vntoolkit.geometry.motion import Motion, pose_of_frame
from vntoolkit.options.dressing import ClockOptions, DressOptions, Loop
from vntoolkit.pipeline.dress import DressedFigure, dress, read_motion, read_tracked_cloth

FRAMES = 100
LEVELS = 12  # heights between armpit and hem at which the width is taken


def dressed_from(cloth: MeshSequence, motion: Motion, start: float) -> DressedFigure:
    """Dress 100 frames of a motion from a moment on."""
    stop = start + (FRAMES - 1) / cloth.frame_rate_hz
    return dress(cloth, motion, DressOptions(clock=ClockOptions(start=start, stop=stop, loop=Loop.PING_PONG)))


def measured(dressed: DressedFigure, every: int) -> tuple[str, np.ndarray]:
    """Return the line to print, and its shares above 2× and 3×, mean and worst, in percent."""
    meter = dressed.meter()
    for frame in range(0, len(dressed), every):
        meter.add(dressed.frame(frame), pose_of_frame(dressed.motion, frame))
    found = meter.findings
    shares = 100 * np.array(
        [found.stretched.mean(), found.stretched.max(), found.torn.mean(), found.torn.max()]
    )
    elbow, _, wrist = found.off_axis.max(axis=(0, 1), initial=0.0)
    arms = [joint for arm in dressed.fitting.arms for joint in arm.joints]
    weights = np.where(np.isin(dressed.weights.joints, arms), dressed.weights.weights, 0).sum(axis=1)
    pull = weights[dressed.fitting.regions.trunk]
    pulled = (float(pull.mean()), float(np.quantile(pull, 0.99))) if len(pull) else (np.nan, np.nan)
    line = (
        "above 2x {:.3f} % (worst {:.3f}), 3x {:.4f} % ({:.4f})".format(*shares)
        + f", elbow {elbow:.2f}, wrist {wrist:.2f} radii, arms on trunk {pulled[0]:.4f} ({pulled[1]:.4f})"
        + f", {dressed.cut_triangles} cut"
    )
    return line, shares


def overhead() -> Motion:
    """Return a figure that lifts both arms from the pose of rest until they point up."""
    walk, frames = read_motion("data/walk.bvh"), 20
    rotations = np.tile([0.0, 0.0, 0.0, 1.0], (frames, len(walk.skeleton.names), 1))
    for name, sign in (("LeftArm", -1.0), ("RightArm", 1.0)):
        turns = Rotation.from_euler("z", sign * np.linspace(0, [135], frames), degrees=True)
        rotations[:, walk.skeleton.index_of(name)] = turns.as_quat()
    still = np.tile(walk.skeleton.offsets[:1], (frames, 1))
    return replace(walk, rotations=rotations, root_positions=still, frame_rate_hz=60.0)


def widening(dressed: DressedFigure) -> float:
    """Return by how much of its width the outline below the armpits is wider in the last frame than at rest.

    At rest the sleeves hang beside the trunk, so its own cloth alone counts; overhead everything does.
    """
    regions, rest = dressed.fitting.regions, dressed.template.vertices
    last = dressed.frame(len(dressed) - 1)
    used = np.zeros(len(rest), dtype=bool)
    used[np.unique(dressed.template.faces)] = True
    trunk = regions.trunk & used
    low, high = rest[trunk, 1].min(), rest[trunk, 1].max()
    wider = []
    for level in np.linspace(low, high, LEVELS + 2)[1:-1]:
        at_rest = trunk & (np.abs(rest[:, 1] - level) < (high - low) / LEVELS / 2)
        now = used & (np.abs(last[:, 1] - level) < (high - low) / LEVELS / 2)
        wider.append(np.ptp(last[now, 0]) / np.ptp(rest[at_rest, 0]) - 1)
    return float(max(wider))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("track", type=Path)
    parser.add_argument("motions", type=Path, nargs="+")
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=22)
    parser.add_argument("--every", type=int, default=5)
    arguments = parser.parse_args()
    cloth, rng = read_tracked_cloth(arguments.track), np.random.default_rng(arguments.seed)
    motions = {path.name: read_motion(path) for path in arguments.motions}
    names = list(motions)
    starts = [(name, 0.0) for name in names]
    for number in range(arguments.cuts):
        name = names[number % len(names)]
        room = max(0.0, motions[name].duration_s - FRAMES / cloth.frame_rate_hz)
        starts.append((name, float(rng.uniform(0, room))))
    found = []
    for name, start in starts:
        began = time.process_time()
        line, shares = measured(dressed_from(cloth, motions[name], start), arguments.every)
        found.append(shares)
        print(f"{name} from {start:.1f} s: {line}, {time.process_time() - began:.0f} s", flush=True)
    worst = np.max(found, axis=0)
    print("all: above 2x mean {:.3f} %, worst {:.3f}; 3x mean {:.4f}, worst {:.4f}".format(*worst))
    raised = dress(cloth, overhead())
    print(f"arms overhead: {100 * widening(raised):.1f} % wider; {measured(raised, 5)[0]}")


if __name__ == "__main__":
    main()

"""Shadows: accuracy on real captures and simulated scenes, time stage by stage at 1280×720.

python -m benchmarks.shadows [--data FOLDER] [--scenes face spandex]      # 1 min

FOLDER: see `vntoolkit/pipeline/referenced_captures.py`. Angles are means in degrees: over all pixels, and
over pixels that exactly one light does not reach. Times are minima of three runs.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import cv2
import numpy as np

from vntoolkit.evaluation.angular_error import angles_between_deg
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.visibility import count_lit, lit_from_labels
from vntoolkit.pipeline.referenced_captures import CAPTURES, ReferencedCapture, read_capture
from vntoolkit.shadows.detector import ShadowDetector, ShadowMethod
from vntoolkit.shadows.recovery import RecoveryMethod, RecoveryOptions, recover_normals
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import SceneOptions, build_scene


def simulated(name: str) -> tuple[ReferencedCapture, object]:
    scene = build_scene(name, SceneOptions())
    frame, response = render_frame(scene, 0), true_response(scene, Nuisances())
    truth = frame.truth
    normals = truth.normals.normals_in_camera
    capture = ReferencedCapture(
        frame=frame.linear,
        response=response,
        normals=normals,
        labels=truth.labels,
        mask=truth.normals.mask,
    )
    return capture, scene.camera


def errors(capture: ReferencedCapture, labels, method: RecoveryMethod, camera=None) -> str:
    found = recover_normals(
        capture.frame, labels, capture.response, capture.mask, RecoveryOptions(method=method), camera
    )
    angles = angles_between_deg(found.normals_in_camera, capture.normals)
    lights = count_lit(capture.labels)
    groups = {"all": capture.mask} | {
        name: capture.mask & (lights == count) for name, count in (("lit", 3), ("one shadow", 2))
    }
    return ", ".join(f"{name} {angles[group].mean():6.2f}" for name, group in groups.items())


def overlap(capture: ReferencedCapture, labels) -> str:
    dark, true = ~lit_from_labels(labels)[capture.mask], ~lit_from_labels(capture.labels)[capture.mask]
    return " ".join(f"{x:.2f}" for x in (dark & true).sum(0) / np.maximum((dark | true).sum(0), 1))


def report(name: str, capture: ReferencedCapture, camera=None) -> None:
    print(f"\n{name}\n  plain inversion        {errors(capture, capture.labels, RecoveryMethod.INVERSION)}")
    labels = {"true": capture.labels}
    for method in (ShadowMethod.PUBLISHED, ShadowMethod.ROBUST):
        detector = ShadowDetector(capture.response, method, camera=camera)
        labels[method.value] = detector.labels(capture.frame, capture.mask)
        shared = overlap(capture, labels[method.value])
        print(f"  {method.value:9} overlap with the true shadows of each light: {shared}")
    for found, values in labels.items():
        for method in (RecoveryMethod.TWO_LIGHTS, RecoveryMethod.SURFACE):
            print(f"  {found:9}, {method.value:10}  {errors(capture, values, method, camera)}")


def fastest(work, repeats: int = 3) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def times(capture: ReferencedCapture) -> None:
    rgb = np.clip(cv2.resize(capture.frame.rgb, (1280, 720), interpolation=cv2.INTER_CUBIC), 0, 1)
    frame = LinearFrame(rgb=rgb, clipped=(rgb >= 1).any(axis=-1))
    print(f"\n1280×720, all pixels in the mask, {count_lit(capture.labels).mean():.2f} lights per pixel")
    for method in (ShadowMethod.PUBLISHED, ShadowMethod.ROBUST):
        detector = ShadowDetector(capture.response, method)
        labels = detector.labels(frame)
        print(f"  detect, {method.value:10} {fastest(lambda: detector.labels(frame)):6.2f} s")  # noqa: B023
    for recovery in RecoveryMethod:
        options = RecoveryOptions(method=recovery)
        seconds = fastest(lambda: recover_normals(frame, labels, capture.response, options=options))  # noqa: B023
        print(f"  recover, {recovery.value:10} {seconds:6.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, help="folder of real captures")
    parser.add_argument("--scenes", nargs="*", default=["spandex", "face"])
    arguments = parser.parse_args()
    for name in arguments.scenes:
        capture, camera = simulated(name)
        report(name, capture, camera)
        times(capture)
    for name in CAPTURES if arguments.data else ():
        report(name, read_capture(arguments.data, name))


if __name__ == "__main__":
    main()

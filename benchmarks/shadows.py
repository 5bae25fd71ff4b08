"""Shadows: accuracy on real captures and simulated scenes, time stage by stage at 1280×720.

python -m benchmarks.shadows [--data FOLDER] [--scenes face spandex]      # 2 min

FOLDER: see `vntoolkit/pipeline/referenced_captures.py`. Angles are means in degrees: over all pixels, and
over pixels that exactly one light does not reach; depth errors in mm after the free scale is fixed.
Simulated scenes are measured twice: with M of the scene's centre, and with the M of every pixel (near lights
calibrated). A frame of a running video is timed by stage, medians on all cores. Times at 1280×720 are minima
of three runs in one thread.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from recipes.real_objects import CAPTURES, ReferencedCapture, read_capture
from vntoolkit.geometry.camera import Camera
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.integration.integrate import DepthIntegrator
from vntoolkit.meshing.surface import mesh_from_depth
from vntoolkit.normals.expected_error import with_expected_error
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.depth import IntegrationOptions, Integrator
from vntoolkit.options.normals import RecoveryMethod, ShadowMethod
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame, count_lit, lit_from_labels
from vntoolkit.photometry.levelling import Leveller
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals
from vntoolkit.simulation.image_formation import true_response, true_varying_response
from vntoolkit.simulation.render import FrameTruth, SimulatedFrame, render_frame
from vntoolkit.simulation.scene import build_scene


def simulated(name: str, near: bool) -> tuple[ReferencedCapture, SimulatedFrame, Camera]:
    scene = build_scene(name, SceneOptions())
    frame = render_frame(scene, 0)
    response = true_varying_response(scene, Nuisances()) if near else true_response(scene, Nuisances())
    truth = frame.truth
    capture = ReferencedCapture(
        frame=frame.linear,
        response=response,
        normals=truth.normals.normals_in_camera,
        labels=truth.labels,
        mask=truth.normals.mask,
    )
    return capture, frame, scene.camera


def recovered(capture: ReferencedCapture, labels, method: RecoveryMethod, camera=None) -> NormalMap:
    frame, response = capture.frame, capture.response
    if response.variation is not None:
        frame = Leveller(response, frame.shape).frame(frame)
    return recover_normals(frame, labels, response.central, capture.mask, camera, method)


def errors(capture: ReferencedCapture, found: NormalMap) -> str:
    angles = angles_deg(found.normals_in_camera, capture.normals)
    lights, both = count_lit(capture.labels), capture.mask & found.mask
    groups = {"all": both} | {
        name: both & (lights == count) for name, count in (("lit", 3), ("one shadow", 2))
    }
    return ", ".join(f"{name} {angles[group].mean():6.2f}" for name, group in groups.items())


def overlap(capture: ReferencedCapture, labels) -> str:
    dark, true = ~lit_from_labels(labels)[capture.mask], ~lit_from_labels(capture.labels)[capture.mask]
    return " ".join(f"{x:.2f}" for x in (dark & true).sum(0) / np.maximum((dark | true).sum(0), 1))


def report(name: str, capture: ReferencedCapture, camera=None) -> dict[str, NormalMap]:
    """Print all figures of a capture; return the normals without and with the default recovery."""
    plain = normals_from_frame(capture.frame, capture.response, capture.mask)
    print(f"\n{name}\n  plain inversion        {errors(capture, plain)}")
    labels, frame = {"true": capture.labels}, capture.frame
    if capture.response.variation is not None:
        frame = Leveller(capture.response, frame.shape).frame_by_strength(frame)
    for method in (ShadowMethod.PUBLISHED, ShadowMethod.ROBUST):
        detector = ShadowDetector(capture.response.central, method, camera=camera)
        labels[method.value] = detector.labels(frame, capture.mask)
        shared = overlap(capture, labels[method.value])
        print(f"  {method.value:9} overlap with the true shadows of each light: {shared}")
    for found, values in labels.items():
        for method in (RecoveryMethod.TWO_LIGHTS, RecoveryMethod.SURFACE):
            normals = recovered(capture, values, method, camera)
            print(f"  {found:9}, {method.value:10}  {errors(capture, normals)}")
    return {"none": replace(plain, weight=None), "robust": normals}


def depths(maps: dict[str, NormalMap], truth: FrameTruth, camera: Camera) -> None:
    """Depth over the figure; with true normals, and with true normals outside the shadows, beside it."""
    shadow = (count_lit(truth.labels) < 3)[..., None]
    maps = {"true": truth.normals} | maps
    for name in ("none", "robust"):
        mixed = np.where(shadow, maps[name].normals_in_camera, truth.normals.normals_in_camera)
        mask = maps[name].mask & truth.normals.mask
        maps[f"{name} in shadow"] = NormalMap(normals_in_camera=mixed * mask[..., None], mask=mask)
    for name, normals in maps.items():
        row = []
        for integrator in (Integrator.POISSON, Integrator.DISCONTINUITY):
            found = DepthIntegrator(camera, IntegrationOptions(integrator=integrator)).integrate(normals)
            both = found.mask & truth.depth.mask
            z, true = found.depth[both], truth.depth.depth[both]
            error = 1000 * np.abs(z * np.median(true) / np.median(z) - true).mean()
            row.append(f"{integrator.value} {error:6.1f} mm")
        print(f"  depth, normals {name:16} {', '.join(row)}")


def fastest(work, repeats: int = 3) -> float:
    """Least processor time in seconds: a busy machine does not count; work runs in one thread."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def times(capture: ReferencedCapture) -> None:
    size = (1280, 720)
    rgb = np.clip(cv2.resize(capture.frame.rgb, size, interpolation=cv2.INTER_CUBIC), 0, 1)
    frame = LinearFrame(rgb=rgb, clipped=(rgb >= 1).any(axis=-1))
    figure = cv2.resize(capture.mask.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
    for title, mask in (("the figure", figure), ("all pixels", np.ones_like(figure))):
        print(f"\n1280×720, {title} in the mask ({mask.mean():.0%}); seconds of processor time")
        for method in (ShadowMethod.PUBLISHED, ShadowMethod.ROBUST):
            detector = ShadowDetector(capture.response.central, method)
            labels = detector.labels(frame, mask)
            print(f"  detect, {method.value:10} {fastest(lambda: detector.labels(frame, mask)):6.2f}")  # noqa: B023
        for recovery in RecoveryMethod:
            seconds = fastest(
                lambda: recover_normals(frame, labels, capture.response.central, mask, method=recovery)  # noqa: B023
            )
            print(f"  recover, {recovery.value:10} {seconds:6.2f}")


def stages(capture: ReferencedCapture, camera: Camera, repeats: int = 8) -> None:
    """Median milliseconds of each stage of a frame in a running video, with all cores."""
    response, mask = capture.response.central, capture.mask
    detector, integrator = (
        ShadowDetector(response, camera=camera),
        DepthIntegrator(camera, IntegrationOptions()),
    )
    rows: list[list[float]] = []
    for _ in range(repeats):
        ticks = [time.perf_counter()]
        labels = detector.labels(capture.frame, mask)
        ticks.append(time.perf_counter())
        found = recover_normals(capture.frame, labels, response, mask, camera, start=detector.surface)
        ticks.append(time.perf_counter())
        normals = with_expected_error(found, capture.frame, response, labels, camera)
        ticks.append(time.perf_counter())
        depth = integrator.integrate(normals)
        ticks.append(time.perf_counter())
        mesh_from_depth(depth, camera, rgb=capture.frame.rgb, normal_map=normals)
        ticks.append(time.perf_counter())
        rows.append(list(np.diff(ticks) * 1000))
    names = ("detection", "recovery", "expected error", "integration", "mesh")
    medians = np.median(rows[2:], axis=0)
    print(
        f"\n{mask.shape[1]}×{mask.shape[0]}, a running video's frame by stage, {mask.mean():.0%} in the mask"
    )
    for name, milliseconds in zip((*names, "all"), (*medians, medians.sum()), strict=True):
        print(f"  {name:14} {milliseconds:6.1f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, help="folder of real captures")
    parser.add_argument("--scenes", nargs="*", default=["spandex", "face"])
    arguments = parser.parse_args()
    for name in arguments.scenes:
        for near in (False, True):
            capture, frame, camera = simulated(name, near)
            title = f"{name}, M of every pixel" if near else f"{name}, M of the centre"
            depths(report(title, capture, camera), frame.truth, camera)
        stages(capture, camera)
        times(capture)
    for name in CAPTURES if arguments.data else ():
        report(name, read_capture(arguments.data, name))


if __name__ == "__main__":
    main()

"""Normals of two real gels, on presses of a ball that the calibration did not see; and times of a frame.

    python -m benchmarks.gels --data DIR [--presses 20] [--splits 3] [--out DIR]     # 10 min

DIR holds presses into a GelSight (gelsight/ball_presses) and a GelSight Mini (gelsight_mini). Some are drawn
for `calibrate presses`, which finds the circles; others are measured. Angles are to the normals of the ball,
inside 0.8 of the radius of the contact that is found, at the centre that fits the normals best. Beside them,
on the same presses: M alone, a network of the size that kits ship, and a polynomial of colour and place.

Times are medians over a film of such a GelSight with printed dots (gelsight/dotted_ball), of as many pixels
as 320×240 have. Beside each frame a plain one is timed, as in `benchmarks.ratios`.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import vntoolkit as vt
from benchmarks.gel_baselines import network, polynomial
from benchmarks.pipeline import footage, options_of, rig_of
from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.io.footage.decoding import EncodedFrame, Rectifier, linear_frame_from_encoded
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.photometry.rig import Rig
from vntoolkit.pipeline.frame_processor import Carried, FrameProcessor
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.tactile.circles import find_contact_circle
from vntoolkit.tactile.dots import DotFilter
from vntoolkit.tactile.inversion import change_without_drift
from vntoolkit.tactile.response import first_estimate, normals_from_stereographic

SENSORS: dict[str, dict[str, Any]] = {
    "GelSight": {
        "presses": "gelsight/ball_presses/cal-*.jpg",
        "background": "gelsight/ball_presses/bg-0.jpg",
        "ball_radius_mm": 2.42,
        "pixel_mm": 0.1,
        "corners": (33, 58, 208, 61, 56, 250, 185, 244),
        "size_mm": (24, 34.88),
    },
    "GelSight Mini": {
        "presses": "gelsight_mini/p*.png",
        "background": "gelsight_mini/background.png",
        "ball_radius_mm": 3.155,
        "pixel_mm": 0.0634,
    },
}
FILM, UNTOUCHED = "gelsight/dotted_ball/0*.jpg", "gelsight/dotted_ball/dotted_ball_background.jpg"
FILM_PX, TIMED, WARM_UP = 320 * 240, 110, 10  # pixels of a frame; frames, and those that compile
MEASURED = 24
CONTACT_SHARE = 0.8
IN_CONTACT, ON_FLAT = 800, 540  # pixels of a press, as many as the calibration draws
FLAT_RADII = 3.3  # of a contact: beyond it the gel lies flat


def angles_to_ball(normals: FloatArray, contact: Mask, ball_px: float) -> FloatArray:
    """Return the angles in degrees to the ball that fits best: the normal of its surface is p / radius."""
    places = np.argwhere(contact)[:, ::-1].astype(np.float64)
    found = normals[contact].astype(np.float64)
    offsets = places - np.median(places - ball_px * found[:, :2], axis=0)
    distance = np.linalg.norm(offsets, axis=1)
    inside = distance < CONTACT_SHARE * np.sqrt(contact.sum() / np.pi)
    ball = np.column_stack([offsets, -np.sqrt(np.maximum(ball_px**2 - distance**2, 0))]) / ball_px
    return np.degrees(np.arccos(np.clip((found * ball).sum(axis=1), -1, 1)))[inside]


def rig_on(presses: Iterable[Path], data: Path, sensor: dict[str, Any]) -> Rig:
    """Calibrate on some presses of a sensor."""
    asked = {name: value for name, value in sensor.items() if name != "presses"}
    asked["background"] = data / sensor["background"]
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "presses"
        folder.mkdir()
        for path in presses:
            (folder / path.name).symlink_to(path.resolve())
        return vt.calibrate_presses(folder, out=Path(scratch) / "gel.json", **asked)


def frame_of(path: Path) -> EncodedFrame:
    """Read the first frame of a file."""
    return next(vt.open_capture(path).encoded_frames())


def errors_of(sensor: dict[str, Any], data: Path, presses: int, seed: int) -> dict[str, FloatArray]:
    """Calibrate each method on some presses, and return its angles on others."""
    rng, files = np.random.default_rng(seed), sorted(data.glob(sensor["presses"]))
    drawn = rng.permutation(np.array(files))
    rig, background = rig_on(drawn[:presses], data, sensor), data / sensor["background"]
    gel = vt.Gel(rig, frame_of(background).values)

    def as_filmed(path: Path) -> FloatArray:
        frame = vt.open_capture(path, vt.CaptureOptions(transfer=rig.transfer)).frame(0)
        return (Rectifier(rig.gel.rectification).frame(frame) if rig.gel.rectification else frame).rgb

    untouched, ball_px = as_filmed(background), sensor["ball_radius_mm"] / gel.pixel_mm
    by_network, by_polynomial = others_of([as_filmed(p) for p in drawn[:presses]], untouched, ball_px)
    angles: dict[str, list[FloatArray]] = {}
    for path in drawn[presses : presses + MEASURED]:
        touch, filmed = gel(frame_of(path).values), as_filmed(path)
        scaled = (filmed - untouched).reshape(-1, 3) @ rig.response.inverse.T
        by_matrix = normals_from_stereographic(first_estimate(scaled)).reshape(filmed.shape)
        for method, normals in (
            ("measured", touch.normals),
            ("M alone", by_matrix),
            ("network", by_network(filmed)),
            ("polynomial", by_polynomial(filmed)),
        ):
            angles.setdefault(method, []).append(angles_to_ball(normals, touch.contact, ball_px))
    return {method: np.concatenate(parts) for method, parts in angles.items()}


def others_of(presses: list[FloatArray], untouched: FloatArray, ball_px: float) -> list[Any]:
    """Fit network and polynomial to frames of presses; each takes a frame to normals (h, w, 3)."""
    dots, (v, u) = DotFilter(untouched), np.indices(untouched.shape[:2])
    place, nothing = np.stack([u, v], axis=-1) / max(u.shape), np.zeros(u.shape, bool)
    rng, rows = np.random.default_rng(0), []
    for press, frame in enumerate(presses):
        change, filled = dots.filled(frame - untouched, nothing)
        found = find_contact_circle(change_without_drift(change, ~filled))
        if found is None:
            continue
        offsets = np.stack([u - found.u_px, v - found.v_px], axis=-1) / ball_px
        distance = np.linalg.norm(offsets, axis=-1) * ball_px / found.radius_px
        for inside, count in ((distance < CONTACT_SHARE, IN_CONTACT), (distance > FLAT_RADII, ON_FLAT)):
            at = np.flatnonzero(inside & ~filled)
            at = rng.permutation(at)[:count]
            xy = offsets.reshape(-1, 2)[at] * (count == IN_CONTACT)
            slopes = xy / np.sqrt(1 - (xy**2).sum(axis=1, keepdims=True))
            parts = frame.reshape(-1, 3)[at], change.reshape(-1, 3)[at], place.reshape(-1, 2)[at], slopes
            rows.append((*parts, np.full(len(at), press)))
    rgb, change, places, slopes, numbers = (np.concatenate(each) for each in zip(*rows, strict=True))
    slopes_of_colour = network(np.hstack([rgb, places]), slopes, numbers)
    slopes_of_change = polynomial(np.hstack([change, places]), slopes)

    def at_all(colours: FloatArray) -> FloatArray:
        return np.hstack([colours.reshape(-1, 3), place.reshape(-1, 2)])

    at_rest = slopes_of_colour(at_all(untouched))

    def normals(slopes: FloatArray) -> FloatArray:
        whole = np.column_stack([slopes, -np.ones(len(slopes))])
        return (whole / np.linalg.norm(whole, axis=1, keepdims=True)).reshape(untouched.shape)

    return [
        lambda frame: normals(slopes_of_colour(at_all(frame)) - at_rest),
        lambda frame: normals(slopes_of_change(at_all(dots.filled(frame - untouched, nothing)[0]))),
    ]


def times_of(data: Path, presses: int) -> dict[str, FloatArray]:
    """Return milliseconds of each frame of a film, by what is done."""
    sensor = SENSORS["GelSight"]
    pixel_mm = float(np.sqrt(np.prod(sensor["size_mm"]) / FILM_PX))
    rig = rig_on(sorted(data.glob(sensor["presses"]))[:presses], data, {**sensor, "pixel_mm": pixel_mm})
    film = [frame_of(path) for path in sorted(data.glob(FILM))[:TIMED]]
    untouched = frame_of(data / UNTOUCHED)
    gel = vt.Gel(rig, untouched.values, allow=("background", "light"))
    pose = vt.ObjectPose(rig.camera)
    background = linear_frame_from_encoded(untouched, rig.transfer).rgb
    to_depth = FrameProcessor(rig, ReconstructOptions(to=Product.DEPTH), background=background)
    size = rig.camera.width, rig.camera.height
    plain, of_plain, of_gel = FrameProcessor(rig_of(*size), options_of()), Carried(), Carried()
    ticks = []
    for frame, values in zip(film, footage(*size, len(film)), strict=True):
        ticks.append([time.perf_counter()])
        plain.process(replace(frame, values=values), None, of_plain)
        ticks[-1].append(time.perf_counter())
        to_depth.process(frame, None, of_gel)
        ticks[-1].append(time.perf_counter())
        touch = gel(frame.values)
        ticks[-1].append(time.perf_counter())
        pose(touch)
        ticks[-1].append(time.perf_counter())
    on_plain, on_depth, on_touch, on_pose = 1000.0 * np.diff(np.array(ticks[WARM_UP:])).T
    return {
        "a plain frame": on_plain,
        "depth and contact": on_depth,
        "with motion": on_touch,
        "with motion and pose": on_touch + on_pose,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=os.environ.get("VNTOOLKIT_REAL_DATA"))
    parser.add_argument("--presses", type=int, default=20, help="that the calibration sees")
    parser.add_argument("--splits", type=int, default=3, help="into presses that are seen and measured")
    parser.add_argument("--out", type=Path, help="folder for numbers.json")
    arguments = parser.parse_args()
    if arguments.data is None:
        raise SystemExit("give --data FOLDER: the folder with gelsight and gelsight_mini")
    numbers = []
    for name, sensor in SENSORS.items():
        splits = [
            errors_of(sensor, arguments.data, arguments.presses, seed)
            for seed in range(1, arguments.splits + 1)
        ]
        for method in splits[0]:
            each = [split[method] for split in splits]
            of_splits = ", ".join(f"{np.median(angles):.2f}" for angles in each)
            angles = np.concatenate(each)
            numbers += [
                number(f"{name}, {method}: median", float(np.median(angles)), "degrees"),
                number(f"{name}, {method}: nine of ten", float(np.percentile(angles, 90)), "degrees"),
                number(f"{name}, {method}: median of each split", of_splits, "degrees"),
            ]
    times = times_of(arguments.data, arguments.presses)
    plain_ms = float(np.median(times.pop("a plain frame")))
    numbers.append(number("times: a plain frame", plain_ms, "ms"))
    numbers += [
        number(f"times: {what}", float(np.median(each)) / plain_ms, "plain frames")
        for what, each in times.items()
    ]
    for each in numbers:
        shown = each.ours if isinstance(each.ours, str) else f"{each.ours:.3g}"
        print(f"{each.what}: {shown} {each.unit}")
    if arguments.out:
        write_numbers(arguments.out, numbers)


if __name__ == "__main__":
    main()

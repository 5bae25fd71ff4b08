"""Normals of two real gels, on presses of a ball that the calibration did not see.

    python -m benchmarks.gels --data DIR [--presses 20] [--seed 1] [--out DIR]     # 2 min

DIR holds presses into a GelSight (gelsight/ball_presses) and a GelSight Mini (gelsight_mini). Some are drawn
for `calibrate presses`, which finds the circles; others are measured. Angles are to the normals of the ball,
inside 0.8 of the radius of the contact that is found, at the centre that fits the normals best. The plain
method is M alone.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import vntoolkit as vt
from vntoolkit.arrays import FloatArray, Mask
from vntoolkit.io.footage.decoding import rectify_frame
from vntoolkit.report.recipes_page import number, write_numbers

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
MEASURED = 24
CONTACT_SHARE = 0.8


def angles_to_ball(normals: FloatArray, contact: Mask, ball_px: float) -> FloatArray:
    """Return the angles in degrees to the ball that fits best: the normal of its surface is p / radius."""
    places = np.argwhere(contact)[:, ::-1].astype(np.float64)
    found = normals[contact].astype(np.float64)
    offsets = places - np.median(places - ball_px * found[:, :2], axis=0)
    distance = np.linalg.norm(offsets, axis=1)
    inside = distance < CONTACT_SHARE * np.sqrt(contact.sum() / np.pi)
    ball = np.column_stack([offsets, -np.sqrt(np.maximum(ball_px**2 - distance**2, 0))]) / ball_px
    return np.degrees(np.arccos(np.clip((found * ball).sum(axis=1), -1, 1)))[inside]


def errors_of(sensor: dict[str, Any], data: Path, presses: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Calibrate on some presses, and return the angles of others: as measured, and by M alone."""
    asked = {**sensor, "background": data / sensor["background"]}
    rng, files = np.random.default_rng(seed), sorted(data.glob(asked.pop("presses")))
    drawn = rng.permutation(np.array(files))
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / "presses"
        folder.mkdir()
        for path in drawn[:presses]:
            (folder / path.name).symlink_to(path.resolve())
        rig = vt.calibrate_presses(folder, out=Path(scratch) / "gel.json", **asked)
        gel = vt.Gel.read(Path(scratch) / "gel.json", asked["background"])

    def as_filmed(path: Path) -> FloatArray:
        frame = vt.open_capture(path, vt.CaptureOptions(transfer=rig.transfer)).frame(0)
        return (rectify_frame(frame, rig.gel.rectification) if rig.gel.rectification else frame).rgb

    untouched, ball_px = as_filmed(asked["background"]), asked["ball_radius_mm"] / gel.pixel_mm
    measured, plain = [], []
    for path in drawn[presses : presses + MEASURED]:
        touch = gel(next(vt.open_capture(path).encoded_frames()).values)
        by_matrix = vt.normals_from_frame(vt.LinearFrame(as_filmed(path) - untouched), rig.response)
        for normals, angles in ((touch.normals, measured), (by_matrix.normals_in_camera, plain)):
            angles.append(angles_to_ball(normals, touch.contact, ball_px))
    return np.concatenate(measured), np.concatenate(plain)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, default=os.environ.get("VNTOOLKIT_REAL_DATA"))
    parser.add_argument("--presses", type=int, default=20, help="that the calibration sees")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, help="folder for numbers.json")
    arguments = parser.parse_args()
    if arguments.data is None:
        raise SystemExit("give --data FOLDER: the folder with gelsight and gelsight_mini")
    numbers = []
    for name, sensor in SENSORS.items():
        for method, angles in zip(
            ("measured", "M alone"),
            errors_of(sensor, arguments.data, arguments.presses, arguments.seed),
            strict=True,
        ):
            numbers += [
                number(f"{name}, {method}: median", float(np.median(angles)), "degrees"),
                number(f"{name}, {method}: nine of ten", float(np.percentile(angles, 90)), "degrees"),
            ]
    for each in numbers:
        print(f"{each.what}: {each.ours:.3g} {each.unit}")
    if arguments.out:
        write_numbers(arguments.out, numbers)


if __name__ == "__main__":
    main()

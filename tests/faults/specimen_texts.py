"""Small good files of text: motion capture, rigs, manifests, seams, lights, labels, fits."""

from __future__ import annotations

import json
from pathlib import Path

from tests.motion_texts import AMC, ASF, BVH
from vntoolkit.io.atomic import write_text
from vntoolkit.io.results.frame_log import FrameEntry, FrameLog
from vntoolkit.io.results.manifest import InputEntry, Manifest
from vntoolkit.io.results.reconstruction import write_manifest
from vntoolkit.io.rigs import entry_from_rig, write_rig
from vntoolkit.photometry.rig import Rig


def write_motion(folder: Path) -> list[tuple[str, Path]]:
    (folder / "acclaim").mkdir(parents=True)
    (folder / "a.bvh").write_text(BVH)
    (folder / "acclaim" / "a.asf").write_text(ASF)
    (folder / "acclaim" / "a.amc").write_text(AMC)
    return [("bvh", folder / "a.bvh"), ("acclaim", folder / "acclaim")]


def write_texts(folder: Path, rig: Rig) -> list[tuple[str, Path]]:
    folder.mkdir()
    write_rig(folder / "rig.json", rig)
    entry = InputEntry(
        source="a.mkv",
        files=[],
        width=rig.camera.width,
        height=rig.camera.height,
        frame_count=3,
        frame_rate_hz=30,
    )
    write_manifest(
        folder / "result",
        Manifest(input=entry, rig=entry_from_rig(rig), options={"a": 1.5, "b": "x", "c": None}),
    )
    log = FrameLog(folder / "result")
    for number in range(3):
        log.append(FrameEntry(number=number, seconds=0.01, valid_share=0.5))
    log.close()
    record = {"version": 1, "template": 0, "options": {}, "seams": [], "frames": [0, 1, 2]}
    write_text(folder / "track" / "track.json", json.dumps(record, indent=2) + "\n")
    (folder / "seams.json").write_text('{"seams": [[[3, 4], [5.5, 6], [7, 8]], [[1, 2], [2, 3]]]}')
    (folder / "lights.txt").write_text("2\n# x y z r g b\n0.1 0.2 0.9 1 1 1\n-0.1 0.2 0.9 1 0.5 1\n")
    (folder / "diligent").mkdir()
    (folder / "diligent" / "light_directions.txt").write_text("0.1 0.2 0.9\n0 0 1\n")
    (folder / "diligent" / "light_intensities.txt").write_text("1 1 1\n0.9 1 1\n")
    (folder / "diligent" / "filenames.txt").write_text("001.png\n002.png\n")
    (folder / "press.txt").write_text("120.5 99.25 17\n")
    landmarks = [{"vertex": k, "joint": "Hips", "offset_m": [0, 0.1, 0]} for k in range(3)]
    fit = {"version": 1, "scale": 1.1, "rotation_deg": [0, 5, 0], "bind_frame": 0, "landmarks": landmarks}
    fit["pose_deg"] = {"Hips": [0, 0, 9]}
    (folder / "fit.json").write_text(json.dumps(fit, indent=1))
    return [
        ("rig", folder / "rig.json"), ("manifest", folder / "result"), ("track", folder / "track"),
        ("seams", folder / "seams.json"), ("lights", folder / "lights.txt"), ("lights", folder / "diligent"),
        ("press", folder / "press.txt"), ("fit", folder / "fit.json"),
    ]  # fmt: skip

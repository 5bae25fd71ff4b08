"""Is sound footage left in peace? Captures without a mistake are reconstructed, and every warning is listed.

python -m benchmarks.sound_captures [FOLDER ...] [--seeds 41 42] [--data DATA] [--out FILE]

Scenes of the simulator, of one paint, of many and of bare skin, are filmed at 320×240, in 8 bits linear, in 8
bits encoded and in 12 bits, each with the true M of the middle of its picture and the lamps' colours. FOLDER:
a capture of another renderer, `capture.mkv` with its right `rig.json`. DATA: photographs of statues in
`coloured_light`, of faces under three of many flashes in `faces`, and presses of gels in `gelsight_mini`.
"""

from __future__ import annotations

import argparse
import json
import logging
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from recipes.real_objects import read_capture
from vntoolkit.errors import VntError
from vntoolkit.geometry.camera import Camera
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.results.manifest import ReconstructionFolder, read_manifest
from vntoolkit.io.rigs import read_rig
from vntoolkit.options.calibration import PressOptions
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.response import LightResponse
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, encoded_from_linear
from vntoolkit.pipeline.calibrate_presses import PressJob, calibrate_presses
from vntoolkit.pipeline.reconstruct import reconstruct
from vntoolkit.pipeline.request import Request
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

SCENES = (
    "jacket", "sweater", "spandex", "cylinder", "sweater_stripes", "sweater_logo", "sweater_tartan",
    "head_turn", "face", "face_makeup",
)  # fmt: skip
STORED = (("linear", 8), ("srgb", 8), ("linear", 12))
STATUES = ("buddha", "cat")
FRAMES, STEP = 6, 2
FLASHES = re.compile(r"A([+-]\d+)E([+-]\d+)")
TILTS_DEG = (20.0, 55.0)  # of flashes from the axis: further round, most of a face is in shadow


def simulated(folder: Path, seeds: list[int]) -> Iterator[tuple[str, Path, Rig, Path | None]]:
    """Film every scene; the way it is stored changes from one to the next."""
    for k, (seed, name) in enumerate((seed, name) for seed in seeds for name in SCENES):
        curve, bits = STORED[(k + seed) % len(STORED)]
        scene = build_scene(name, SceneOptions(width=320, height=240, seed=seed))
        transfer, to = Transfer.from_text(curve), folder / f"{name}-{seed}-{curve}-{bits}"
        to.mkdir()
        for at in range(FRAMES):
            frame = render_frame(scene, min(STEP * at, scene.frame_count - 1))
            stored = encoded_from_linear(np.clip(frame.linear.rgb, 0, 1), transfer)
            rounded = np.rint(stored * (2**bits - 1)) / (2**bits - 1)
            write_png(to / f"f{at:02d}.png", np.rint(rounded * 65535).astype(np.uint16))
        response = true_response(scene, Nuisances())
        yield to.name, to, Rig(camera=scene.camera, response=response, transfer=transfer), None


def faces(data: Path, folder: Path, count: int) -> Iterator[tuple[str, Path, Rig, Path | None]]:
    """Stack photographs under three flashes as red, green and blue; the lamps are known."""
    rng = np.random.default_rng(68)
    for person in sorted((data / "faces").iterdir()):
        files = [path for path in sorted(person.glob("*.pgm")) if FLASHES.search(path.name)]
        angles = np.deg2rad([[int(x) for x in FLASHES.search(path.name).groups()] for path in files])  # type: ignore[union-attr]
        azimuth, elevation = angles.T
        lamps = np.stack(
            [-np.sin(azimuth) * np.cos(elevation), -np.sin(elevation), -np.cos(azimuth) * np.cos(elevation)],
            1,
        )
        tilts = np.rad2deg(np.arccos(-lamps[:, 2]))
        near = np.flatnonzero((tilts > TILTS_DEG[0]) & (tilts < TILTS_DEG[1]))
        made = 0
        while made < count:
            three = rng.choice(near, 3, replace=False)
            if np.linalg.cond(lamps[three]) > 4:
                continue
            made += 1
            picture = np.dstack([cv2.imread(str(files[k]), 0) for k in three])
            path = folder / f"{person.name}-{made}.png"
            write_png(path, picture)
            camera = Camera.orthographic(width=picture.shape[1], height=picture.shape[0])
            response = LightResponse(matrix=lamps[three] * 0.6, light_colours=np.eye(3))
            yield path.stem, path, Rig(camera=camera, response=response), None


def statues(data: Path, folder: Path) -> Iterator[tuple[str, Path, Rig, Path | None]]:
    """Yield the statues' photographs with their masks; their M is that of the grey ball."""
    for name in STATUES:
        capture = read_capture(data, name)
        height, width = capture.mask.shape
        path, mask = folder / f"{name}.png", folder / f"{name}_mask.png"
        write_png(path, np.rint(65535 * capture.frame.rgb.clip(0, 1)).astype(np.uint16))
        write_mask(mask, capture.mask)
        camera = Camera.orthographic(width=width, height=height)
        yield name, path, Rig(camera=camera, response=capture.response), mask


def said_of(source: Path, rig: Rig, mask: Path | None, out: Path) -> list[str]:
    """Return the warnings and errors of a reconstruction."""
    request = Request(
        source=str(source),
        rig=rig,
        mask=mask,
        options=ReconstructOptions(to=Product.NORMALS),
        folder=ReconstructionFolder(root=out),
    )
    try:
        reconstruct(request)
    except VntError as problem:
        return [f"stopped: {problem}"]
    manifest = read_manifest(out)
    return [f.line for f in (*manifest.known.findings, *manifest.findings) if f.level != "note"]


def said_of_presses(data: Path, folder: Path, seed: int) -> list[str]:
    """Return what is found wrong with presses of a gel, half of those that are there."""
    rng, source = np.random.default_rng(seed), data / "gelsight_mini"
    presses = sorted(source.glob("p*.png"))
    folder.mkdir()
    for path in rng.choice(np.array(presses), len(presses) // 2, replace=False):
        (folder / path.name).symlink_to(path)
    job = PressJob(source=str(folder), background=source / "background.png", transfer=Transfer())
    try:
        made = calibrate_presses(job, PressOptions(ball_radius_mm=3.155, pixel_mm=0.0634))
    except VntError as problem:
        return [f"stopped: {problem}"]
    return [finding.text for finding in made.findings if finding.level.value != "note"]


def captures(asked: argparse.Namespace, folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield the name of each capture and what is said of it."""
    others = ((path.name, path / "capture.mkv", read_rig(path / "rig.json"), None) for path in asked.folders)
    made = [simulated(folder, asked.seeds), others]
    if asked.data is not None:
        made += [statues(asked.data, folder), faces(asked.data, folder, asked.faces)]
    for each in made:
        for name, source, rig, mask in each:
            yield name, said_of(source, rig, mask, folder / "out" / name)
    for seed in range(asked.presses if asked.data is not None else 0):
        yield f"presses-{seed}", said_of_presses(asked.data, folder / f"presses-{seed}", seed)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="*")
    parser.add_argument("--seeds", type=int, nargs="*", default=[41])
    parser.add_argument("--data", type=Path)
    parser.add_argument("--faces", type=int, default=5, help="of each person")
    parser.add_argument("--presses", type=int, default=2, help="calibrations on presses")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    logging.getLogger("vntoolkit").setLevel(logging.WARNING)
    said: dict[str, list[str]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, texts in captures(asked, Path(folder)):
            said[name] = texts
            print(f"{name}: {'silent' if not texts else ''}", flush=True)
            for text in texts:
                print(f"    {text[:300]}", flush=True)
    silent = sum(not texts for texts in said.values())
    print(f"{silent} of {len(said)} silent")
    if asked.out is not None:
        asked.out.write_text(json.dumps(said, indent=1) + "\n")


if __name__ == "__main__":
    main()

"""Is the expected error of normals right? Of the pixels said to be within x degrees, how many are?

python -m benchmarks.expected_errors [--scenes sweater jacket] [--seeds 1 2] [--far] [--out DIR]   # 1 min

Up to two frames of each scene of the simulator, 480×360, every nuisance of a camera on, the true M of the
picture's middle, shadows looked for, near lamps and blur told by the footage as `reconstruct` does. A number
is the share of the pixels said to be within x degrees, a quarter more or less, that are within what is said
of them; 0.85 to 0.95 is meant. --far: lamps far away.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray, Int64Array
from vntoolkit.diagnosis.evidence import evidence_from_frames
from vntoolkit.diagnosis.inspection import blur_of_colours
from vntoolkit.diagnosis.lamp_nearness import fit_nearness
from vntoolkit.diagnosis.sharpness import fit_sharpness
from vntoolkit.io.footage.decoding import EncodedFrame
from vntoolkit.options.reconstruction import Product, ReconstructOptions
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.frame import count_lit
from vntoolkit.photometry.response import with_near_lamps
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer
from vntoolkit.pipeline.frame_processor import FrameProcessor
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

SCENES = ("sweater", "jacket", "spandex", "face_makeup")
FRAMES, SIZE = (0, 25), (480, 360)
DEGREES = (1, 1.5, 2, 3, 4, 6, 8, 12, 16, 20, 30)
LAMPS = ("none", "one", "two", "three")  # that reach a pixel
WIDTH, LEAST = 1.25, 0.01  # of a band; share of the pixels below which nothing is said


def said_and_true(name: str, seed: int, far: bool) -> tuple[FloatArray, FloatArray, Int64Array]:
    """Return of every pixel the expected and true error, degrees, and how many lamps reach it, (n,) each."""
    scene = build_scene(name, SceneOptions(width=SIZE[0], height=SIZE[1], seed=seed))
    nuisances = replace(Nuisances(), near_lights=not far)
    numbers = sorted({min(number, scene.frame_count - 1) for number in FRAMES})
    shots = [render_frame(scene, number, nuisances=nuisances) for number in numbers]
    frames = [shot.linear for shot in shots]
    rig = Rig(camera=scene.camera, response=true_response(scene, nuisances))
    near = fit_nearness(evidence_from_frames(frames, rig, Transfer()))
    if near is not None and near.established:
        rig = replace(rig, response=with_near_lamps(rig.response, near.established, SIZE))
    processor = FrameProcessor(
        rig,
        replace(ReconstructOptions(), to=Product.NORMALS),
        blur_px=blur_of_colours(fit_sharpness(frames), "4:4:4", frames[0]),
    )
    said, true, lit = [], [], []
    for shot in shots:
        values, truth = shot.stored, shot.truth.normals
        found = processor.process(EncodedFrame(values=values, bits=8, number=shot.number, name=name))
        both = found.normal_map.mask & truth.mask
        cosine = (found.normal_map.normals_in_camera * truth.normals_in_camera).sum(axis=-1)[both]
        assert found.normal_map.error_deg is not None
        said.append(found.normal_map.error_deg[both])
        true.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        lit.append(count_lit(shot.truth.labels)[both])
    return np.concatenate(said), np.concatenate(true), np.concatenate(lit)


def shares(said: FloatArray, true: FloatArray) -> list[float | None]:
    """Return for each of DEGREES the share that is within what is said; None where few are said to be so."""
    found: list[float | None] = []
    for degrees in DEGREES:
        band = (said > degrees / WIDTH) & (said <= degrees * WIDTH)
        within = float((true[band] <= said[band]).mean()) if band.mean() > LEAST else None
        found.append(within)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--scenes", nargs="*", default=SCENES)
    parser.add_argument("--seeds", nargs="*", type=int, default=[1])
    parser.add_argument("--far", action="store_true")
    parser.add_argument("--out", type=Path, help="folder for numbers.json")
    arguments = parser.parse_args()
    print(f"{'':24s} median: true  said | within", *(f"{x:5g}" for x in DEGREES))
    captures = []
    for name in arguments.scenes:
        for seed in arguments.seeds:
            captures.append(said_and_true(name, seed, arguments.far))
            print_row(f"{name}, seed {seed}", *captures[-1][:2])
    said, true, lit = (np.concatenate(each) for each in zip(*captures, strict=True))
    print_row("all", said, true)
    numbers = [
        number(f"pixels said to be within {degrees:g} degrees: share that is", 100 * part, "%")
        for degrees, part in zip(DEGREES, shares(said, true), strict=True)
        if part is not None
    ]
    for count, lamps in enumerate(LAMPS):
        within = (true <= said)[lit == count]
        numbers.append(number(f"lit by {lamps}: share within what is said", 100 * within.mean(), "%"))
    if arguments.out:
        print(write_numbers(arguments.out, numbers))


def print_row(name: str, said: FloatArray, true: FloatArray) -> None:
    numbers = ("    –" if part is None else f"{part:5.2f}" for part in shares(said, true))
    medians = f"{np.median(true):5.1f} {np.median(said):5.1f}"
    print(f"{name:24s}        {medians} | {(true <= said).mean():6.2f}", *numbers, flush=True)


if __name__ == "__main__":
    main()

"""Real objects' normals, painted with random materials and lit by three lamps: how well they are told.

python -m benchmarks.painted_objects [--data FOLDER] [--seeds 1 2] [--out DIR]      # 2 min a seed

Each of four objects is painted with one, two, four, six materials in Voronoi patches, ρ of 0.25 to 0.95 in
every band, stored in 8 or 16 bits with noise of one level. Lamps, camera and mask are given. A line says the
mean error in degrees of the normals that all three lamps reach, the worst object, that with every pixel's
reflectance known, and in how many pictures the number of materials is right.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np

from vntoolkit.materials.labelling import LabelState, MaterialLabeller
from vntoolkit.materials.search import find_materials, searched_frames
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame
from vntoolkit.photometry.response import LightResponse
from vntoolkit.pipeline.evaluate import read_object
from vntoolkit.report.recipes_page import number, write_numbers

OBJECTS, COUNTS, BITS = ("pot2", "cow", "bear", "reading"), (1, 2, 4, 6), (8, 16)
DIRECTIONS = np.array([[0.5, 0.0, -0.866], [-0.25, 0.433, -0.866], [-0.25, -0.433, -0.866]])
COLOURS = np.array([[0.7, 0.1, 0.02], [0.08, 0.6, 0.1], [0.02, 0.12, 0.65]])
RESPONSE = LightResponse(matrix=COLOURS.T @ DIRECTIONS, light_colours=COLOURS)
PATCHES = 3  # for every material, at least 8 in all


def painted_error(folder: Path, count: int, bits: int, seed: int) -> tuple[float, float, int]:
    """Return the mean error, that with the paint known, in degrees, and how many materials were found."""
    rng = np.random.default_rng(seed)
    _, normal_map, _ = read_object(folder)
    mask, normals = normal_map.mask, normal_map.normals_in_camera
    centres = rng.choice(np.argwhere(mask), max(8, PATCHES * count), replace=False)
    paints = rng.uniform(0.25, 0.95, (count, 3))
    apart = ((np.indices(mask.shape)[..., None] - centres.T[:, None, None]) ** 2).sum(axis=0)
    rho = paints[np.arange(len(centres)) % count][apart.argmin(axis=-1)]
    shares = np.maximum(normals @ DIRECTIONS.T, 0.0)
    light = (shares * rho) @ COLOURS * mask[..., None]
    level = 1.0 / (2**bits - 1)
    stored = (light + rng.normal(0.0, level, light.shape)).clip(0.0, 1.0) / level
    frame = LinearFrame(((stored.round() * level) * mask[..., None]).astype(np.float32))
    lit = mask & (shares > 0.0).all(axis=-1)
    found = find_materials(searched_frames([frame], [mask], RESPONSE))
    values = np.array([each.reflectance.values for each in found])
    labeller = MaterialLabeller(response=RESPONSE, reflectances=values)
    labels, state = labeller.labels(frame, mask, LabelState())
    split = RESPONSE.contributions_from_rgb
    known = (frame.rgb @ split.T / rho) @ np.linalg.inv(split).T
    errors = []
    for seen in (
        labeller.relit(frame, labels, state)[0],
        LinearFrame(rgb=known.astype(np.float32)),
    ):
        result = normals_from_frame(seen, RESPONSE, mask)
        errors.append(angles_deg(result.normals_in_camera, normals)[lit & result.mask].mean())
    return float(errors[0]), float(errors[1]), len(found)


def parser_of_objects(description: str | None) -> argparse.ArgumentParser:
    """Return a parser with `--data`, by default the objects among the real photographs."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    default = os.environ.get("VNTOOLKIT_REAL_DATA")
    parser.add_argument(
        "--data", type=Path, default=Path(default) / "normal_integration" if default else None
    )
    return parser


def main() -> None:
    parser = parser_of_objects(__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--out", type=Path, help="folder for numbers.json")
    arguments = parser.parse_args()
    if arguments.data is None:
        raise SystemExit("give --data FOLDER: the folder with pot2, cow, bear, reading")
    numbers, right, pictures = [], 0, 0
    for bits in BITS:
        for count in COUNTS:
            runs = [
                painted_error(arguments.data / name, count, bits, 100 * seed + place)
                for seed in arguments.seeds
                for place, name in enumerate(OBJECTS)
            ]
            errors, known, found = np.array(runs).T
            right, pictures = right + int((found == count).sum()), pictures + len(runs)
            what = f"{bits} bits, materials {count}"
            numbers += [
                number(f"{what}: mean error", float(errors.mean()), "degrees"),
                number(f"{what}: worst object", float(errors.max()), "degrees"),
                number(f"{what}: every reflectance known", float(known.mean()), "degrees"),
            ]
            print(what, *(f"{each.ours:.2f}" for each in numbers[-3:]), flush=True)
    numbers.append(number("number of materials right", f"{right} of {pictures}", "pictures"))
    if arguments.out:
        print(write_numbers(arguments.out, numbers))


if __name__ == "__main__":
    main()

"""Figure 4: self-shadows detected in every channel, by the published detector and by ours.

    python recipes/figure04.py --out out/figure04 [--scene spandex]        # 15 s

Prints, per light, the intersection over union of the shadows with the true ones.

figure04.png: the frame, the share of each light in it, and below which lights arrive, by each detector.
"""

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from vntoolkit.arrays import Mask, VisibilityLabels
from vntoolkit.io.maps_and_meshes.label_images import label_colours
from vntoolkit.options.normals import ShadowMethod
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.photometry.frame import LinearFrame, lit_from_labels
from vntoolkit.photometry.response import LightResponse
from vntoolkit.report import pictures
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

GROUND = 205  # beside the subject: white means lit by all
LIGHT_TILES = 4  # film and three lights


def overlap(found: np.ndarray, true: np.ndarray, mask: np.ndarray) -> list[float]:
    """Return the intersection over union of the shadows of light 0, 1, 2."""
    dark, dark_true = ~lit_from_labels(found)[mask], ~lit_from_labels(true)[mask]
    return [round(float(x), 3) for x in (dark & dark_true).sum(0) / (dark | dark_true).sum(0)]


def write_figure(
    path: Path | str,
    frame: LinearFrame,
    response: LightResponse,
    labels: Mapping[str, VisibilityLabels],
    mask: Mask,
) -> None:
    """Write film, the share of each light, and below the labels of every method by name, with a legend."""
    contributions = np.clip(frame.rgb - response.ambient, 0, None) @ response.contributions_from_rgb.T
    top = np.maximum(np.percentile(contributions[mask], 99, axis=0), 1e-6) if mask.any() else np.ones(3)
    tiles = {"film": pictures.displayed(frame.rgb)}
    for k in range(3):
        share = np.clip(contributions[..., k : k + 1] / top[k], 0, 1)
        tiles[f"light {k}"] = pictures.displayed(np.repeat(share, 3, axis=-1))
    for name, found in labels.items():
        tiles[name] = np.where(mask[..., None], label_colours(found), GROUND).astype(np.uint8)
    cut = dict(zip(tiles, pictures.cropped(list(tiles.values()), mask, 0), strict=True))
    first = dict(list(cut.items())[:LIGHT_TILES])
    legend = {pictures.short_label(label): pictures.web_colour(label) for label in used(labels, mask)}
    pictures.write_tiles(path, [first, {name: cut[name] for name in cut if name not in first}], legend=legend)


def used(labels: Mapping[str, VisibilityLabels], mask: Mask) -> list[int]:
    """Return the labels that occur within the mask."""
    return sorted({int(label) for found in labels.values() for label in np.unique(found[mask])})


def main(out: Path, scene_name: str = "face") -> None:
    """Write `figure04.png` and `numbers.json` into the folder `out`."""
    scene = build_scene(scene_name, SceneOptions())
    rendered = render_frame(scene, 0)
    response = true_response(scene, Nuisances())
    truth, mask = rendered.truth.labels, rendered.truth.normals.mask
    labels = {
        method.value: ShadowDetector(response, method, camera=scene.camera).labels(rendered.linear, mask)
        for method in (ShadowMethod.PUBLISHED, ShadowMethod.ROBUST)
    }
    out.mkdir(parents=True, exist_ok=True)
    write_figure(out / "figure04.png", rendered.linear, response, {**labels, "truth": truth}, mask)
    overlaps = {name: overlap(found, truth, mask) for name, found in labels.items()}
    numbers = [
        number(f"{scene_name}, light {k}, {name}: overlap with the true shadow", values[k], "of 1")
        for name, values in overlaps.items()
        if name != "truth"
        for k in range(3)
    ]
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("out/figure04"), help="folder to write")
    parser.add_argument("--scene", default="face", help="face or spandex")
    arguments = parser.parse_args()
    main(arguments.out, arguments.scene)

"""Figure 4: self-shadows detected in every channel, by the published detector and by ours.

    python recipes/figure04.py --out out/figure04 [--scene spandex]        # 15 s

Prints, per light, the intersection over union of the shadows with the true ones.

figure04.png: the frame, the share of each light in it, and below which lights arrive, by each detector.
"""

import argparse
from pathlib import Path

import numpy as np

from vntoolkit.photometry.frame import lit_from_labels
from vntoolkit.report.figures import write_detection_figure
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.shadows.detector import ShadowDetector, ShadowMethod
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.nuisances import Nuisances
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import SceneOptions, build_scene


def overlap(found: np.ndarray, true: np.ndarray, mask: np.ndarray) -> list[float]:
    """Return the intersection over union of the shadows of light 0, 1, 2."""
    dark, dark_true = ~lit_from_labels(found)[mask], ~lit_from_labels(true)[mask]
    return [round(float(x), 3) for x in (dark & dark_true).sum(0) / (dark | dark_true).sum(0)]


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
    write_detection_figure(out / "figure04.png", rendered.linear, response, {**labels, "truth": truth}, mask)
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

"""Table: error of the normals caused by each nuisance of a real camera, in degrees.

    python recipes/nuisances.py --out out/nuisances [--scene cylinder] [--frame 60]    # 2 min; --quick 20 s

Each nuisance alone, and all but that one. M is the true one: once that of the scene's centre, once that of
every pixel (near lights).

nuisances.svg: mean error of the normals with each nuisance alone, and with all but that one.
"""

import argparse
import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path

from vntoolkit.evaluation.angular_error import AngularError, compare_normals
from vntoolkit.io.atomic import write_text
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.options.simulation import Nuisances, RenderOptions, SceneOptions, nuisance_names
from vntoolkit.report.figures import write_bars
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.simulation.image_formation import true_varying_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import Scene, build_scene

DEGREES = {"one M": 0, "M follows the lights": 2}


@dataclasses.dataclass(frozen=True, kw_only=True)
class NuisanceError:
    """One row of the table.

    name: of the nuisance; "all" and "none" frame the table. alone: error with this nuisance only. without:
    error with all others, or None where that is meaningless.
    """

    name: str
    alone: AngularError
    without: AngularError | None


def nuisance_errors(
    scene: Scene,
    nuisances: Nuisances,
    frame: int = 0,
    rendering: RenderOptions | None = None,
    degree: int = 0,
) -> Iterator[NuisanceError]:
    """Yield the normal error of equation 1's inversion: "none", every nuisance in turn, "all".

    The true M of each world is used, so that what is left is the nuisance's own doing and no calibration's.
    degree: of the polynomials by which M follows near lights over the image; 0 for M at the scene's centre.
    """

    def error(world: Nuisances) -> AngularError:
        shot = render_frame(scene, frame, nuisances=world, options=rendering)
        truth = shot.truth.normals
        return compare_normals(
            normals_from_frame(shot.linear, true_varying_response(scene, world, degree), truth.mask), truth
        )

    yield NuisanceError(name="none", alone=error(Nuisances.none()), without=None)
    for name in nuisance_names():
        yield NuisanceError(
            name=name, alone=error(nuisances.only(name)), without=error(nuisances.without(name))
        )
    yield NuisanceError(name="all", alone=error(nuisances), without=None)


def main(out: Path, scene_name: str = "cylinder", frame: int = 60, quick: bool = False) -> None:
    """Write table and figure into the folder `out`."""
    scene = build_scene(scene_name, SceneOptions(width=320, height=240) if quick else SceneOptions())
    table = {
        name: list(nuisance_errors(scene, Nuisances(), frame, degree=degree))
        for name, degree in DEGREES.items()
    }
    numbers = []
    for name, rows in table.items():
        for row in rows:
            what = {"all": "all nuisances", "none": "no nuisance"}.get(row.name, f"{row.name} alone")
            numbers.append(number(f"{scene_name}, {what}, {name}", row.alone.mean_deg, "degrees"))
            if row.without is not None:
                what = f"all but {row.name}"
                numbers.append(number(f"{scene_name}, {what}, {name}", row.without.mean_deg, "degrees"))
    bars = {
        f"{kind}, {name}": [getattr(row, kind).mean_deg for row in rows if row.without is not None]
        for name, rows in table.items()
        for kind in ("alone", "without")
    }
    names = [
        row.name.removesuffix("_px").replace("_", " ") for row in table["one M"] if row.without is not None
    ]
    write_bars(out / "nuisances.svg", names, bars, f"{scene_name}: mean error of the normals", "angle, °")
    plain = {name: [dataclasses.asdict(row) for row in rows] for name, rows in table.items()}
    write_text(out / "nuisances.json", json.dumps(plain, indent=1) + "\n")
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/nuisances"), help="folder to write")
    parser.add_argument("--scene", default="cylinder")
    parser.add_argument("--frame", type=int, default=60)
    parser.add_argument("--quick", action="store_true", help="320x240")
    arguments = parser.parse_args()
    main(arguments.out, arguments.scene, arguments.frame, arguments.quick)

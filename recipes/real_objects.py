"""Table: one coloured frame against many lights, on photographs of real statues and faces.

    python recipes/real_objects.py --out out/real_objects --data DIR        # 1 min

DIR holds coloured_light/, photometric_stereo/ and faces/. Shadows are found and recovered as `reconstruct`
does. Angles to the many-light normals, over pixels that three, two or one of the lights reach.

real_objects.svg: mean angle for each object, over all pixels and by how many lights reach them.
"""

import argparse
import dataclasses
import json
import os
from math import nan
from pathlib import Path

from vntoolkit.io.atomic import write_text
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.pipeline.referenced_captures import CAPTURES, read_capture
from vntoolkit.report.figures import write_bars
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals


def main(out: Path, data: Path) -> None:
    """Write real_objects.json, real_objects.svg and numbers.json into the folder `out`."""
    table, numbers = {}, []
    for name in CAPTURES:
        capture = read_capture(data, name)
        labels = ShadowDetector(capture.response).labels(capture.frame, capture.mask)
        recovered = recover_normals(capture.frame, labels, capture.response, capture.mask)
        table[name] = capture.errors_by_lights(recovered)
        inverted = capture.errors_by_lights(normals_from_frame(capture.frame, capture.response, capture.mask))
        for group, error in table[name].items():
            share = 100 * error.pixels / table[name]["all"].pixels
            lines = (
                ("median", error.median_deg, "degrees"),
                ("mean", error.mean_deg, "degrees"),
                ("mean without finding shadows", inverted[group].mean_deg, "degrees"),
                ("below 5 degrees", 100 * error.below_5, "%"),
                ("below 10 degrees", 100 * error.below_10, "%"),
                ("below 20 degrees", 100 * error.below_20, "%"),
            )
            for what, value, unit in lines:
                numbers.append(number(f"{name}, {group} ({share:.0f} % of it), {what}", value, unit))
    groups = {
        group: [errors[group].mean_deg if group in errors else nan for errors in table.values()]
        for group in ("all", "three lights", "two lights", "one light")
    }
    write_bars(
        out / "real_objects.svg", list(table), groups, "mean angle to the many-light normals", "angle, °"
    )
    plain = {name: {g: dataclasses.asdict(e) for g, e in errors.items()} for name, errors in table.items()}
    write_text(out / "real_objects.json", json.dumps(plain, indent=1) + "\n")
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/real_objects"), help="folder to write")
    default = os.environ.get("VNTOOLKIT_REAL_DATA")
    parser.add_argument("--data", type=Path, default=default, required=default is None)
    arguments = parser.parse_args()
    main(arguments.out, Path(arguments.data))

"""Compare a method of your own with ours: figures 6 and 7, and photographs of real statues and faces.

    python recipes/own_method.py --out out/own_method [--method my_method.py] [--data DIR]  # 4 min; --quick 1

my_method.py holds `normals(frame, rig)`: linear RGB and a rig give normals (h, w, 3) in the camera frame, of
length 1 with n_z < 0, and 0 where there is none; or a `vt.NormalMap`. Without it, `normals` below is taken.
DIR is that of `real_objects`. --quick: three frames of the cylinder, and the first photograph.

Both methods get the same frames and the true rig; photographs the one fitted to a grey ball or the flashes.
Photographs are black outside their masks. Ours finds shadows and fills them as `reconstruct` does. A pixel
counts where both the method and the truth have a normal: their share is printed beside the angles.
"""

import argparse
import os
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from runpy import run_path

import numpy as np

import vntoolkit as vt
from vntoolkit.errors import BadInput
from vntoolkit.io.files import require_file
from vntoolkit.io.maps_and_meshes.maps import write_normal_map
from vntoolkit.options.simulation import Nuisances, SceneOptions
from vntoolkit.report.recipes_page import RecipeNumber, number, write_numbers
from vntoolkit.simulation.image_formation import true_response
from vntoolkit.simulation.render import render_frame
from vntoolkit.simulation.scene import build_scene

sys.path.insert(0, str(Path(__file__).parent))
from real_objects import CAPTURES, read_capture

Normals = vt.NormalMap | np.ndarray
Method = Callable[[vt.LinearFrame, vt.Rig], Normals]


def normals(frame: vt.LinearFrame, rig: vt.Rig) -> Normals:
    """Return the direction of M⁻¹(r − a) at every pixel, the paper's equation 1 turned round."""
    scaled = (frame.rgb - rig.response.ambient) @ np.linalg.inv(rig.response.matrix).T
    length = np.linalg.norm(scaled, axis=2, keepdims=True)
    towards = (length > 0.05) & (scaled[..., 2:] < 0)
    return np.where(towards, scaled / np.maximum(length, 1e-9), 0.0).astype(np.float32)


def ours(frame: vt.LinearFrame, rig: vt.Rig) -> Normals:
    """Find the shadows, and recover the normals in them."""
    lit = vt.normals_from_frame(frame, rig.response).mask
    labels = vt.ShadowDetector(rig.response).labels(frame, lit)
    return vt.recover_normals(frame, labels, rig.response, lit)


def method_of(path: Path | None) -> Method:
    """Return `normals` of a Python file, or this recipe's own."""
    if path is None:
        return normals
    found: Method | None = run_path(str(require_file(path))).get("normals")
    if not callable(found):
        raise BadInput(f"{path}: expected a function `normals(frame, rig)`, found none of that name")
    return found


def compared(what: str, found: Normals, truth: vt.NormalMap) -> list[RecipeNumber]:
    """Return the angles to the truth, and how much of it they are of."""
    error = vt.evaluate_normals(found, truth)
    return [
        number(f"{what}: mean", error.mean_deg, "degrees"),
        number(f"{what}: median", error.median_deg, "degrees"),
        number(f"{what}: pixels with a normal", 100 * error.pixels / int(truth.mask.sum()), "%"),
    ]


def of_jacket(methods: dict[str, Method]) -> list[RecipeNumber]:
    """Figure 6: one frame of the jacket against its true normals."""
    scene = build_scene("jacket", SceneOptions())
    filmed, rig = (
        render_frame(scene, 0),
        vt.Rig(camera=scene.camera, response=true_response(scene, Nuisances())),
    )
    rows = []
    for name, method in methods.items():
        rows += compared(f"figure 6, jacket, {name}", method(filmed.linear, rig), filmed.truth.normals)
    return rows


def of_cylinder(out: Path, methods: dict[str, Method], frames: str) -> list[RecipeNumber]:
    """Figure 7: the angles to one cylinder fitted to the whole sequence."""
    film = vt.simulate("cylinder", out=out / "cylinder", frames=frames)
    lens, video, rows = film / "truth" / "rig.json", film / "capture.mkv", []
    vt.reconstruct(video, rig=lens, out=out / "ours", to="normals", materials="calibrated")
    rig = vt.read_rig(lens)
    for name, method in methods.items():
        result = out / name
        if result != out / "ours":
            shutil.copytree(out / "ours", result, dirs_exist_ok=True)
            for frame in vt.open_capture(video, vt.CaptureOptions(transfer=rig.transfer)):
                write_normal_map(result / "normals" / f"{frame.number:06d}.exr", as_map(method(frame, rig)))
        found = vt.evaluate_cylinder(result, truth=film, out=out / f"{name}_error")
        rows.append(number(f"figure 7, cylinder, {name}: mean", found.mean_deg, "degrees", 8.67))
        rows.append(number(f"figure 7, cylinder, {name}: standard deviation", found.std_deg, "degrees", 4.29))
    return rows


def of_photographs(data: Path, methods: dict[str, Method], captures: tuple[str, ...]) -> list[RecipeNumber]:
    """Three photographs stacked as one frame against the normals of many lights."""
    rows = []
    for capture in captures:
        seen = read_capture(data, capture)
        height, width = seen.mask.shape
        rig = vt.Rig(camera=vt.Camera.orthographic(width=width, height=height), response=seen.response)
        truth = vt.NormalMap(normals_in_camera=seen.normals.astype(np.float32), mask=seen.mask)
        frame = replace(seen.frame, rgb=seen.frame.rgb * seen.mask[..., None])
        for name, method in methods.items():
            rows += compared(f"photograph, {capture}, {name}", method(frame, rig), truth)
    return rows


def as_map(found: Normals) -> vt.NormalMap:
    """Return the map of an array of normals, 0 where there is none."""
    if isinstance(found, vt.NormalMap):
        return found
    return vt.NormalMap(normals_in_camera=found, mask=np.linalg.norm(found, axis=2) > 0.5)


def main(out: Path, method: Path | None = None, data: Path | None = None, quick: bool = False) -> None:
    """Write numbers.json into the folder `out`, and print one table for both methods."""
    methods = {"ours": ours, "theirs": method_of(method)}
    numbers = of_jacket(methods) + of_cylinder(out, methods, "::30" if quick else "::3")
    if data is not None:
        numbers += of_photographs(data, methods, CAPTURES[:1] if quick else CAPTURES)
    print(write_numbers(out, numbers))
    if data is None:
        print("photographs: give their folder by --data")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/own_method"), help="folder to write")
    parser.add_argument("--method", type=Path, help="a Python file with `normals(frame, rig)`")
    parser.add_argument("--data", type=Path, default=os.environ.get("VNTOOLKIT_REAL_DATA"))
    parser.add_argument("--quick", action="store_true", help="three frames, one photograph")
    arguments = parser.parse_args()
    main(arguments.out, arguments.method, arguments.data, arguments.quick)

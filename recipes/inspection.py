"""A coin under three coloured lamps: its print disappears, its relief and a dent remain, in millimetres.

    python recipes/inspection.py --out out/inspection [--quick]        # 10 s of processor time

The coin of 24 mm is drawn, not filmed: a dome with a rim, a number, black print and a dent of 40 µm. A
photograph under three lamps gives normals and depth; `export` gives what an inspector wants of them.

inspection.png: the photograph; mean curvature, dents in blue; relief of wavelengths up to 3 mm; a profile
through the dent. numbers.json: Sa and Sq of the coin's field, and the dent's depth, beside the true ones.
"""

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

import vntoolkit as vt
from vntoolkit.evaluation.depth_error import normals_from_gradient
from vntoolkit.geometry.camera import Camera
from vntoolkit.inspection.heights import HeightMap
from vntoolkit.inspection.roughness import roughness
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.rigs import write_rig
from vntoolkit.photometry.response import LightResponse, rgb_from_normals
from vntoolkit.photometry.rig import Rig
from vntoolkit.photometry.transfer import Transfer, TransferCurve
from vntoolkit.report.pictures import new_figure, write_figure
from vntoolkit.report.recipes_page import number, write_numbers

RADIUS_MM, DENT_MM, DENT_AT_MM, LONGEST_MM = 12.0, 0.04, (0.0, -7.0), 3.0
LIGHTS = np.array([[0.5, -0.3, -0.8], [-0.5, -0.3, -0.8], [0.0, 0.6, -0.8]])  # towards the lamps


def coin(pixel_mm: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return heights in millimetres (h, w), what is printed (h, w, 1 where nothing is), and the coin."""
    height, width = round(27.0 / pixel_mm), round(36.0 / pixel_mm)
    v, u = np.mgrid[:height, :width]
    x, y = (u - width / 2) * pixel_mm, (v - height / 2) * pixel_mm
    away = np.hypot(x, y)
    heights = 0.3 * (1 - (away / RADIUS_MM) ** 2) + 0.12 / (1 + np.exp((10.8 - away) / 0.1))
    digits = np.zeros((height, width), np.uint8)
    place = (round(width / 2 - 7.2 / pixel_mm), round(height / 2 + 3.4 / pixel_mm))
    cv2.putText(digits, "25", place, cv2.FONT_HERSHEY_DUPLEX, 0.37 / pixel_mm, 1, round(0.9 / pixel_mm))
    heights += 0.08 * cv2.GaussianBlur(digits.astype(np.float64), (0, 0), 0.12 / pixel_mm)
    from_dent = np.hypot(x - DENT_AT_MM[0], y - DENT_AT_MM[1])
    heights -= DENT_MM * np.exp(-((from_dent / 0.8) ** 2))
    printed = np.where((np.abs(y + 0.4 * x) % 4.0 < 1.2) & (away < 10.0), 0.3, 1.0)
    return heights, printed, away < RADIUS_MM - 0.2


def main(out: Path, pixel_mm: float = 0.05) -> None:
    """Write inspection.png, numbers.json, the photograph, the rig and the exports into the folder `out`."""
    heights, printed, mask = coin(pixel_mm)
    camera = Camera.orthographic(width=mask.shape[1], height=mask.shape[0], pixels_per_unit=1000.0 / pixel_mm)
    slope_v, slope_u = np.gradient(-heights / pixel_mm)
    colours = np.array([[0.75, 0.08, 0.03], [0.1, 0.7, 0.1], [0.03, 0.1, 0.75]])
    response = LightResponse(matrix=colours.T @ (LIGHTS / np.linalg.norm(LIGHTS, axis=1, keepdims=True)))
    rgb = printed[..., None] * rgb_from_normals(normals_from_gradient(slope_u, slope_v), response)
    noisy = rgb * mask[..., None] + np.random.default_rng(7).normal(0, 0.001, rgb.shape)
    out.mkdir(parents=True, exist_ok=True)
    write_png(out / "coin.png", np.rint(65535 * np.clip(noisy, 0, 1)).astype(np.uint16))
    write_png(out / "mask.png", np.where(mask, np.uint8(255), np.uint8(0)))
    write_rig(
        out / "rig.json", Rig(camera=camera, response=response, transfer=Transfer(curve=TransferCurve.LINEAR))
    )
    shared = {"rig": out / "rig.json", "mask": out / "mask.png", "to": "depth", "shadows": "none"}
    vt.reconstruct(str(out / "coin.png"), out=out / "result", overwrite=True, **shared)
    dent_px = (mask.shape[1] / 2 + DENT_AT_MM[0] / pixel_mm, mask.shape[0] / 2 + DENT_AT_MM[1] / pixel_mm)
    line = (dent_px[0] - 2 / pixel_mm, dent_px[1], dent_px[0] + 2 / pixel_mm, dent_px[1])
    curved = vt.export(out / "result", to="curvature", shortest=0.4, overwrite=True)
    shape = vt.export(out / "result", to="local-shape", longest=LONGEST_MM, overwrite=True)
    table = vt.export(out / "result", to="profile", line=line, longest=LONGEST_MM, overwrite=True)
    found = vt.export(out / "result", to="roughness", longest=LONGEST_MM, overwrite=True)
    truth = HeightMap(heights=heights, mask=mask, pitch=(pixel_mm, pixel_mm)).part(
        longest=LONGEST_MM, shortest=None
    )
    distances, profile = np.loadtxt(table / "000000.csv", delimiter=",", skiprows=1, unpack=True)
    true_profile = truth.along(line[:2], line[2:])[1]
    figure = new_figure(11.0, 2.9)
    pictures = (out / "coin.png", curved / "000000.png", shape / "000000.png")
    for place, (path, title) in enumerate(
        zip(pictures, ("photograph", "mean curvature", f"relief up to {LONGEST_MM:g} mm"), strict=True)
    ):
        axes = figure.add_subplot(1, 4, place + 1, title=title, xticks=[], yticks=[])
        axes.imshow(cv2.imread(str(path))[..., ::-1])
    axes = figure.add_subplot(1, 4, 4, title="through the dent", xlabel="mm", ylabel="µm")
    axes.plot(distances, 1000 * profile, label="measured")
    axes.plot(distances, 1000 * true_profile, "--", label="true")
    axes.legend()
    write_figure(figure, out / "inspection.png")
    told, true = json.loads((found / "000000.json").read_text("utf-8")), roughness(truth)
    numbers = [
        number(f"{name} of relief up to {LONGEST_MM:g} mm, {kind}", 1000 * values[name], "µm")
        for name in ("Sa", "Sq")
        for kind, values in (("measured", told), ("true", true))
    ]
    numbers += [
        number(f"deepest point of the profile, {kind}", 1000 * np.nanmin(values), "µm")
        for kind, values in (("measured", profile), ("true", true_profile))
    ]
    print(write_numbers(out, numbers))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/inspection"))
    parser.add_argument("--quick", action="store_true", help="pixels of 0.1 mm")
    given = parser.parse_args()
    main(given.out, 0.1 if given.quick else 0.05)

"""Table: one coloured frame against many lights, on photographs of real statues and faces.

    python recipes/real_objects.py --out out/real_objects --data DIR        # 1 min

DIR holds coloured_light/ (three photographs stacked as red, green, blue), photometric_stereo/ (twelve lights
of the same statues, a chrome and a grey ball) and faces/ (sixty-four flashes of the faces). Shadows are found
and recovered as `reconstruct` does. Angles to the many-light normals, over pixels that three, two or one of
the lights reach; and of the expected errors, how many angles are within, and how large they are over the
angle that nine of ten are within.

real_objects.svg: mean angle for each object, over all pixels and by how many lights reach them.
"""

import argparse
import dataclasses
import json
import os
import re
from dataclasses import dataclass
from math import nan
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray, Mask, Normals, VisibilityLabels
from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import AngularError, summarise_angles
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.atomic import write_text
from vntoolkit.io.files import read_bytes, require_file
from vntoolkit.io.footage.images import read_image
from vntoolkit.io.maps_and_meshes.masks import read_mask
from vntoolkit.normals.expected_error import with_expected_error
from vntoolkit.normals.inversion import normals_from_frame
from vntoolkit.photometry.fit_quality import angles_deg
from vntoolkit.photometry.frame import LinearFrame, count_lit, labels_from_lit
from vntoolkit.photometry.response import LightResponse
from vntoolkit.report.figures import write_bars
from vntoolkit.report.recipes_page import number, write_numbers
from vntoolkit.shadows.detector import ShadowDetector
from vntoolkit.shadows.recovery import recover_normals

CAPTURES = ("buddha", "cat", "yaleB01", "yaleB02")
STATUE_LIGHTS = (0, 4, 10)
STEEPEST_FLASH_DEG = 60.0
LIT_GROUPS = {"three lights": 3, "two lights": 2, "one light": 1}

_ROUNDS = 8  # of leaving out shadow and gloss


def main(out: Path, data: Path) -> None:
    """Write real_objects.json, real_objects.svg and numbers.json into the folder `out`."""
    table, numbers = {}, []
    for name in CAPTURES:
        capture = read_capture(data, name)
        labels = ShadowDetector(capture.response).labels(capture.frame, capture.mask)
        recovered = recover_normals(capture.frame, labels, capture.response, capture.mask)
        table[name] = capture.errors_by_lights(recovered)
        inverted = capture.errors_by_lights(normals_from_frame(capture.frame, capture.response, capture.mask))
        told = with_expected_error(recovered, capture.frame, capture.response, labels)
        for group, (within, wide) in capture.bounds_by_lights(told).items():
            numbers.append(number(f"{name}, {group}: within the expected error", 100 * within, "%"))
            numbers.append(number(f"{name}, {group}: expected error over nine of ten", wide, "times"))
        for group, error in table[name].items():
            share = 100 * error.pixels / table[name]["all"].pixels
            lines = (
                ("pixels", share, "% of all"),
                ("median", error.median_deg, "degrees"),
                ("mean", error.mean_deg, "degrees"),
                ("mean without finding shadows", inverted[group].mean_deg, "degrees"),
                ("below 5 degrees", 100 * error.below_5, "%"),
                ("below 10 degrees", 100 * error.below_10, "%"),
                ("below 20 degrees", 100 * error.below_20, "%"),
            )
            for what, value, unit in lines:
                numbers.append(number(f"{name}, {group}: {what}", value, unit))
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


# The photographs, and their normals from many lights.


@dataclass(frozen=True, kw_only=True, eq=False)
class ReferencedCapture:
    """A frame, its light response, and the many-light normals (h, w, 3), labels (h, w) and mask (h, w)."""

    frame: LinearFrame
    response: LightResponse
    normals: Normals
    labels: VisibilityLabels
    mask: Mask

    def errors_by_lights(self, found: NormalMap) -> dict[str, AngularError]:
        """Summarise the angles to the reference: over all pixels, and by how many lights reach them.

        Groups without a pixel are left out. Raises `BadInput` where the maps share no pixel.
        """
        angles = angles_deg(found.normals_in_camera, self.normals)
        return {name: summarise_angles(angles[group]) for name, group in self._groups(found).items()}

    def bounds_by_lights(self, found: NormalMap) -> dict[str, tuple[float, float]]:
        """Return the share of angles within the expected error, and its mean over their 90th percentile."""
        assert found.error_deg is not None
        angles = angles_deg(found.normals_in_camera, self.normals)
        bounds = {}
        for name, group in self._groups(found).items():
            true, said = angles[group], found.error_deg[group]
            bounds[name] = float((true <= said).mean()), float(said.mean() / np.percentile(true, 90))
        return bounds

    def _groups(self, found: NormalMap) -> dict[str, Mask]:
        both, lights = self.mask & found.mask, count_lit(self.labels)
        groups = {name: both & (lights == count) for name, count in LIT_GROUPS.items()}
        return {"all": both} | {name: group for name, group in groups.items() if group.any()}


def read_capture(folder: Path, name: str) -> ReferencedCapture:
    """Read one of `CAPTURES`. Raises `BadInput` where the folder does not hold it."""
    if name not in CAPTURES:
        raise BadInput(f"capture '{name}': expected one of {', '.join(CAPTURES)}")
    return _face(folder, name) if name.startswith("yale") else _statue(folder, name)


def normals_from_many_lights(
    images: FloatArray, lights: FloatArray, darkest: float
) -> tuple[FloatArray, FloatArray]:
    """Least squares without shadow (< 0.6 of the prediction) and gloss (> 1.3): normals and albedo."""
    use = (images > darkest) & (images < 0.995)
    scaled = np.zeros((*images.shape[1:], 3))
    for i in range(_ROUNDS + 1):
        if i:
            predicted = np.einsum("kc,hwc->khw", lights, scaled)
            albedo = np.linalg.norm(scaled, axis=-1)
            use = (images > darkest) & (images < 0.995) & (predicted > 0.1 * albedo)
            use &= (images > 0.6 * predicted) & (images < 1.3 * np.maximum(predicted, 0.02))
        weight = use.astype(float)
        normal_matrix = np.einsum("khw,ki,kj->hwij", weight, lights, lights) + 1e-9 * np.eye(3)
        right = np.einsum("khw,khw,ki->hwi", weight, images, lights)
        solved = np.linalg.solve(normal_matrix, right[..., None])[..., 0]
        scaled = np.where((use.sum(axis=0) >= 3)[..., None], solved, scaled)
    albedo = np.linalg.norm(scaled, axis=-1)
    return scaled / np.maximum(albedo, 1e-9)[..., None], albedo


def _capture(
    rgb: FloatArray,
    matrix: FloatArray,
    lights: FloatArray,
    reference: tuple[FloatArray, FloatArray],
    mask: Mask,
) -> ReferencedCapture:
    normals, albedo = reference
    predicted = np.einsum("kc,hwc->hwk", lights, normals) * albedo[..., None]
    labels = labels_from_lit((rgb > 0.5 * predicted) & (predicted > 0))
    frame = LinearFrame(rgb=rgb.astype(np.float32), clipped=np.asarray((rgb >= 0.999).any(axis=-1)))
    mask = mask & (albedo > 1e-6)
    return ReferencedCapture(
        frame=frame,
        response=LightResponse(matrix=matrix),
        normals=normals,
        labels=labels,
        mask=mask,
    )


def _statue(folder: Path, name: str) -> ReferencedCapture:
    """Directions from the chrome ball, strengths and M from the grey one."""
    stereo, coloured = folder / "photometric_stereo", folder / "coloured_light"
    ball, inside = _ball(read_mask(coloured / "gray_sphere.mask.png"))
    matrix = np.array([_fit(ball, c, inside) for c in np.moveaxis(_rgb(coloured / "gray_sphere.png"), 2, 0)])
    grey = [_fit(ball, _grey(stereo / f"gray/gray.{k}.png"), inside) for k in range(12)]
    lights = _chrome_directions(stereo) * np.linalg.norm(grey, axis=1, keepdims=True)
    images = np.array([_grey(stereo / f"{name}/{name}.{k}.png") for k in range(12)])
    reference = normals_from_many_lights(images, lights, darkest=0.015)
    mask = read_mask(coloured / f"{name}.mask.png")
    return _capture(_rgb(coloured / f"{name}.png"), matrix, lights[list(STATUE_LIGHTS)], reference, mask)


def _face(folder: Path, name: str) -> ReferencedCapture:
    """Directions from the file names; strengths so that the flashes agree with each other."""
    images, lights = [], []
    for path in sorted((folder / "faces" / name).glob("*.pgm")):
        azimuth, elevation = (np.deg2rad(float(x)) for x in re.findall(r"[AE]([+-]\d+)", path.stem))
        light = [
            -np.sin(azimuth) * np.cos(elevation),
            -np.sin(elevation),
            -np.cos(azimuth) * np.cos(elevation),
        ]
        if -light[2] > np.cos(np.deg2rad(STEEPEST_FLASH_DEG)):
            images.append(_grey(path))
            lights.append(light)
    flashes, directions = np.array(images), np.array(lights)
    normals, albedo = normals_from_many_lights(flashes, directions, darkest=0.03)
    predicted = np.einsum("kc,hwc->khw", directions, normals) * albedo
    lit = (predicted > 0.05) & (flashes > 0.6 * predicted) & (flashes < 0.99)
    part = flashes / np.maximum(predicted, 1e-6)
    directions *= np.array([np.median(p[x]) for p, x in zip(part, lit, strict=True)])[:, None]
    rgb = _rgb(folder / f"coloured_light/face_{name}.png")
    stacked = [int(np.abs(flashes - rgb[..., c]).mean(axis=(1, 2)).argmin()) for c in range(3)]
    reference = normals_from_many_lights(flashes, directions, darkest=0.03)
    whole = np.ones(rgb.shape[:2], bool)
    return _capture(rgb, directions[stacked], directions[stacked], reference, whole)


def _ball(mask: Mask) -> tuple[FloatArray, Mask]:
    v, u = np.nonzero(mask)
    radius = (np.ptp(u) + np.ptp(v) + 2) / 4
    y, x = np.mgrid[: mask.shape[0], : mask.shape[1]].astype(float)
    x, y = (x - (u.min() + u.max()) / 2) / radius, (y - (v.min() + v.max()) / 2) / radius
    rest = 1 - x**2 - y**2
    return np.stack([x, y, -np.sqrt(np.maximum(rest, 0))], axis=-1), (rest > 0) & mask


def _fit(normals: FloatArray, image: FloatArray, inside: Mask) -> FloatArray:
    lit = inside & (image > 0.08) & (image < 0.99)
    for _ in range(6):
        light = np.linalg.lstsq(normals[lit], image[lit], rcond=None)[0]
        lit = inside & (image > 0.05) & (np.abs(image - normals @ light) < 0.05)
    return light


def _chrome_directions(stereo: Path) -> FloatArray:
    normals, inside = _ball(read_mask(stereo / "chrome/chrome.mask.png"))
    view, directions = np.array([0, 0, -1.0]), []
    for k in range(12):
        image = np.where(inside, _grey(stereo / f"chrome/chrome.{k}.png"), 0)
        v, u = np.nonzero(image > 0.97 * image.max())
        normal = normals[round(v.mean()), round(u.mean())]
        directions.append(2 * (normal @ view) * normal - view)
    return np.array(directions)


def _rgb(path: Path) -> FloatArray:
    """An 8-bit image as (h, w, 3), 0 to 1, its values as stored (these photographs are linear)."""
    return read_image(require_file(path)) / 255.0


def _grey(path: Path) -> FloatArray:
    """A grey photograph (h, w), 0 to 1; the flashes are in the old binary PGM format of 8 bits."""
    if path.suffix != ".pgm":
        return np.asarray(_rgb(path).mean(axis=-1))
    content = read_bytes(path)
    header = re.match(rb"P5\s+(?:#.*\s+)*(\d+)\s+(\d+)\s+255\s", content)
    if header is None:
        raise BadInput(f"{path}: expected a binary PGM of 8 bits")
    width, height = int(header[1]), int(header[2])
    if len(content) - header.end() < width * height:
        raise BadInput(f"{path}: {width}×{height} pixels are promised, the file is cut off; copy it again")
    values = np.frombuffer(content, np.uint8, offset=header.end(), count=width * height)
    return values.reshape(height, width) / 255.0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/real_objects"), help="folder to write")
    default = os.environ.get("VNTOOLKIT_REAL_DATA")
    parser.add_argument("--data", type=Path, default=default, required=default is None)
    arguments = parser.parse_args()
    main(arguments.out, Path(arguments.data))

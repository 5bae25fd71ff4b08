"""Files of known lights: DiLiGenT's folder and plain text; directions x right, y up, z towards the viewer.

DiLiGenT: Shi et al., A benchmark dataset and evaluation for non-Lambertian and uncalibrated photometric
stereo, 2019 (shi2019).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from vntoolkit.arrays import FloatArray, Points, UInt16Array
from vntoolkit.checks import require_shape
from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.atomic import atomic_path, write_text
from vntoolkit.io.conventions import graphics_from_camera
from vntoolkit.io.files import read_text, require_inside
from vntoolkit.io.footage.image_writing import write_png
from vntoolkit.io.maps_and_meshes.maps import write_normal_map
from vntoolkit.io.maps_and_meshes.masks import write_mask
from vntoolkit.io.results.numbered_files import remove_if_empty
from vntoolkit.options.export import NormalConvention

_EXPECTED = "x y z, and perhaps red green blue, per light"
_CAMERA_FROM_GRAPHICS = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True, kw_only=True, eq=False)
class KnownLights:
    """directions: (k, 3), camera frame, as long as in the file. intensities: (k, 3) RGB or None.

    images: the photograph of each light, (k) paths or empty. files: what was read, for the rig's sources.
    """

    directions: Points
    intensities: Points | None
    images: tuple[Path, ...]
    files: tuple[Path, ...]


def read_lights(path: Path | str) -> KnownLights:
    """Read a DiLiGenT folder, or a text file.

    Folder: light_directions.txt, and where there light_intensities.txt and filenames.txt. Text file: a row
    for each light, `x y z` or `x y z red green blue`; a first line with their number and comments (#)
    are passed over.
    """
    path = Path(path)
    if path.is_dir():
        return _read_folder(path)
    rows = _read_rows(path)
    if rows.shape[1] not in (3, 6):
        raise BadInput(
            f"{path}: expected 3 or 6 numbers a light (x y z, red green blue), got {rows.shape[1]}"
        )
    return KnownLights(
        directions=rows[:, :3] * _CAMERA_FROM_GRAPHICS,
        intensities=rows[:, 3:] if rows.shape[1] == 6 else None,
        images=(),
        files=(path,),
    )


def _read_folder(folder: Path) -> KnownLights:
    directions = _read_rows(folder / "light_directions.txt")
    if directions.shape[1] != 3:
        raise BadInput(
            f"{folder}/light_directions.txt: expected 3 numbers a light, got {directions.shape[1]}"
        )
    files = [folder / "light_directions.txt"]
    intensities = None
    if (folder / "light_intensities.txt").exists():
        files.append(folder / "light_intensities.txt")
        intensities = _read_rows(files[-1])
        if intensities.shape[1] == 1:
            intensities = np.repeat(intensities, 3, axis=1)
        if intensities.shape != directions.shape:
            raise BadInput(
                f"{files[-1]}: holds {len(intensities)} rows of {intensities.shape[1]}, expected "
                f"{len(directions)} rows of 3 as there are directions"
            )
    images: tuple[Path, ...] = ()
    if (folder / "filenames.txt").exists():
        names = [line.strip() for line in read_text(folder / "filenames.txt").splitlines() if line.strip()]
        if len(names) != len(directions):
            raise BadInput(
                f"{folder}/filenames.txt: names {len(names)} images for {len(directions)} light directions"
            )
        images = tuple(require_inside(folder, name, folder / "filenames.txt") for name in names)
    return KnownLights(
        directions=directions * _CAMERA_FROM_GRAPHICS,
        intensities=intensities,
        images=images,
        files=tuple(files),
    )


def _read_rows(path: Path) -> Points:
    rows: list[list[float]] = []
    lines: list[int] = []
    for number, line in enumerate(read_text(path, expected=_EXPECTED).splitlines(), start=1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            rows.append([float(word) for word in words])
        except ValueError as error:
            raise BadInput(f"{path}: line {number} is not a row of numbers; expected {_EXPECTED}") from error
        lines.append(number)
    if len(rows) > 1 and len(rows[0]) == 1 and (len(rows[1]) > 1 or rows[0] == [len(rows) - 1]):
        (count,), lines = rows.pop(0), lines[1:]
        if count != len(rows):
            raise BadInput(f"{path}: promises {count:g} lights, holds {len(rows)}")
    if not rows:
        raise BadInput(f"{path}: holds no light; expected {_EXPECTED}")
    for number, values in zip(lines, rows, strict=True):
        if len(values) != len(rows[0]):
            raise BadInput(f"{path}: line {number} holds {len(values)} numbers, those before {len(rows[0])}")
    table = np.array(rows)
    if not np.isfinite(table).all():
        raise BadInput(f"{path}: holds NaN or infinity")
    return table


def write_diligent(
    folder: Path,
    images: list[UInt16Array],
    light_directions: FloatArray,
    light_intensities: FloatArray,
    normal_map: NormalMap,
    convention: NormalConvention = NormalConvention.OPENGL,
) -> None:
    """Write one object in the layout of the DiLiGenT benchmark (shi2019).

    images: k of (h, w, 3), linear, 65535 = full scale. light_directions: (k, 3) unit vectors towards the
    lights, camera frame. light_intensities: (k, 3) red, green, blue, by which the
    benchmark's users divide. convention: of Normal_est.mat and normal.png; the lights always are OPENGL.
    filenames.txt comes last: a folder that has it is whole.
    """
    from scipy.io import savemat

    count = len(images)
    require_shape(light_directions, (count, 3), "light directions")
    require_shape(light_intensities, (count, 3), "light intensities")
    names = [f"{k + 1:03d}.png" for k in range(count)]
    for name, image in zip(names, images, strict=True):
        write_png(folder / name, image)
    write_text(folder / "light_directions.txt", _rows(graphics_from_camera(light_directions)))
    write_text(folder / "light_intensities.txt", _rows(light_intensities))
    write_mask(folder / "mask.png", normal_map.mask)
    write_normal_map(folder / "normal.png", normal_map, convention=convention)
    signs = np.array(convention.signs, np.float64)
    with atomic_path(folder / "Normal_est.mat") as temporary:
        savemat(temporary, {"Normal_est": normal_map.normals_in_camera * signs}, appendmat=False)
    write_text(folder / "filenames.txt", "\n".join(names) + "\n")


def remove_diligent(folder: Path) -> None:
    """Remove what `write_diligent` wrote into a folder, and the folder once it is empty."""
    if not (folder / "light_directions.txt").exists():
        return
    texts = ("light_directions.txt", "light_intensities.txt", "filenames.txt")
    for name in (*texts, "mask.png", "normal.png", "Normal_est.mat", *(f"{k:03d}.png" for k in range(1, 4))):
        (folder / name).unlink(missing_ok=True)
    remove_if_empty(folder)


def _rows(values: FloatArray) -> str:
    return "".join(" ".join(f"{x:.8f}" for x in row) + "\n" for row in np.asarray(values))

"""A folder laid out like an object of the DiLiGenT benchmark (shi2019), for code that reads those.

001.png … one 16-bit picture a light, filenames.txt, light_directions.txt and light_intensities.txt (a row a
picture, x right, y up, z towards the viewer), mask.png. The benchmark's Normal_gt.mat is the truth, which a
capture does not have: our normals are Normal_est.mat, (h, w, 3) under that name, and normal.png.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from vntoolkit.arrays import FloatArray
from vntoolkit.checks import require_shape
from vntoolkit.geometry.maps import NormalMap
from vntoolkit.io.atomic import atomic_path, write_text
from vntoolkit.io.conventions import NormalConvention, graphics_from_camera
from vntoolkit.io.images import write_png
from vntoolkit.io.maps import write_mask, write_normal_map


def write_diligent(
    folder: Path,
    images: list[npt.NDArray[np.uint16]],
    light_directions: FloatArray,
    light_intensities: FloatArray,
    normal_map: NormalMap,
    convention: NormalConvention = NormalConvention.OPENGL,
) -> None:
    """Write one object.

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


def _rows(values: FloatArray) -> str:
    return "".join(" ".join(f"{x:.8f}" for x in row) + "\n" for row in np.asarray(values))

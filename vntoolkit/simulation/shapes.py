"""Shapes that no seed changes: generated meshes that the package ships, whose parts move."""

import zlib
from zipfile import BadZipFile

import numpy as np

from vntoolkit.arrays import Array, FloatArray
from vntoolkit.errors import BadInput
from vntoolkit.shipped import shipped_file


def read_shape(name: str) -> dict[str, Array]:
    """Return the arrays of data/shapes/NAME.npz, as `recipes/scene_shapes.py` made them.

    faces: (m, 3). The file holds the steps from each corner to the next, which pack to less than half.
    """
    path = shipped_file(f"shapes/{name}.npz")
    try:
        with np.load(path) as content:
            arrays = {key: np.ascontiguousarray(content[key]) for key in content}
        arrays["faces"] = np.cumsum(arrays.pop("face_steps"), dtype=np.int32).reshape(-1, 3)
    except (OSError, EOFError, ValueError, KeyError, BadZipFile, zlib.error) as error:
        raise BadInput(f"{path}: expected the arrays of a shape; install the package again") from error
    return arrays


def smooth_step(x: FloatArray | float) -> FloatArray:
    """Return 0 below 0, 1 above 1, and between them a cubic that is flat at both."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3.0 - 2.0 * x))

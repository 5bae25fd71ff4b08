"""Named array types for signatures: the first state their numbers, the others shape and meaning.

For a type checker they are plain numpy arrays. Frames, axes and units are those of CONVENTIONS.md.
"""

from typing import Annotated, Any, TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.floating[Any]]
IntArray: TypeAlias = npt.NDArray[np.integer[Any]]
ArrayLike: TypeAlias = npt.ArrayLike
DTypeLike: TypeAlias = npt.DTypeLike
Array: TypeAlias = npt.NDArray[Any]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
ByteArray: TypeAlias = npt.NDArray[np.uint8]
UInt16Array: TypeAlias = npt.NDArray[np.uint16]
Int32Array: TypeAlias = npt.NDArray[np.int32]
Int64Array: TypeAlias = npt.NDArray[np.int64]
Float32Array: TypeAlias = npt.NDArray[np.float32]
Float64Array: TypeAlias = npt.NDArray[np.float64]

LinearImage: TypeAlias = Annotated[npt.NDArray[np.float32], "h w 3: RGB, linear, 1.0 = full scale"]
Mask: TypeAlias = Annotated[npt.NDArray[np.bool_], "h w: True where valid"]
Weight: TypeAlias = Annotated[npt.NDArray[np.float32], "h w: confidence from 0 to 1"]
Flow: TypeAlias = Annotated[npt.NDArray[np.float32], "h w 2: (du, dv) in pixels"]
Normals: TypeAlias = Annotated[FloatArray, "... 3: unit vectors in the camera frame"]
Depth: TypeAlias = Annotated[FloatArray, "h w: z along the optical axis"]
VisibilityLabels: TypeAlias = Annotated[npt.NDArray[np.uint8], "h w: bit k set where light k arrives"]
MaterialLabels: TypeAlias = Annotated[npt.NDArray[np.uint8], "h w: number of the pixel's material"]

Points: TypeAlias = Annotated[FloatArray, "n 3"]
Points2: TypeAlias = Annotated[FloatArray, "n 2: (u, v) in pixels"]
Vectors: TypeAlias = Annotated[FloatArray, "... 3"]
Faces: TypeAlias = Annotated[npt.NDArray[np.int32], "m 3: vertex indices, counter-clockwise from outside"]
Colours: TypeAlias = Annotated[npt.NDArray[np.float32], "n 3: RGB from 0 to 1"]
Matrix3: TypeAlias = Annotated[FloatArray, "3 3: float64"]
Vector3: TypeAlias = Annotated[FloatArray, "3: float64"]

Box: TypeAlias = tuple[slice, slice]
"""Rows and columns of a part of an image."""


def read_only(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a view of `array` that refuses writing; the memory is shared, not copied."""
    view = array.view()
    view.flags.writeable = False
    return view


def box_of(mask: Mask, margin_px: int = 0) -> Box:
    """Return rows and columns that a mask reaches over, with a margin; of an empty one the margin at 0, 0."""
    sides = []
    for axis, length in enumerate(mask.shape):
        used = np.flatnonzero(mask.any(axis=1 - axis))
        first, end = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, 0)
        sides.append(slice(max(0, first - margin_px), min(length, end + margin_px)))
    return sides[0], sides[1]

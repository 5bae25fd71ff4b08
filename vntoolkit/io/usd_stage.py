"""A USD stage that is written as it grows: one binary file, constant memory, whole or not there."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from vntoolkit.errors import BadInput, CannotWrite
from vntoolkit.io.atomic import atomic_path
from vntoolkit.io.conventions import UpAxis, graphics_from_camera

SUFFIXES = (".usdc", ".usd")
ROOT = "/World"
_FLUSH_BYTES = 16 * 2**20


class UsdStage:
    """An open stage; `wrote(bytes)` after each frame lets it empty its memory into the file.

    A saved crate layer keeps only where each time sample lies in the file, and saving again appends. So
    a save every 16 MiB bounds the memory, and one file results, where value clips would need many.
    """

    def __init__(self, stage: Any) -> None:
        self.stage = stage
        self._pending = 0
        self._frames = 0

    def wrote(self, size: int) -> None:
        """Count one finished frame of `size` bytes; save where enough has gathered."""
        self._frames += 1
        self._pending += size
        if self._pending >= _FLUSH_BYTES:
            self.save()

    def save(self) -> None:
        """Append what is in memory to the file, with the time range so far."""
        self.stage.SetStartTimeCode(0)
        self.stage.SetEndTimeCode(max(self._frames - 1, 0))
        self.stage.GetRootLayer().Save()
        self._pending = 0


@contextlib.contextmanager
def new_stage(
    path: Path | str, *, frame_rate_hz: float, metres_per_unit: float, up: UpAxis = UpAxis.Y
) -> Iterator[UsdStage]:
    """Yield a stage with its up axis, length unit, frame rate (time code = frame) and a root prim."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise BadInput(f"{path}: expected a name that ends in .usdc or .usd (binary USD)")
    if not 0 < frame_rate_hz < np.inf or not 0 < metres_per_unit < np.inf:
        raise BadInput(f"{path}: expected a positive frame rate and length unit")
    from pxr import Sdf, Tf, Usd, UsdGeom

    with atomic_path(path) as temporary:
        try:
            layer = Sdf.Layer.CreateNew(str(temporary), {"format": "usdc"})
            stage = Usd.Stage.Open(layer)
            UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y if up is UpAxis.Y else UsdGeom.Tokens.z)
            UsdGeom.SetStageMetersPerUnit(stage, metres_per_unit)
            stage.SetTimeCodesPerSecond(frame_rate_hz)
            stage.SetFramesPerSecond(frame_rate_hz)
            stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, ROOT).GetPrim())
            open_stage = UsdStage(stage)
            yield open_stage
            open_stage.save()
        except Tf.ErrorException as error:
            raise CannotWrite(f"cannot write {path}: {' '.join(str(error).split())[:300]}") from error


def vec3f_from_camera(vectors: npt.NDArray[Any], up: UpAxis = UpAxis.Y) -> Any:
    """Return a USD array of (n, 3) vectors turned from the camera frame to y or z up."""
    from pxr import Vt

    return Vt.Vec3fArray.FromNumpy(graphics_from_camera(np.asarray(vectors, dtype=np.float32), up))

"""What a user may choose about an export, and what lengths become."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from enum import Enum

from vntoolkit.errors import BadInput
from vntoolkit.geometry.maps import LengthUnit
from vntoolkit.io.conventions import NormalConvention, UpAxis

_LOGGER = logging.getLogger(__name__)
_METRES_PER_PIXEL = 0.001  # shown, not measured: a 600-pixel subject opens 0.6 m tall in Blender


class ExportFormat(Enum):
    """What results are handed on as."""

    PLY = "ply"  # a mesh a frame
    OBJ = "obj"  # a mesh a frame
    USD = "usd"  # one animated file
    GLB = "glb"  # one animated file of a registered surface, else one a frame
    NPZ = "npz"  # arrays: one file a frame, and one of a registered surface
    DILIGENT = "diligent"  # one folder a frame, laid out like the benchmark's
    PNG = "png"  # 16-bit normal maps


class ExportedSurface(Enum):
    """Which meshes: of one topology, or a new one every frame."""

    AUTO = "auto"  # the registered surface where there is one
    TRACKED = "tracked"
    FRAMES = "frames"


class FileUnit(Enum):
    """Length unit of exported files."""

    M = "m"
    CM = "cm"
    MM = "mm"

    @property
    def metres(self) -> float:
        """Its length."""
        return {"m": 1.0, "cm": 0.01, "mm": 0.001}[self.value]


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """How results are handed on.

    to: the format: usd, one animated file (Blender keeps its own frame rate when it opens one: set that of
    its scene to the capture's); glb, one animated file of a registered surface, else one a frame; ply and
    obj, a mesh a frame; npz, arrays; png, 16-bit normal maps; diligent, a folder a frame, laid out like the
    benchmark's. normal_convention: axes of normal maps (png, npz, diligent). units: length unit of the files,
    where the result has a scale; default metres, and lengths as they are where it has none. up: axis that
    points up in meshes. scale: metres for a length of 1 in the result, where it has no scale of its own
    (lengths in pixels, or free). surface: which meshes: the registered surface (tracked), those of each frame
    (frames), or the registered one where there is one (auto).
    """

    to: ExportFormat
    normal_convention: NormalConvention = NormalConvention.OPENGL
    units: FileUnit | None = None
    up: UpAxis = UpAxis.Y
    scale: float | None = None
    surface: ExportedSurface = ExportedSurface.AUTO

    def __post_init__(self) -> None:
        if self.scale is not None and not self.scale > 0:
            raise BadInput(f"scale: expected a positive number of metres, got {self.scale:g}")
        if self.to is ExportFormat.GLB and (self.up is not UpAxis.Y or self.units not in (None, FileUnit.M)):
            raise BadInput("a GLB has metres and y up by its standard: leave out --units and --up")


@dataclass(frozen=True, kw_only=True)
class FileLengths:
    """factor: by which lengths are multiplied on their way into a file. metres_per_unit: of the file."""

    factor: float
    metres_per_unit: float


def file_lengths(options: ExportOptions, unit: LengthUnit | None) -> FileLengths:
    """Return what lengths of a result become; raise `BadInput` for units that it has no scale for."""
    metres = 1.0 if unit is LengthUnit.METRE else options.scale
    if unit is LengthUnit.METRE and options.scale is not None:
        raise BadInput("scale: the result has lengths in metres already; leave out --scale")
    if metres is not None:
        target = (options.units or FileUnit.M).metres
        return FileLengths(factor=metres / target, metres_per_unit=target)
    if options.units is not None and unit is not None:
        stored = "in pixels" if unit is LengthUnit.PIXEL else "of free scale"
        raise BadInput(
            f"units: the result's lengths are {stored}; give --scale METRES for a length of 1, or "
            "reconstruct with --distance"
        )
    shown = _METRES_PER_PIXEL if unit is LengthUnit.PIXEL else 1.0
    if unit is not None:
        _LOGGER.warning("the result has no scale: lengths are written as if 1 were %g m", shown)
    if options.to is ExportFormat.GLB:
        return FileLengths(factor=shown, metres_per_unit=1.0)
    return FileLengths(factor=1.0, metres_per_unit=shown)

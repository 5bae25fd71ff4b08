"""How results are compared with a reference."""

from dataclasses import dataclass
from enum import Enum
from typing import Literal, TypeAlias

from vntoolkit.options.base import Named, Options, named


class MeasuredBy(Enum):
    """Who measures distances."""

    EMBREE = "embree"  # the exact nearest point, however far, through Open3D
    PYMESHLAB = "pymeshlab"  # MeshLab's own search, to compare with


MeasuredByName: TypeAlias = Literal["embree", "pymeshlab"]


class Alignment(Enum):
    """Which motion aligns the meshes."""

    NONE = "none"
    RIGID = "rigid"
    SIMILARITY = "similarity"  # and one scale: that of a perspective camera's depth


@dataclass(frozen=True, kw_only=True)
class AlignmentOptions(Options):
    """How meshes are aligned."""

    align: Named[Alignment, Literal["none", "rigid", "similarity"]] = named(Alignment.NONE)
    """What may move: nothing, position and orientation (rigid), or the scale too (similarity)."""

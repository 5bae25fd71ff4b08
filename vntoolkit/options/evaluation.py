"""How results are compared with a reference."""

from enum import Enum
from typing import Literal, TypeAlias


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


AlignmentName: TypeAlias = Literal["none", "rigid", "similarity"]

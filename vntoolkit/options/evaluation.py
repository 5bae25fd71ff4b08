"""How results are compared with a reference."""

from dataclasses import dataclass
from enum import Enum

from vntoolkit.errors import BadInput


class MeasuredBy(Enum):
    """Who measures distances."""

    EMBREE = "embree"  # the exact nearest point, however far, through Open3D
    PYMESHLAB = "pymeshlab"  # MeshLab's own search, to compare with


class Alignment(Enum):
    """Which motion aligns the meshes."""

    NONE = "none"
    RIGID = "rigid"
    SIMILARITY = "similarity"  # and one scale: that of a perspective camera's depth


@dataclass(frozen=True, kw_only=True)
class AlignmentOptions:
    """How meshes are aligned."""

    free: Alignment = Alignment.NONE
    """What may move: nothing, position and orientation (rigid), or the scale too (similarity)."""
    samples: int = 20000
    """Vertices that are paired."""

    def __post_init__(self) -> None:
        """Refuse what leaves nothing to align by."""
        if self.samples < 3:
            raise BadInput(f"alignment: expected at least 3 samples, got {self.samples}")

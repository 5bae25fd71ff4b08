"""What one frame became, and the files of a reconstruction: their paths, and the writing of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from vntoolkit.arrays import MaterialLabels, VisibilityLabels
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.maps_and_meshes.label_images import write_labels, write_mask, write_materials
from vntoolkit.io.maps_and_meshes.maps import write_depth_map, write_normal_map
from vntoolkit.io.maps_and_meshes.meshes import write_mesh
from vntoolkit.io.results.manifest import FRAME_FILES

if TYPE_CHECKING:
    from vntoolkit.shadows.lamp_directions import LampDirections
    from vntoolkit.tactile.contact import Contact


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameResult:
    """What one frame became; None for what was not asked for. clipped_share: of all pixels, 0 to 1.

    contact: what touches a tactile gel, where its depth was asked for. materials: (h, w) numbers of
    materials, where there are others than the rig's. lamps: where they stand, if shadows were looked for.
    """

    number: int
    normal_map: NormalMap
    clipped_share: float
    depth_map: DepthMap | None = None
    labels: VisibilityLabels | None = None
    mesh: Mesh | None = None
    contact: Contact | None = None
    materials: MaterialLabels | None = None
    lamps: LampDirections | None = None


@dataclass(frozen=True, kw_only=True)
class ReconstructionFolder:
    """The folder DIR that `reconstruct` writes and every later verb reads."""

    root: Path

    def file(self, kind: str, number: int) -> Path:
        """Return the file of a frame in one of the folders of `FRAME_FILES`."""
        return self.root / kind / f"{number:06d}{FRAME_FILES[kind]}"

    def has(self, number: int, *kinds: str) -> bool:
        """Whether a frame has a file in each of these folders."""
        return all(self.file(kind, number).exists() for kind in kinds)

    def write(self, result: FrameResult) -> None:
        """Write a frame's results, each file atomically."""
        number = result.number
        write_normal_map(self.file("normals", number), result.normal_map)
        if result.depth_map is not None:
            write_depth_map(self.file("depth", number), result.depth_map)
        if result.labels is not None:
            write_labels(self.file("shadows", number), result.labels)
        if result.contact is not None:
            write_mask(self.file("contact", number), result.contact.mask)
        if result.materials is not None:
            write_materials(self.file("materials", number), result.materials)
        if result.mesh is not None:
            write_mesh(self.file("mesh", number), result.mesh)

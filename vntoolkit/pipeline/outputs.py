"""What one frame became, and the files of a reconstruction: their paths, and the writing of a frame."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vntoolkit.arrays import VisibilityLabels
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.geometry.mesh import Mesh
from vntoolkit.io.maps_and_meshes.label_images import write_labels, write_mask, write_materials
from vntoolkit.io.maps_and_meshes.maps import write_depth_map, write_normal_map
from vntoolkit.io.maps_and_meshes.meshes import write_mesh
from vntoolkit.materials.pixels import MaterialLabels
from vntoolkit.pipeline.contact import Contact
from vntoolkit.pipeline.options import Product


@dataclass(frozen=True, kw_only=True, eq=False)
class FrameResult:
    """What one frame became; None for what was not asked for. clipped_share: of all pixels, 0 to 1.

    contact: what touches a tactile gel, where its depth was asked for. materials: (h, w) numbers of
    materials, where there are others than the rig's.
    """

    number: int
    normal_map: NormalMap
    depth_map: DepthMap | None
    labels: VisibilityLabels | None
    mesh: Mesh | None
    clipped_share: float
    contact: Contact | None = None
    materials: MaterialLabels | None = None


@dataclass(frozen=True, kw_only=True)
class ReconstructionFolder:
    """The folder DIR that `reconstruct` writes and every later verb reads."""

    root: Path

    def normals(self, number: int) -> Path:
        """Return the file of a frame's normals."""
        return self.root / "normals" / f"{number:06d}.exr"

    def depth(self, number: int) -> Path:
        """Return the file of a frame's depth."""
        return self.root / "depth" / f"{number:06d}.exr"

    def shadows(self, number: int) -> Path:
        """Return the file of a frame's visibility labels."""
        return self.root / "shadows" / f"{number:06d}.png"

    def contact(self, number: int) -> Path:
        """Return the file of a frame's contact mask, of a tactile gel."""
        return self.root / "contact" / f"{number:06d}.png"

    def materials(self, number: int) -> Path:
        """Return the file of a frame's material labels."""
        return self.root / "materials" / f"{number:06d}.png"

    def mesh(self, number: int) -> Path:
        """Return the file of a frame's mesh."""
        return self.root / "mesh" / f"{number:06d}.ply"

    def files(
        self,
        number: int,
        product: Product,
        has_labels: bool,
        has_contact: bool = False,
        has_materials: bool = False,
    ) -> list[Path]:
        """Return the files that a finished frame has."""
        files = [self.normals(number)]
        if product is not Product.NORMALS:
            files.append(self.depth(number))
        if product is Product.MESH:
            files.append(self.mesh(number))
        if has_labels:
            files.append(self.shadows(number))
        if has_contact:
            files.append(self.contact(number))
        if has_materials:
            files.append(self.materials(number))
        return files

    def write(self, result: FrameResult) -> None:
        """Write a frame's results, each file atomically."""
        write_normal_map(self.normals(result.number), result.normal_map)
        if result.depth_map is not None:
            write_depth_map(self.depth(result.number), result.depth_map)
        if result.labels is not None:
            write_labels(self.shadows(result.number), result.labels)
        if result.contact is not None:
            write_mask(self.contact(result.number), result.contact.mask)
        if result.materials is not None:
            write_materials(self.materials(result.number), result.materials)
        if result.mesh is not None:
            write_mesh(self.mesh(result.number), result.mesh)

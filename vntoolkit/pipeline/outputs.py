"""What one frame became, and the writing of it into the folder of a reconstruction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from vntoolkit.arrays import MaterialLabels, VisibilityLabels
from vntoolkit.geometry.maps import DepthMap, NormalMap
from vntoolkit.io.maps_and_meshes.maps import write_depth_map, write_normal_map
from vntoolkit.io.results.manifest import ReconstructionFolder

if TYPE_CHECKING:
    from vntoolkit.geometry.mesh import Mesh
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


def write_frame(folder: ReconstructionFolder, result: FrameResult) -> None:
    """Write a frame's results, each file atomically; what writes a kind is imported where there is some."""
    number = result.number
    write_normal_map(folder.file("normals", number), result.normal_map)
    if result.depth_map is not None:
        write_depth_map(folder.file("depth", number), result.depth_map)
    if result.labels is not None:
        from vntoolkit.io.maps_and_meshes.label_images import write_labels

        write_labels(folder.file("shadows", number), result.labels)
    if result.contact is not None:
        from vntoolkit.io.maps_and_meshes.masks import write_mask

        write_mask(folder.file("contact", number), result.contact.mask)
    if result.materials is not None:
        from vntoolkit.io.maps_and_meshes.label_images import write_materials

        write_materials(folder.file("materials", number), result.materials)
    if result.mesh is not None:
        from vntoolkit.io.maps_and_meshes.meshes import write_mesh

        write_mesh(folder.file("mesh", number), result.mesh)

"""Point clouds, and their conversion to and from Open3D and pymeshlab."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from vntoolkit.arrays import Colours, Points
from vntoolkit.checks import set_arrays
from vntoolkit.display import Displayed, Facts, Picture, picture_of_points
from vntoolkit.errors import BadMesh

if TYPE_CHECKING:
    import open3d as o3d
    import pymeshlab


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PointCloud(Displayed):
    """Points with optional normals and colours.

    points: (n, 3) in the camera frame unless named otherwise. normals: (n, 3) unit vectors or None.
    colours: (n, 3) float32 RGB from 0 to 1 or None.
    """

    points: Points
    normals: Points | None = None
    colours: Colours | None = None

    def __post_init__(self) -> None:
        set_arrays(self, {"points": (None, 3)}, error=BadMesh)
        shape = (len(self.points), 3)
        set_arrays(self, {"normals": shape, "colours": shape}, error=BadMesh)

    @property
    def diagonal(self) -> float:
        """Length of the bounding box's diagonal."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0))) if len(self.points) else 0.0

    def _facts(self) -> Facts:
        has = [name for name in ("normals", "colours") if getattr(self, name) is not None]
        return {
            "points": str(len(self.points)),
            "diagonal": f"{self.diagonal:.4g}",
            "has": " ".join(has) or "no more",
        }

    def _picture(self) -> Picture:
        return picture_of_points(self.points, self.normals)

    def to_open3d(self) -> o3d.geometry.PointCloud:
        """Return a copy as an Open3D point cloud."""
        from vntoolkit.libraries import import_open3d

        o3d = import_open3d()
        cloud = o3d.geometry.PointCloud()
        cloud.points = o3d.utility.Vector3dVector(np.array(self.points, dtype=np.float64))
        if self.normals is not None:
            cloud.normals = o3d.utility.Vector3dVector(np.array(self.normals, dtype=np.float64))
        if self.colours is not None:
            cloud.colors = o3d.utility.Vector3dVector(np.array(self.colours, dtype=np.float64))
        return cloud

    def to_pymeshlab(self) -> pymeshlab.Mesh:
        """Return a copy as a pymeshlab mesh without faces."""
        from vntoolkit.libraries import import_pymeshlab

        extra: dict[str, Any] = {}
        if self.normals is not None:
            extra["v_normals_matrix"] = np.asarray(self.normals, dtype=np.float64)
        if self.colours is not None:
            extra["v_color_matrix"] = rgba_from_rgb(self.colours)
        points = np.asarray(self.points, dtype=np.float64)
        return import_pymeshlab().Mesh(vertex_matrix=points, **extra)

    @classmethod
    def from_pymeshlab(cls, mesh: pymeshlab.Mesh) -> PointCloud:
        """Copy the vertices of a pymeshlab mesh."""
        return cls(
            points=np.array(mesh.vertex_matrix()),
            normals=np.array(mesh.vertex_normal_matrix()),
            colours=np.array(mesh.vertex_color_matrix()[:, :3], dtype=np.float32)
            if mesh.has_vertex_color()
            else None,
        )


def rgba_from_rgb(colours: Colours) -> Points:
    """Append an opaque alpha channel: (n, 3) to (n, 4) float64, as pymeshlab wants it."""
    return np.column_stack([np.asarray(colours, dtype=np.float64), np.ones(len(colours))])
